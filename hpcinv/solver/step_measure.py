"""How far a step turns and stretches the body: what tells whether a linear step can be believed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem

from hpcinv.model.quadrature_values import QuadratureValues
from hpcinv.parallel.runtime import MPI

if TYPE_CHECKING:
    from petsc4py import PETSc

    from hpcinv.model.scene import Scene


@dataclass(frozen=True)
class Increment:
    """The largest rotation (rad) and strain (norm) at any point that a step would bring about, were it small."""

    turn: float
    stretch: float


class Increments:
    """Measures steps from the present state of a scene.

    With ``F`` the gradient of the map from the mesh to the other body, ``δF F⁻¹ = d + w``: the strain ``d = dᵀ`` and
    the spin ``w = -wᵀ`` of that body. Of the residual nothing is asked, which is dominated by what is stiffest.
    """

    def __init__(self, scene: Scene) -> None:
        unknowns, kin = scene.unknowns, scene.kinematics
        self._comm = unknowns.mesh.comm
        self._step = fem.Function(unknowns.space)
        step = self._step if unknowns.p is None else ufl.split(self._step)[0]
        rate = kin.sign * ufl.grad(step) * ufl.inv(ufl.Identity(3) + kin.sign * ufl.grad(unknowns.u))
        w, d = ufl.skew(rate), ufl.sym(rate)
        squares = ufl.as_vector([ufl.inner(w, w) / 2, ufl.inner(d, d)])
        self._squares = QuadratureValues(squares, unknowns.mesh, scene.quadrature_degree)

    def __call__(self, step: PETSc.Vec) -> Increment:
        """Of a step in all unknowns, added or subtracted; collective."""
        step.copy(self._step.x.petsc_vec)
        self._step.x.scatter_forward()
        largest = np.zeros(2)
        for _, values in self._squares:
            largest = np.maximum(largest, values.reshape(-1, 2).max(axis=0, initial=0.0))
        self._comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
        turn, stretch = np.sqrt(largest)
        return Increment(float(turn), float(stretch))
