"""Results of a solve: the solution in each direction, quantities of interest, and distances between shapes."""

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)
