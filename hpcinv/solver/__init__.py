"""Solution of the nonlinear equations: Newton's method, load stepping and arc-length continuation."""

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)
