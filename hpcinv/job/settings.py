"""Sections of a job file for the solution methods, checks and output."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.files.untrusted import FileBeside, applies, option_fault
from hpcinv.base.mesh_formats import SAVED, mesh_fault
from hpcinv.base.quantity.schema import Faults, ListOf, Spec, raise_if_any, shown
from hpcinv.base.reading.door import REFUSED

if TYPE_CHECKING:
    SavedFormat = str
else:
    SavedFormat = Literal[SAVED]


class Discretisation(Spec):
    """Finite-element spaces: displacement ``P_k``, and in the mixed form a continuous pressure ``P_m`` with m < k."""

    formulation: Literal["auto", "displacement", "mixed"] = "auto"
    """auto chooses the mixed form if the bulk modulus is more than 10 times the shear modulus"""
    displacement: Annotated[int, Field(ge=1, le=4)] = 2
    """degree of the displacement"""
    pressure: Annotated[int, Field(ge=1, le=3)] | None = None
    """degree of the pressure in the mixed form; by default one below the degree of the displacement"""
    quadrature: Annotated[int, Field(ge=1, le=20)] | None = None
    """degree of the quadrature: by default, and at least, 2 k - 2 on tetrahedra (1 for k = 1) and 2 k on hexahedra, for
    displacements of degree k; less leaves spurious motions of the cells without energy. All weights are positive"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.formulation == "displacement" and self.pressure is not None:
            yield ("pressure",), "is not valid in the displacement form, which has no pressure"
        elif self.formulation == "mixed" and self.displacement == 1:
            yield ("displacement",), "must be 2 or more in the mixed form: there is no stable pressure for 1"
        elif self.pressure is not None and self.pressure >= self.displacement:
            yield (
                ("pressure",),
                f"must be below the displacement's degree {self.displacement}: other pairs are unstable",
            )


def _petsc_value(value: object) -> str | int | float | bool | None:
    if value is None or isinstance(value, str | int | float | bool):
        return value
    raise ValueError(f"must be text, a number, true, false or nothing (for a flag), not {shown(value)}")


PetscValue = Annotated[
    str | int | float | bool | None,
    PlainValidator(_petsc_value),
    WithJsonSchema({"type": ["string", "number", "boolean", "null"]}),
]


Rescue = Literal["arc-length", "line-search", "anderson"]

_USES: Mapping[str, tuple[str, ...]] = {
    "continuation": ("adaptive",),
    "steps": ("fixed",),
    "initial_step": ("adaptive", "arc-length"),
    "minimum_step": ("adaptive", "arc-length"),
    "rescue": ("adaptive", "arc-length"),
    "limit_points": ("arc-length",),
    "maximum_steps": ("arc-length",),
    "start": ("adaptive",),
}
"""Strategies for which an option is valid."""


class Solver(Spec):
    """Continuation in the load factor, and the Newton iteration in each step."""

    strategy: Literal["adaptive", "fixed", "arc-length"] = "adaptive"
    """adaptive finds the largest steps that converge, fixed takes equal steps, arc-length passes limit points"""
    continuation: Literal["auto", "series", "steps"] = "auto"
    """path to the full load (strategy: adaptive): power series of many orders, or steps; auto takes a series where a
    step fails, or a large body would take several tangents; all take steps where there is no series, as with contact"""
    branch: Annotated[Literal["first", "positive", "negative"], Field(exclude_if=lambda branch: branch == "first")] = (
        "first"
    )
    """path to follow at the first bifurcation (continuation: series): the present one, or the other one along the
    direction that the certificate prints (positive) or against it (negative)"""
    steps: Annotated[int, Field(ge=1)] = 10
    """number of equal steps (strategy: fixed)"""
    initial_step: Annotated[float, Field(gt=0, le=1)] = 1.0
    """first step in the load factor (strategy: adaptive or arc-length)"""
    minimum_step: Annotated[float, Field(gt=0, le=1)] = 1e-3
    """smallest step before the strategy fails: in the load factor (adaptive), or relative to the displacement
    (arc-length)"""
    limit_points: Annotated[int, Field(ge=0)] = 0
    """number of limit points to pass before the state at full load is accepted (strategy: arc-length)"""
    maximum_steps: Annotated[int, Field(ge=1)] = 200
    """largest number of steps along the path (strategy: arc-length)"""
    rescue: ListOf[Rescue] = ("arc-length", "line-search", "anderson")
    """fallbacks, in this order, if the strategy (adaptive or arc-length) fails; [] for none"""
    patience: Annotated[int, Field(ge=1)] = 500
    """factorizations in solves that fail, also in fallbacks, after which a direction is given up"""
    maximum_iterations: Annotated[int, Field(ge=1)] = 25
    """largest number of Newton iterations in a step"""
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-12
    """estimated relative error of the displacement at which the solution at full load has converged"""
    maximum_unknowns: Annotated[int, Field(ge=1)] = 2_000_000
    """largest number of unknowns that 'accuracy' may use"""
    reuse_tangent: bool = True
    """keep a factorized tangent as long as it converges well"""
    linear: Literal["auto", "direct", "iterative"] = "auto"
    """direct factorizes (MUMPS), iterative is FGMRES with multigrid; auto decides by size, shape and memory, and takes
    the other one if that fails"""
    nested_iteration: Annotated[
        Literal["auto", "on", "off"], Field(exclude_if=lambda nested_iteration: nested_iteration == "auto")
    ] = "auto"
    """begin with the solution on cells twice as large, where a generator makes the mesh: auto for large slender bodies,
    on for all; on is refused for mesh files, and has no effect if the generator takes numbers of divisions only"""
    start: str | None = Field(default=None, exclude_if=lambda start: start is None)
    """directory by 'hpcinv sweep teach', relative to the job: the solve begins with a solution predicted from the cases
    of a sweep"""
    start_shape: FileBeside | None = Field(default=None, exclude_if=lambda start_shape: start_shape is None)
    """mesh file with the cells of the mesh: the computed body as it is roughly known. The path begins there instead of
    at the given body, and the nodal forces that would hold it there are taken away"""
    petsc: Mapping[str, PetscValue] = {}
    """PETSc options by name, without the dash"""

    @field_validator("start_shape")
    @classmethod
    def _is_data(cls, start_shape: str | None, info: ValidationInfo) -> str | None:
        directory = (info.context or {}).get("directory", Path())
        if start_shape is not None and applies(info) and (fault := mesh_fault(directory, start_shape)):
            raise ValueError(f"'{start_shape}' {fault}")
        return start_shape

    @field_validator("start")
    @classmethod
    def _is_ours(cls, start: str | None, info: ValidationInfo) -> str | None:
        if start is not None and applies(info):
            raise ValueError(f"names a directory of results, which would be read, and is {REFUSED}; remove it")
        return start

    @field_validator("petsc")
    @classmethod
    def _check_petsc(cls, petsc: Mapping[str, Any], info: ValidationInfo) -> Mapping[str, Any]:
        raise_if_any(
            ((key,), f"is written without the dash: {key.lstrip('-')}") for key in petsc if key.startswith("-")
        )
        if applies(info):
            raise_if_any(((key,), fault) for key, value in petsc.items() if (fault := option_fault(key, value)))
        return petsc

    def _contradictions(self, info: ValidationInfo) -> Faults:
        for key, uses in sorted(_USES.items()):
            if key in self.model_fields_set and self.strategy not in uses:
                text = f"is not valid with 'strategy: {self.strategy}'"
                yield (key,), f"{text}; remove it, or choose 'strategy: {uses[0]}'"
        if self.branch != "first" and self.continuation != "series":
            yield ("branch",), "is not valid without 'continuation: series', which finds the other path; add that"
        if self.minimum_step > self.initial_step:
            yield ("minimum_step",), f"must not exceed initial_step, which is {self.initial_step:g}"


class FixedPoint(Spec):
    """Iteration of the methods that find the undeformed shape by forward solves (method: sellier, aitken, …)."""

    relaxation: Annotated[float, Field(gt=0, le=1)] = 1.0
    """relaxation factor of each correction (sellier), or of the first one (aitken, rausch, anderson)"""
    memory: Annotated[int, Field(ge=1, le=50)] = 5
    """number of earlier steps used by an update (anderson)"""
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-10
    """largest distance between the loaded and the given body at convergence, relative to the diagonal of the body"""
    maximum_iterations: Annotated[int, Field(ge=1)] = 50
    """largest number of forward problems"""
    warm_start: bool = True
    """start each forward solve from the last displacement at full load; otherwise from the unloaded state"""


_LEVELS: Mapping[str, Mapping[str, Any]] = {
    "off": {"round_trip": "off", "stability": False, "estimate": False, "overlap": False, "surface": False},
    "quick": {"round_trip": "off", "stability": False, "estimate": False, "overlap": True, "surface": False},
    "standard": {"round_trip": "near", "stability": True, "estimate": True, "overlap": True, "surface": True},
    "full": {"round_trip": "path", "stability": True, "estimate": True, "overlap": True, "surface": True},
}
"""Switches of each level of the certificate."""

LEVELS = tuple(_LEVELS)


class CertificateSettings(Spec):
    """Checks at the end of a run: a level, such as ``certificate: quick``, or a level with other switches."""

    level: Literal["off", "quick", "standard", "full"] = "standard"
    """quick: without factorizations; standard: all checks; full: round trip from the unloaded body; off: none"""
    round_trip: Literal["near", "path", "off"] = "near"
    """inverse of the solve, from the recovered body: near the known displacement (near), or unloaded (path)"""
    stability: bool = True
    """check that the loaded body is in stable equilibrium"""
    estimate: bool = True
    """estimate of the discretisation error of quantities and shape, by a correction in spaces of the next degree"""
    overlap: bool = True
    """check that the recovered body does not intersect itself"""
    surface: bool = True
    """standard deviations by errors of the given surface, if these are known (mesh.surface_error, or an image)"""

    @model_validator(mode="before")
    @classmethod
    def _expand_level(cls, data: Any) -> Any:
        """Replace the name of a level by a mapping, and add the switches of the level."""
        if isinstance(data, str):
            data = {"level": data}
        if not isinstance(data, Mapping):
            return data
        level = data.get("level", "standard")
        return {**(_LEVELS.get(level, {}) if isinstance(level, str) else {}), **data}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"anyOf": [{"enum": list(LEVELS)}, super().__get_pydantic_json_schema__(schema, handler)]}


CountOrNone = Annotated[
    int,
    Field(ge=0),
    BeforeValidator(lambda value: 0 if value is False else value),
    WithJsonSchema({"anyOf": [{"type": "integer", "minimum": 0}, {"const": False}]}),
]
"""A number, or false instead of 0."""


class Checkpoint(Spec):
    """Saving of converged states for a resume."""

    every: CountOrNone = 1
    """accepted steps between checkpoints; 0 for none"""
    seconds: Annotated[float, Field(ge=0)] = 0.0
    """smallest time between checkpoints, for steps that are faster than writing one"""
    keep: Annotated[int, Field(ge=1)] = 2
    """number of checkpoints that are kept, the last ones"""


class Output(Spec):
    """Results that a run writes, with its summary."""

    fields: bool = True
    """displacement, pressure, volume ratio and Cauchy stress for ParaView"""
    mesh: ListOf[SavedFormat] | None = None
    """formats of the recovered shape; by default bp for a partitioned mesh, otherwise msh and vtu"""
    unit_warnings: bool = True
    """warn of sizes, masses and loads that look like a mistake in a unit"""
    summary: ListOf[Literal["json", "h5"]] = ("json", "h5")
    """formats of the summary; json must be among them"""
    surface: bool | None = Field(default=None, exclude_if=lambda surface: surface is None)
    """the boundary with results, for pictures and reports; by default as 'fields'"""
    snapshots: CountOrNone = 20
    """largest number of accepted steps of a solution at which the boundary is kept, for reports; 0 for none"""
    report: bool = False
    """report.html, to look at in a browser"""

    @property
    def has_surface(self) -> bool:
        """True if the boundary is written."""
        return self.report or (self.fields if self.surface is None else self.surface)

    @field_validator("summary")
    @classmethod
    def _check_summary(cls, summary: tuple[str, ...]) -> tuple[str, ...]:
        if "json" not in summary:
            raise ValueError("must contain json: it says whether a run has finished")
        return summary
