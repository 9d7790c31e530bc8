"""Kinematics of shells with a director, both ways: the table of `kinematics` with ``L`` instead of ``I ± ∇u``.

A map of the body is ``y(ζ) = y₀ + ζ y₁ + ζ² y₂`` over the surface of the mesh, with the coordinate ``ζ`` through the
thickness. Its gradient in the chart of the mesh is ``L(y) = ∇y₀ + ζ ∇y₁ + (y₁ + 2 ζ y₂)⊗n``, with the unit normal
``n`` of the mesh and surface gradients.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import ufl


class ShellKinematics:
    """Gradients and volume of a shell at one distance from its midsurface.

    Args:
        sign: 1 if the mesh is the reference midsurface, -1 if it is the current one.
        director: vector through the thickness of the mesh's body, transversal to the mesh.
        motion: displacement of the midsurface (scaled lengths) and change of the director, ``x - X`` of both.
        zeta: distance ``ζ`` from the midsurface along the director, in scaled lengths.
    """

    def __init__(self, sign: int, director: Any, motion: tuple[Any, Any], zeta: float) -> None:
        self.sign, self.director, self.motion, self.zeta = sign, director, motion, zeta

    @cached_property
    def _normal(self) -> Any:
        """Unit normal of the mesh on the side of the director, so that ``det L > 0``."""
        normal = ufl.CellNormal(ufl.domain.extract_unique_domain(self.director))
        return ufl.sign(ufl.inner(normal, self.director)) * normal

    def chart_gradient(self, vectors: tuple[Any, Any]) -> Any:
        """Return ``L`` of a displacement of the midsurface and a change of the director."""
        middle, director = vectors
        return ufl.grad(middle) + self.zeta * ufl.grad(director) + ufl.outer(director, self._normal)

    @cached_property
    def reference_gradient(self) -> Any:
        """``L(X)``."""
        tangents = ufl.Identity(3) - ufl.outer(self._normal, self._normal)
        mesh = tangents + self.zeta * ufl.grad(self.director) + ufl.outer(self.director, self._normal)
        return mesh if self.sign > 0 else mesh - self.chart_gradient(self.motion)

    @property
    def H(self) -> Any:
        """Displacement gradient ``F - I = L(u) L(X)⁻¹``, without cancellation."""
        return self.Grad(self.motion)

    def Grad(self, vectors: tuple[Any, Any]) -> Any:
        """Return the gradient with respect to the reference body, ``L(v) L(X)⁻¹``."""
        return self.chart_gradient(vectors) * ufl.inv(self.reference_gradient)

    @property
    def reference_volume(self) -> Any:
        """Volume of the reference body per area of the mesh and unit of ``ζ``."""
        return ufl.det(self.reference_gradient)
