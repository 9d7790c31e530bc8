"""Studies of accuracy against time: series of runs, their errors, what they cost, and which of them are worth it."""
