"""Residual and tangent of a weak form as PETSc vectors and matrices."""

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)
