"""Processes and ranks: MPI, signals, memory, timings, and the compilation of kernels."""
