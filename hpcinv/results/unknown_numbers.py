"""Unknown numbers of a solution, which are pressures of cavities and motions of regions, with their equations."""

from hpcinv.model.assembly.system import System
from hpcinv.model.cavities import CavityEquation, cavity_equations
from hpcinv.model.weak_form import WeakForm
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.remote_border import RemoteBorder


def solved_cavities(equations: Equations, solution: Solution, weak_form: WeakForm) -> list[CavityEquation]:
    """Return the cavities of unknown pressure on the mesh as it lies, at the pressures that were found; collective."""
    if not solution.cavities:
        return []
    pressures = {report.name: report.pressure for report in solution.cavities}
    cavities = cavity_equations(solution.posed_job, equations.body, weak_form, equations.scales)
    for cavity in cavities:
        cavity.set_pressure(pressures[cavity.name] / equations.scales.stress, 1.0)
    return cavities


def solved_motions(equations: Equations, solution: Solution, system: System) -> list[RemoteBorder]:
    """Return the regions under remote loads with the motions that they have in the present state; collective."""
    motions = []
    for report in solution.remote_loads:
        motion = RemoteBorder(system, report.support, report.load, equations.scales)
        motion.recover(1.0)
        motions.append(motion)
    return motions
