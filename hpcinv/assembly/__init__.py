"""Residual and tangent of a scene as PETSc vectors and matrices."""
