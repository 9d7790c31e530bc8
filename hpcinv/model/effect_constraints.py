"""Equations of effects whose number the solve finds: integrals that are zero at the solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.base.quantity.written_units import as_shown
from hpcinv.job.job import Job
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.model.parameters import ParameterDirection
from hpcinv.model.weak_form import WeakForm


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
