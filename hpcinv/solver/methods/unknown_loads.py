"""Numbers of loads and supports that a job leaves unknown."""

from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.solver.constraints import borders_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium


class UnknownLoads:
    """The unknown numbers of a job, which its solves find with the state; there may be none.

    The load factor leads from the unloaded body to what is given, with all loads.
    """

    def __init__(self, equations: Equations, equilibrium: Equilibrium) -> None:
        self._borders = borders_of(equations.job, equations, equilibrium.system)
        equilibrium.take_numbers(self._borders)

    def reports(self, load: float) -> tuple[ConstraintReport, ...]:
        """Return what the present state, a solution at a load factor, says about them; collective."""
        return tuple(report for border in self._borders for report in border.reports(load))
