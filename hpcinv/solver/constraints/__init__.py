"""Unknown numbers of loads and supports: one file each, registered by subclassing `Border`."""

from collections.abc import Sequence

from hpcinv.base.quantity.schema import import_modules
from hpcinv.job.job import Job
from hpcinv.model.assembly.system import System
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.model.discrete_model import DiscreteModel
from hpcinv.solver.border import Border, kinds_of_borders

import_modules(__name__, __path__)


def borders_of(job: Job, equations: DiscreteModel, system: System) -> list[Border]:
    """Return the unknown numbers of a job, on the mesh as it lies; collective.

    Args:
        job: may be the job of the equations with other numbers unknown.
    """
    return [border for kind in kinds_of_borders() for border in kind.of_job(job, equations, system)]


def solved_borders(
    job: Job, reports: Sequence[ConstraintReport], equations: DiscreteModel, system: System
) -> list[Border]:
    """Return the unknown numbers of the equations' present state, a solution at full load; collective."""
    for report in reports:
        job = report.posed_in(job)
    if not reports:
        return []
    system.set_load(1.0)
    borders = borders_of(job, equations, system)
    for border in borders:
        border.adopt(reports)
    return borders


__all__ = ["Border", "borders_of", "solved_borders"]
