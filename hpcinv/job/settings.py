"""The sections of a job file that say how it is solved, and what is kept of that."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    Field,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from hpcinv.files.untrusted import applies, option_fault
from hpcinv.quantity.schema import ListOf, Problems, Spec, raise_if_any, shown


class Discretisation(Spec):
    """Finite-element spaces: displacement ``P_k``, and in the mixed form a continuous pressure ``P_m`` with m < k."""

    formulation: Literal["auto", "displacement", "mixed"] = "auto"
    """auto takes the mixed form where the bulk modulus is more than 10 times the shear modulus"""
    displacement: Annotated[int, Field(ge=1, le=4)] = 2
    """degree of the displacement"""
    pressure: Annotated[int, Field(ge=1, le=3)] | None = None
    """degree of the pressure in the mixed form; left out, one below the displacement's"""
    quadrature: Annotated[int, Field(ge=1, le=20)] | None = None
    """degree of the quadrature; left out, it follows from the other degrees"""

    @model_validator(mode="after")
    def _is_stable_pair(self) -> Self:
        if self.formulation == "displacement" and self.pressure is not None:
            raise Problems((("pressure",), "has no use in the displacement form, which has no pressure"))
        if self.formulation == "mixed" and self.displacement == 1:
            raise Problems(
                (("displacement",), "must be 2 or more in the mixed form: there is no stable pressure for 1")
            )
        if self.pressure is not None and self.pressure >= self.displacement:
            text = f"must be below the displacement's degree {self.displacement}: other pairs are unstable"
            raise Problems((("pressure",), text))
        return self


def _petsc_value(value: object) -> str | int | float | bool | None:
    if value is None or isinstance(value, str | int | float | bool):
        return value
    raise ValueError(f"must be text, a number, true, false or nothing (for a flag), not {shown(value)}")


PetscValue = Annotated[
    str | int | float | bool | None,
    PlainValidator(_petsc_value),
    WithJsonSchema({"type": ["string", "number", "boolean", "null"]}),
]


Rescue = Literal["bulk-modulus", "arc-length", "line-search", "anderson"]

_USES: Mapping[str, tuple[str, ...]] = {
    "steps": ("fixed",),
    "initial_step": ("adaptive", "arc-length"),
    "minimum_step": ("adaptive", "arc-length"),
    "rescue": ("adaptive", "arc-length"),
    "limit_points": ("arc-length",),
    "maximum_steps": ("arc-length",),
}
"""The strategies with which an option has a use."""


class Solver(Spec):
    """Continuation in the load factor, and the Newton iteration at each of its steps."""

    strategy: Literal["adaptive", "fixed", "arc-length"] = "adaptive"
    """adaptive finds the largest steps that converge, fixed takes equal ones, arc-length passes limit points"""
    steps: Annotated[int, Field(ge=1)] = 10
    """number of equal steps (strategy: fixed)"""
    initial_step: Annotated[float, Field(gt=0, le=1)] = 1.0
    """first step in the load factor (strategy: adaptive or arc-length)"""
    minimum_step: Annotated[float, Field(gt=0, le=1)] = 1e-3
    """step below which the load counts as unreachable (adaptive), relative to the displacement (arc-length)"""
    limit_points: Annotated[int, Field(ge=0)] = 0
    """limit points of the load to pass before the state at full load counts (strategy: arc-length)"""
    maximum_steps: Annotated[int, Field(ge=1)] = 200
    """steps along the path after which it is given up (strategy: arc-length)"""
    rescue: ListOf[Rescue] = ("bulk-modulus", "arc-length", "line-search", "anderson")
    """what is tried, in this order, where the strategy fails (adaptive or arc-length); [] for nothing"""
    maximum_iterations: Annotated[int, Field(ge=1)] = 25
    """Newton iterations after which a step has failed"""
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-12
    """estimated error of the displacement, relative to it, at which the full load has converged"""
    maximum_unknowns: Annotated[int, Field(ge=1)] = 2_000_000
    """largest number of unknowns that 'accuracy' may take"""
    reuse_tangent: bool = True
    """keep a factorized tangent for as long as it converges well"""
    linear: Literal["auto", "direct", "iterative"] = "auto"
    """direct factorizes (MUMPS), iterative is FGMRES with multigrid; auto goes by size, shape and memory"""
    petsc: Mapping[str, PetscValue] = {}
    """PETSc options by name, without the dash"""

    @field_validator("petsc")
    @classmethod
    def _have_no_dash(cls, petsc: Mapping[str, Any], info: ValidationInfo) -> Mapping[str, Any]:
        raise_if_any(
            ((key,), f"is written without the dash: {key.lstrip('-')}") for key in petsc if key.startswith("-")
        )
        if applies(info):
            raise_if_any(((key,), fault) for key, value in petsc.items() if (fault := option_fault(key, value)))
        return petsc

    @model_validator(mode="after")
    def _options_have_a_use(self) -> Self:
        raise_if_any(
            ((key,), f"has no use with 'strategy: {self.strategy}'; remove it, or take 'strategy: {uses[0]}'")
            for key, uses in sorted(_USES.items())
            if key in self.model_fields_set and self.strategy not in uses
        )
        if self.minimum_step > self.initial_step:
            raise Problems((("minimum_step",), f"must not exceed initial_step, which is {self.initial_step:g}"))
        return self


class FixedPoint(Spec):
    """Iteration of the methods that look for the undeformed shape by forward solves (method: sellier, aitken, …)."""

    relaxation: Annotated[float, Field(gt=0, le=1)] = 1.0
    """share of each correction that is taken (sellier), or of the first one (aitken, rausch, anderson)"""
    memory: Annotated[int, Field(ge=1, le=50)] = 5
    """earlier steps that an update learns from (anderson)"""
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-10
    """largest distance of the loaded body from the given one at which it ends, relative to the body's diagonal"""
    maximum_iterations: Annotated[int, Field(ge=1)] = 50
    """forward problems after which it is given up"""
    warm_start: bool = True
    """begin each forward solve with the displacement known so far, at full load; else at no load, as the first"""


class CertificateSettings(Spec):
    """What is checked when a run has ended. Each of these costs a factorization or more and can be left out."""

    round_trip: Literal["near", "path", "off"] = "near"
    """solve back from the body that was found, starting near the known displacement, or unloaded (path)"""
    stability: bool = True
    """whether the loaded body is in stable equilibrium, and whether the path to it passed a limit point"""
    estimate: bool = True
    """discretisation error of the quantities and of the shape, by a correction in spaces of one degree more"""
    overlap: bool = True
    """whether the body that was found passes through itself"""


class Checkpoint(Spec):
    """When converged states are saved for a resume."""

    every: Annotated[int, Field(ge=0), BeforeValidator(lambda value: 0 if value is False else value)] = 1
    """accepted steps between checkpoints; 0 for none"""
    seconds: Annotated[float, Field(ge=0)] = 0.0
    """least time between checkpoints, for steps that take less than writing one"""
    keep: Annotated[int, Field(ge=1)] = 2
    """how many of the last ones are kept"""


class Output(Spec):
    """What a run writes beside its summary."""

    fields: bool = True
    """displacement, pressure, volume ratio and Cauchy stress for ParaView"""
    mesh: ListOf[Literal["bp", "msh", "vtu"]] | None = None
    """formats of the recovered shape; left out, bp if the job's mesh is a partitioned one, else msh and vtu"""
    unit_warnings: bool = True
    """whether sizes, masses and loads that look like a mistake in a unit are told"""
    summary: ListOf[Literal["json", "h5"]] = ("json", "h5")
    """formats of the summary; json must be among them"""

    @field_validator("summary")
    @classmethod
    def _can_be_read_again(cls, summary: tuple[str, ...]) -> tuple[str, ...]:
        if "json" not in summary:
            raise ValueError("must hold json, which tells whether a run is finished")
        return summary
