"""Where the path of solutions leads: along its tangent, measured by how far that turns and stretches the body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np

from hpcinv.parallel.petsc_vectors import norm
from hpcinv.solver.linear_system import LinearSystem
from hpcinv.solver.step_measure import Increment, Increments

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hpcinv.model.scene import Scene
    from hpcinv.model.supports import Supports
    from hpcinv.parallel.timings import Timings
    from hpcinv.solver.linear.selection import Choice
    from hpcinv.solver.petsc_options import Value

NOWHERE = Increment(np.inf, np.inf)


@dataclass(frozen=True)
class Prediction:
    """A step along the tangent: its length, and what it does to the body."""

    length: float
    increment: Increment


class Predictor(LinearSystem):
    """The equations of one scene, and the tangent of their path of solutions.

    Attributes:
        predicted: what has foretold the present state; the next solve begins with it.
    """

    def __init__(
        self, scene: Scene, supports: Supports, timings: Timings, options: Mapping[str, Value], choice: Choice
    ) -> None:
        super().__init__(scene, supports, timings, options, choice)
        with timings("compile"):
            self.increments = Increments(scene)
        self.predicted: Prediction | None = None
        self._origin = self.rhs.duplicate()  # where the prediction began
        self._new_tangents, self._new_signs = 0, list[int]()  # that no solve has been charged with yet

    def predict(self, load: float, *, anew: bool = False) -> Prediction:
        """Move the state along the tangent of the solution path to another load factor.

        A step that would turn an element inside out is not taken.

        Args:
            anew: with a new tangent; else with the factors at hand.

        Returns:
            The step, taken or not.
        """
        start = self._origin
        self.state.x.petsc_vec.copy(start)
        self.set_load(load)
        if anew:
            self.tangent()
            self._new_tangents += 1
        self.residual(self.rhs)
        x = self.rhs.duplicate()
        self.factorize()
        self.preset.allow(self.choice.budget)
        with self.timings("linear solve"):
            solved = self.back_substitute(self.rhs, x)
        if solved and anew and (sign := self.sign_of_determinant()):
            self._new_signs.append(sign)
        if not solved and self.fall_back():
            x.destroy()
            self.set_state(start)
            return self.predict(load, anew=anew)
        if not solved:
            self.forget_factors()
        step = Prediction(norm(x), self.increments(x) if solved else NOWHERE)
        x.aypx(-1.0, start)
        self.set_state(x)
        x.destroy()
        self.predicted = step
        if not solved or self.fault():
            self.set_state(start)
            self.predicted = None
        return step

    def destroy(self) -> None:
        """Free what PETSc holds."""
        self._origin.destroy()
        super().destroy()
