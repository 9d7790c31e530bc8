"""Numbers of effects that a job leaves out, with the constraints by which the solve finds them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hpcinv.base.quantity.component import Ingredient
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.constraint_report import ConstraintReport, of_kind
from hpcinv.model.discrete_model import DiscreteModel
from hpcinv.model.effect_constraints import EffectConstraint, NumberReport
from hpcinv.solver.constraints.load_numbers import LoadNumbers


class EffectNumbers(LoadNumbers[EffectConstraint]):
    """The unknown numbers of all effects."""

    order = 2

    @classmethod
    def of_job(cls, job: Job, equations: DiscreteModel, system: System) -> Iterable[EffectNumbers]:
        places = [place for place, effect in enumerate(job.effects) if effect.is_unknown]
        found = [EffectConstraint(place, job, system.weak_form, equations.scales) for place in places]
        return [cls(system, found)] if found else []

    def adopt(self, reports: Sequence[ConstraintReport]) -> None:
        values = [report.value for report in of_kind(reports, NumberReport)]
        self.restore(np.array(values) / self.units)
        self.put(1.0)

    def rates(self, parameter: Parameter, job: Job) -> Floats:
        owner, parameters = parameter.owner, self._system.weak_form.parameters
        if not isinstance(owner, Ingredient) or parameter.where not in job.owners:
            return np.zeros(self.count)
        local = parameter.where.removeprefix(job.place("effects").removesuffix("effects"))
        direction = parameters.direction({local: owner.rates(parameter.place)})
        return np.array([entry.rate(direction) for entry in self.loads])
