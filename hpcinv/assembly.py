"""Residual and tangent of a scene at a load factor, as PETSc has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import dolfinx.fem.petsc as fem_petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.admissibility import Admissibility
from hpcinv.kernels import JIT_OPTIONS

if TYPE_CHECKING:
    from hpcinv.newton import Outcome
    from hpcinv.scene import Scene
    from hpcinv.supports import Supports
    from hpcinv.timings import Timings


class Assembly:
    """The discrete equations ``R(x, λ) = 0`` of one scene under its supports, and their tangent ``K = ∂R/∂x``.

    Rows of unknowns that supports prescribe read ``x_i - λ ū_i = 0``; the other rows are as if these held already.

    Attributes:
        state: every unknown x; what is evaluated on the body is evaluated there.
        matrix: the tangent as it was last assembled.
        rhs: a vector for residuals.
    """

    def __init__(self, scene: Scene, supports: Supports, timings: Timings) -> None:
        self.scene, self.supports, self.timings = scene, supports, timings
        self.comm = scene.unknowns.mesh.comm
        self.state = scene.unknowns.state
        with timings("compile"):
            self._residual = fem.form(scene.residual, jit_options=JIT_OPTIONS)
            trial = ufl.TrialFunction(scene.unknowns.space)
            self._tangent = fem.form(ufl.derivative(scene.residual, self.state, trial), jit_options=JIT_OPTIONS)
            self._admissibility = Admissibility(scene)
        with timings("tangent"):
            self.matrix = fem_petsc.create_matrix(self._tangent)
        with timings("set-up"):
            self.rhs = fem_petsc.create_vector(scene.unknowns.space)

    def set_load(self, load: float) -> None:
        """Set the load factor λ of the scene and its supports."""
        self.scene.parameters.set_load(load)
        self.supports.scale(load)

    def set_state(self, x: PETSc.Vec) -> None:
        """Make ``x`` the state."""
        x.copy(self.state.x.petsc_vec)
        self.state.x.scatter_forward()

    def residual(self, b: PETSc.Vec) -> None:
        """Assemble R at the present state and load into ``b``."""
        self._forces(b)
        conditions, state = self.supports.conditions, self.state.x.petsc_vec
        with self.timings("residual"):
            if self.supports.prescribe_motion:
                fem_petsc.apply_lifting(b, [self._tangent], bcs=[conditions], x0=[state], alpha=-1.0)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            fem_petsc.set_bc(b, conditions, x0=state, alpha=-1.0)

    def lift(self, b: PETSc.Vec) -> None:
        """Put in ``b`` what the prescribed values stand for on the right of ``K x = b``, with K as it was assembled."""
        conditions = self.supports.conditions
        with self.timings("residual"):
            with b.localForm() as local:
                local.set(0.0)
            fem_petsc.apply_lifting(b, [self._tangent], bcs=[conditions])
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            fem_petsc.set_bc(b, conditions)

    def forces(self, load: float) -> npt.NDArray[np.float64]:
        """Internal less external nodal forces (scaled) of the owned unknowns as they stand; supports add nothing."""
        self.set_load(load)
        self._forces(self.rhs)
        self.rhs.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(self.rhs.array)

    def tangent(self) -> None:
        """Assemble K at the present state and load into ``matrix``."""
        with self.timings("tangent"):
            self.matrix.zeroEntries()
            fem_petsc.assemble_matrix(self.matrix, self._tangent, bcs=self.supports.conditions)
            self.matrix.assemble()

    def min_mesh_J(self) -> float:
        """Smallest determinant of the position map over all quadrature points; it must stay positive."""
        return self._admissibility.min_mesh_J()

    def fault(self) -> Outcome | None:
        """Why the present state is not admissible, ``None`` if it is."""
        with self.timings("admissibility check"):
            return self._admissibility.fault()

    def fault_of_solution(self) -> Outcome | None:
        """Why the present state cannot be a solution of the continuous equations, ``None`` if it can."""
        with self.timings("admissibility check"):
            return self._admissibility.fault_of_solution()

    def _forces(self, b: PETSc.Vec) -> None:
        with self.timings("residual"), b.localForm() as local:
            local.set(0.0)
            fem_petsc.assemble_vector(b, self._residual)
