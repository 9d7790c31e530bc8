"""Processes and ranks: MPI, signals, memory, timings, and the cache."""
