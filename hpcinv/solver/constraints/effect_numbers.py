"""Numbers of effects that a job leaves out, with the constraints by which the solve finds them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.base.quantity.written_units import as_shown
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.constraint_report import ConstraintReport, of_kind
from hpcinv.model.discrete_model import DiscreteModel
from hpcinv.model.parameters import ParameterDirection
from hpcinv.model.weak_form import WeakForm
from hpcinv.solver.constraints.load_numbers import LoadNumbers


@dataclass(frozen=True)
class NumberReport(ConstraintReport):
    """The number of an effect that a solve found.

    Attributes:
        effect: place of the effect in the job.
        number: place among the effects.
        key: name of the number.
        value: in ``unit``, the SI unit.
    """

    section: ClassVar[str] = "constraints"
    what: ClassVar[str] = "a number of a load"

    effect: str
    number: int
    key: str
    value: float
    unit: str
    residual: float

    @property
    def label(self) -> str:
        return self.effect

    @property
    def note(self) -> str:
        return f"{self.key} {as_shown(self.value, self.unit, {})}"

    def as_data(self) -> dict[str, Any]:
        keys = ("effect", "key", "value", "unit", "residual")
        return {key: getattr(self, key) for key in keys}

    def given_in(self, job: Job) -> Job:
        return self._with(job, self.value)

    def posed_in(self, job: Job) -> Job:
        return self._with(job, None)

    def shifted(self, step: Sequence[float]) -> Self:
        return replace(self, value=self.value + float(step[0]))

    def _with(self, job: Job, value: float | None) -> Job:
        effects = list(job.effects)
        effects[self.number] = effects[self.number].model_copy(update={self.key: value})
        return job.model_copy(update={"effects": tuple(effects)})


class EffectConstraint:
    """The equation ``C(x, q, λ) = 0`` of one effect for its unknown number ``q``, in scaled quantities.

    ``q`` is the number times the load factor, in proportion to which its forces are.

    Args:
        place: of the effect among the job's.

    Attributes:
        number: q.
        unit: SI value of a scaled unit of the number.
    """

    def __init__(self, place: int, job: Job, weak_form: WeakForm, scales: Scales) -> None:
        self._place, self._effect, self._weak_form = place, job.effects[place], weak_form
        self._where, self._ingredient = job.named_effects[place][0], len(job.laws) + place
        self._case = job.case_of(self._effect)
        self._dimension = self._effect.quantities()[self._effect.finds][1]
        self.unit = scales.unit_of(self._dimension)
        self._integral, self.number = weak_form.constraints[place], 0.0

    @property
    def _factor(self) -> float:
        return float(self._weak_form.parameters.constant.value[self._case])

    def numbers(self) -> list[tuple[int, str, float]]:
        """Return place, name and value (scaled) of the number at the present load factor."""
        return [(self._ingredient, self._effect.finds, self.number / self._factor)]

    def value(self, load: float) -> float:
        """Return C at the present state, number and load factor, which the weak form has; collective."""
        return self._integral.value()

    def linearise(self, load: float, b: PETSc.Vec) -> float:
        """Set ``b`` to the derivative of C by the state, and return the derivative by q; collective."""
        self._integral.gradient(b)
        entries = self._weak_form.parameters.number_direction(self._ingredient, self._effect.finds)
        return self.rate(ParameterDirection(entries, ())) / self._factor

    def rate(self, direction: ParameterDirection) -> float:
        """Return the derivative of C in a direction of the parameters; collective."""
        return self._integral.rate(direction)

    def report(self, load: float) -> NumberReport:
        """Return the report of the present state, a solution at a load factor; collective."""
        state = self._weak_form.unknowns.state.x.petsc_vec
        row = state.duplicate()
        self._integral.gradient(row)
        terms, error = float(np.abs(row.array * state.array).sum()), abs(self.value(load))
        row.destroy()
        size = self._weak_form.unknowns.mesh.comm.allreduce(terms, op=MPI.SUM)
        residual = error / max(size, error) if error else 0.0
        value = self.number * self.unit
        return NumberReport(self._where, self._place, self._effect.finds, value, self._dimension.unit, residual)


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
