"""Studies of accuracy against time: refinement series of runs, their errors and costs, and the Pareto front."""
