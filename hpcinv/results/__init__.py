"""Results of a solve: the solution in each direction, quantities of interest, and distances between shapes."""
