"""Solution of the nonlinear equations: Newton's method, load stepping and arc-length continuation."""

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)
