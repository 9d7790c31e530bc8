"""Continuation in the bulk modulus: the full load on a softer material, whose bulk modulus is then raised."""

import math
from collections.abc import Iterator

from hpcinv.base.quantity.quantity import quantity_of
from hpcinv.base.quantity.spatial_fields import is_uniform
from hpcinv.job.rules import NEARLY_INCOMPRESSIBLE
from hpcinv.physics.materials import MaterialLaw
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.equilibrium_path import EquilibriumPath, Solves
from hpcinv.solver.load_stepping import AdaptiveSteps


class BulkModulus:
    """Continuation for nearly incompressible bodies in the displacement form, where large steps change the volume.

    The bulk modulus of each such law grows geometrically from `NEARLY_INCOMPRESSIBLE` times its shear modulus to its
    value in the job. The pressure hardly depends on the bulk modulus, so the volume change is in proportion to its
    reciprocal. The predictor is linear in it.
    """

    _first = 4.0  # factor of the bulk modulus in the first step
    _least = 1.02  # smallest such factor
    _easy = 4  # number of iterations up to which the next step is longer

    def __init__(self, equations: Equations, equilibrium: Equilibrium) -> None:
        self.equations, self.equilibrium = equations, equilibrium
        self.tolerance, self.path_tolerance = equations.job.solver.tolerance, 1e-4
        self._laws = list(_nearly_incompressible(equations))
        self._ratio = max((ratio for *_, ratio in self._laws), default=1.0)

    @property
    def is_applicable(self) -> bool:
        """True in the displacement form if a law has a large bulk modulus that can be lowered."""
        return self.equations.unknowns.p is None and bool(self._laws)

    def solves(self) -> Solves:
        """Yield every solve; the last one is accepted at the bulk moduli of the job, or has the reason for the end."""
        try:
            self._soften(0.0)
            self.equations.unload()
            path = EquilibriumPath(self.equilibrium, self.path_tolerance, self.equations.job.case_count)
            for solve in path.follow(AdaptiveSteps()):
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
                if solve.outcome.is_final or step * math.log(self._ratio) < math.log(self._least):
                    return
        finally:
            self._soften(1.0)

    def _soften(self, share: float) -> None:
        """Set the bulk moduli: 0 is softest, 1 as in the job."""
        for number, name, ratio in self._laws:
            self.equilibrium.system.weak_form.parameters.scale(number, name, ratio ** (share - 1))

    def _predict(self, growth: float) -> None:
        """Predict the state for a larger logarithm of the bulk modulus, with the present factors."""
        equilibrium, start = self.equilibrium, self.equilibrium.system.position()
        step = start.duplicate()
        equilibrium.system.set_load(1.0)
        equilibrium.system.residual(equilibrium.system.rhs)
        if equilibrium.linear.solve(equilibrium.system.rhs, step):
            # The residual of the stiffer material is linear in the bulk modulus, not in its reciprocal.
            step.aypx(-math.exp(-growth), start)
            equilibrium.system.set_state(step)
            if equilibrium.system.fault() is not None:
                equilibrium.system.set_state(start)


def _nearly_incompressible(equations: Equations) -> Iterator[tuple[int, str, float]]:
    """Yield number, name of the bulk modulus, and ratio of that to its lowest value, for each law with a large one."""
    for number, law in enumerate(equations.job.laws.values()):
        ratio = law.stiffness_ratio
        name = _bulk_modulus(law)
        if name is not None and ratio is not None and NEARLY_INCOMPRESSIBLE < ratio < math.inf:
            yield number, name, ratio / NEARLY_INCOMPRESSIBLE


def _bulk_modulus(law: MaterialLaw) -> str | None:
    """Return the name of the bulk modulus, which may be 'incompressible', if it is one number everywhere."""
    for name, (value, _) in law.quantities().items():
        if name in type(law).model_fields and quantity_of(type(law), name).infinite and value is not None:
            return name if is_uniform(value) else None
    return None
