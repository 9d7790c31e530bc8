"""Pressures of cavities and motions of regions under remote loads that a job leaves unknown."""

from hpcinv.model.cavities import CavityReport, cavity_equations, reports_of
from hpcinv.model.remote_loads import RemoteReport
from hpcinv.solver.cavity_border import CavityBorder
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.remote_border import RemoteBorder


class UnknownLoads:
    """The unknown numbers of a job's loads, which its solves find with the state; there may be none.

    The load factor leads from the volumes of the mesh to the given ones, with all loads.
    """

    def __init__(self, equations: Equations, equilibrium: Equilibrium) -> None:
        job, system = equations.job, equilibrium.system
        self._cavities = cavity_equations(job, equations.body, system.weak_form, equations.scales)
        self._motions = [RemoteBorder(system, *item, equations.scales) for item in job.remote_loads.items()]
        pressures = [CavityBorder(system, self._cavities)] if self._cavities else []
        equilibrium.take_numbers([*self._motions, *pressures])

    def cavities(self, load: float) -> tuple[CavityReport, ...]:
        """Return the pressures and volumes of the present state, a solution at a load factor; collective."""
        return reports_of(self._cavities, load)

    def remote_loads(self, load: float) -> tuple[RemoteReport, ...]:
        """Return the motions of regions in the present state, a solution at a load factor; collective."""
        return tuple(motion.report(load) for motion in self._motions)
