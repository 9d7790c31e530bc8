"""Equations of a few unknowns, without finite elements, which the Newton's method of the solver solves."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.model.outcome import Outcome
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.predictor import Increment


class SmallSystem:
    """Equations in numpy arrays, with what `Equilibrium` asks of a system.

    Args:
        residual: by the unknowns and the load factor.
        tangent: its derivative by the unknowns.
    """

    comm, director, tangents = MPI.COMM_SELF, None, 0

    def __init__(
        self,
        size: int,
        residual: Callable[[np.ndarray, float], np.ndarray],
        tangent: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self.x, self.load = PETSc.Vec().createSeq(size), 0.0
        self.rhs, self.timings = self.x.duplicate(), Timings()
        self._residual, self._tangent = residual, tangent
        self.matrix = PETSc.Mat().createAIJ((size, size), comm=PETSc.COMM_SELF)
        self.matrix.setUp()
        self.matrix.setValues(range(size), range(size), np.eye(size).ravel().tolist())
        self.matrix.assemble()
        passages = SimpleNamespace(has_passed=lambda: False, depart=lambda: None)
        self.weak_form = SimpleNamespace(
            passages=passages,
            contacts=SimpleNamespace(depends_on_path=False),
            kinematics=SimpleNamespace(direction="inverse"),
            unknowns=SimpleNamespace(size=size),
            nominal_displacement=lambda: (0.0,),
        )

    @property
    def state(self) -> Any:
        return SimpleNamespace(x=SimpleNamespace(petsc_vec=self.x, array=self.x.array))

    def position(self) -> PETSc.Vec:
        return self.x.copy()

    def set_state(self, x: PETSc.Vec) -> None:
        x.copy(self.x)

    def set_values(self, values: np.ndarray) -> None:
        self.x.array[:] = values

    def begin_contact_step(self, load: float) -> None:
        pass

    def end_contact_step(self, load: float) -> None:
        """Nothing is in contact."""

    def follow_failure(self, outcome: Outcome) -> bool:
        return False

    def set_load(self, load: float) -> None:
        self.load = load

    def begin_unloaded(self) -> None:
        """Nothing presses on the unloaded system."""

    def residual(self, b: PETSc.Vec) -> None:
        b.array[:] = self._residual(self.x.array, self.load)

    def tangent(self) -> None:
        self.matrix.setValues(range(self.x.size), range(self.x.size), self._tangent(self.x.array).ravel().tolist())
        self.matrix.assemble()
        self.tangents += 1

    def fault(self) -> Outcome | None:
        return None

    fault_of_solution = fault

    def admissible_share(self, _x: PETSc.Vec, _step: PETSc.Vec) -> tuple[float, None]:
        return 1.0, None

    def equilibrium(self, reuse: float = 0.3) -> Equilibrium:
        predictor = SimpleNamespace(increments=lambda _: Increment(0.0, 0.0), destroy=lambda: None)
        linear = SmallLinear(self)
        made = Equilibrium(cast(Any, self), cast(Any, linear), cast(Any, predictor), limit=25, reuse=reuse)
        made.snes.getLineSearch().setType("basic")
        return made


class SmallLinear:
    """Factors of a small tangent."""

    must_renew, failure = False, Outcome.LINEAR_SOLVER
    configuration = SimpleNamespace(error=0.0)
    options = SimpleNamespace(blamed=nullcontext)

    def __init__(self, system: SmallSystem) -> None:
        self._system, self.factorizations, self._factorized = system, 0, -1
        self.ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self.ksp.setType("preonly")
        self.ksp.pc.setType("lu")

    def factorize(self, *, may_keep: bool = False) -> None:
        if self._factorized != self._system.tangents:
            self._factorized = self._system.tangents
            self.factorizations += 1
            self.ksp.setOperators(self._system.matrix)

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, *, may_fall_back: bool = True) -> bool:
        self.factorize()
        return self.back_substitute(b, x)

    def back_substitute(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        if not self.sign_of_determinant():
            return False
        self.ksp.solve(b, x)
        return True

    def sign_of_determinant(self) -> int:
        everywhere = range(self._system.x.size)
        return int(np.sign(np.linalg.det(self._system.matrix.getValues(everywhere, everywhere))))

    def limit_iterations(self) -> None:
        pass

    def count_iterations(self, number: int) -> None:
        pass

    def take_iterations(self) -> int:
        return 0

    def fall_back(self) -> bool:
        return False

    def forget_factors(self) -> None:
        pass
