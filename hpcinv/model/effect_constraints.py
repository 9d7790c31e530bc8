"""Equations of effects whose number the solve finds: integrals that are zero at the solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.job.job import Job
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.model.parameters import ParameterDerivative, ParameterDirection
from hpcinv.model.weak_form import WeakForm


@dataclass(frozen=True)
class NumberReport(ConstraintReport):
    """The number of an effect that a solve found.

    Attributes:
        effect: place of the effect in the job.
        number: place among the effects.
        key: name of the number.
        value: in SI.
    """

    section: ClassVar[str] = "constraints"
    what: ClassVar[str] = "a number of a load"

    effect: str
    number: int
    key: str
    value: float
    residual: float

    @property
    def label(self) -> str:
        return self.effect

    @property
    def note(self) -> str:
        return f"{self.key} {self.value:.6g} (SI)"

    def as_data(self) -> dict[str, Any]:
        return {"effect": self.effect, "key": self.key, "value": self.value, "residual": self.residual}

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
        number: place of the effect among the job's.

    Attributes:
        number: q.
        unit: SI value of a scaled unit of the number.
    """

    def __init__(self, place: int, job: Job, weak_form: WeakForm, scales: Scales) -> None:
        self._place, self._effect, self._weak_form = place, job.effects[place], weak_form
        self._where, self._ingredient = job.named_effects[place][0], len(job.laws) + place
        self._case = job.case_of(self._effect)
        self.unit = scales.unit_of(self._effect.quantities()[self._effect.finds][1])
        self._comm, self.number = weak_form.unknowns.mesh.comm, 0.0

    @property
    def _factor(self) -> float:
        return float(self._weak_form.parameters.constant.value[self._case])

    def put(self) -> None:
        """Put the number into the weak form, at its present load factor."""
        self._weak_form.parameters.set_number(self._ingredient, self._effect.finds, self.number / self._factor)

    def value(self, load: float) -> float:
        """Return C at the present state, number and load factor, which the weak form has; collective."""
        return self._total(fem.assemble_vector(self._integral).array)

    def linearise(self, load: float, b: PETSc.Vec) -> float:
        """Set ``b`` to the derivative of C by the state, and return the derivative by q; collective."""
        with b.localForm() as local:
            local.set(0.0)
            fem_petsc.assemble_vector(b, self._gradient)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        parameters = self._weak_form.parameters
        entries = parameters.number_direction(self._ingredient, self._effect.finds)
        return self.rate(ParameterDirection(entries, ())) / self._factor

    def rate(self, direction: ParameterDirection) -> float:
        """Return the derivative of C in a direction of the parameters; collective."""
        b = fem_petsc.create_vector(self._weight.ufl_function_space())
        self._parameter_derivative.assemble(direction, b)
        with b.localForm() as local:
            total = self._total(local.array)
        b.destroy()
        return total

    def report(self, load: float) -> NumberReport:
        """Return the report of the present state, a solution at a load factor; collective."""
        row = self._weak_form.unknowns.state.x.petsc_vec.duplicate()
        self.linearise(load, row)
        terms = np.abs(row.array * self._weak_form.unknowns.state.x.petsc_vec.array).sum()
        size = float(self._comm.allreduce(float(terms), op=MPI.SUM))
        row.destroy()
        residual = abs(self.value(load)) / size if size else 0.0
        return NumberReport(self._where, self._place, self._effect.finds, self.number * self.unit, residual)

    def _total(self, values: Any) -> float:
        return float(self._comm.allreduce(float(values.sum()), op=MPI.SUM))

    @cached_property
    def _form(self) -> Any:
        return self._weak_form.constraints[self._place]

    @cached_property
    def _weight(self) -> Any:
        """A constant of each cell: with it C becomes a vector, which programs assemble."""
        return ufl.TestFunction(fem.functionspace(self._weak_form.unknowns.mesh, ("DG", 0)))

    @cached_property
    def _weighted(self) -> Any:
        parts = self._form.integrals()
        return ufl.Form([part.reconstruct(integrand=part.integrand() * self._weight) for part in parts])

    @cached_property
    def _integral(self) -> fem.Form:
        return fem.form(self._weighted)

    @cached_property
    def _gradient(self) -> fem.Form:
        unknowns = self._weak_form.unknowns
        return fem.form(ufl.derivative(self._form, unknowns.state, unknowns.test))

    @cached_property
    def _parameter_derivative(self) -> ParameterDerivative:
        return ParameterDerivative(self._weighted, self._weak_form.parameters, self._weak_form.unknowns.mesh)
