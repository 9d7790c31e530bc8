"""Stability of a solution: factors of the forward tangent, their inertia, and the lowest eigenvalue."""
