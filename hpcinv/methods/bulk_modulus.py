"""Continuation in the bulk modulus: the whole load on a softer material first, which is then made as stiff as it is."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hpcinv.job.rules import NEARLY_INCOMPRESSIBLE
from hpcinv.model.outcome import Outcome
from hpcinv.quantity.quantity import quantity_of
from hpcinv.quantity.spatial_fields import is_uniform
from hpcinv.solver.load_stepping import AdaptiveSteps, follow

if TYPE_CHECKING:
    from hpcinv.materials import MaterialLaw
    from hpcinv.solver.equilibrium import Equilibrium, Solve
    from hpcinv.solver.problem import Model


class BulkModulus:
    """For nearly incompressible bodies in the displacement form: there each large step of Newton's method costs volume.

    The bulk modulus of each such law begins at `NEARLY_INCOMPRESSIBLE` times its shear modulus, and grows to its own by
    powers of that ratio. The pressure hardly changes with it, so that the volume change is in proportion to its
    reciprocal, which the predictor is linear in.
    """

    _first = 4.0  # times the bulk modulus of before
    _least = 1.02
    _easy = 4  # iterations

    def __init__(self, model: Model, equilibrium: Equilibrium) -> None:
        self.model, self.equilibrium = model, equilibrium
        self.tolerance, self.path_tolerance = model.job.solver.tolerance, 1e-4
        self._laws = list(_nearly_incompressible(model))
        self._ratio = max((ratio for *_, ratio in self._laws), default=1.0)

    @property
    def suits(self) -> bool:
        """Whether there is a bulk modulus to lower that stands in the way."""
        return self.model.unknowns.p is None and bool(self._laws)

    def solves(self) -> Generator[Solve, None, None]:
        """Yield every solve; the last one is accepted, with the bulk modulus as it is, or tells why it ended."""
        with self._kept():
            self._soften(0.0)
            self.equilibrium.system.state.x.array[:] = 0.0
            steps = AdaptiveSteps(cases=self.model.job.case_count)
            for solve in follow(self.equilibrium, steps, self.path_tolerance):
                last = solve
                yield solve
            share, step = 0.0, math.log(self._first) / math.log(self._ratio)
            predict = True
            while last.outcome.accepted and share < 1.0:
                target = min(1.0, share + step)
                start = self.equilibrium.system.position()
                self._soften(target)
                if predict:
                    self._predict((target - share) * math.log(self._ratio))
                solve = self.equilibrium.solve(1.0, self.tolerance if target == 1.0 else self.path_tolerance)
                yield solve
                predict = solve.outcome.accepted
                if predict:
                    share, step = target, 1.5 * step if len(solve.iterations) <= self._easy else step
                    continue
                self.equilibrium.system.set_state(start)
                step = (target - share) / 2
                if solve.outcome is Outcome.INTERRUPTED or step * math.log(self._ratio) < math.log(self._least):
                    return

    def _soften(self, share: float) -> None:
        """Set the bulk moduli: 0 is softest, 1 as they are."""
        for number, name, ratio in self._laws:
            self.equilibrium.system.scene.parameters.scale(number, name, ratio ** (share - 1))

    def _predict(self, growth: float) -> None:
        """Move the state along the path, on which the logarithm of the bulk modulus grows, with the factors at hand."""
        equilibrium, start = self.equilibrium, self.equilibrium.system.position()
        step = start.duplicate()
        equilibrium.system.set_load(1.0)
        equilibrium.system.residual(equilibrium.system.rhs)
        if equilibrium.linear.solve(equilibrium.system.rhs, step):
            # The residual is that of the stiffer material, linear in the bulk modulus and not in its reciprocal.
            step.aypx(-math.exp(-growth), start)
            equilibrium.system.set_state(step)
            if equilibrium.system.fault() is not None:
                equilibrium.system.set_state(start)

    @contextmanager
    def _kept(self) -> Iterator[None]:
        try:
            yield
        finally:
            self._soften(1.0)


def _nearly_incompressible(model: Model) -> Iterator[tuple[int, str, float]]:
    """Number of each law whose bulk modulus can be lowered, the name of that, and how many times it is too large."""
    for number, law in enumerate(model.job.laws.values()):
        ratio = law.stiffness_ratio
        name = _bulk_modulus(law)
        if name is not None and ratio is not None and NEARLY_INCOMPRESSIBLE < ratio < math.inf:
            yield number, name, ratio / NEARLY_INCOMPRESSIBLE


def _bulk_modulus(law: MaterialLaw) -> str | None:
    """The parameter of the volumetric energy: the one that may be 'incompressible', if it is one number everywhere."""
    for name, (value, _) in law.quantities().items():
        if name in type(law).model_fields and quantity_of(type(law), name).infinite and value is not None:
            return name if is_uniform(value) else None
    return None
