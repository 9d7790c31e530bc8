"""Pressures of cavities that a job leaves unknown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hpcinv.job.cavities import Cavity
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.job.states import StateSpec
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.cavities import CavityEquation, cavity_equations
from hpcinv.model.constraint_report import CavityReport, ConstraintReport, of_kind
from hpcinv.model.discrete_model import DiscreteModel
from hpcinv.solver.constraints.load_numbers import LoadNumbers


class CavityPressures(LoadNumbers[CavityEquation]):
    """The pressures of all cavities of unknown pressure, with their equations."""

    order = 1

    @classmethod
    def of_job(cls, job: Job, equations: DiscreteModel, system: System) -> Iterable[CavityPressures]:
        cavities = cavity_equations(job, equations.body, system.weak_form, equations.scales)
        return [cls(system, cavities)] if cavities else []

    def adopt(self, reports: Sequence[ConstraintReport]) -> None:
        pressures = {report.name: report.pressure for report in of_kind(reports, CavityReport)}
        self.restore(np.array([pressures[cavity.name] / cavity.unit for cavity in self.loads]))
        self.put(1.0)

    def equations_on_mesh(self, load: float) -> Floats:
        return np.array([cavity.on_mesh().value(load) for cavity in self.loads])

    def rates(self, parameter: Parameter, job: Job) -> Floats:
        name = None
        if isinstance(parameter.owner, Cavity):
            name = parameter.where.removeprefix("cavities.")
        elif isinstance(parameter.owner, StateSpec) and parameter.owner.name == job.state:
            name = str(parameter.place[1])
        return np.array([c.number_rate(parameter.place) if c.name == name else 0.0 for c in self.loads])
