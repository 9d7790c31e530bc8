"""The sections of a job file other than its material and effects."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from hpcinv.expressions import CONSTANTS, Expression
from hpcinv.generators import Value, is_generator, read_parameters
from hpcinv.quantities import AnyQuantity, Length
from hpcinv.schema import ListOf, Location, Problems, Spec, Triple, raise_if_any, shown
from hpcinv.spelling import did_you_mean
from hpcinv.units import Dimension

type Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
LENGTH = Dimension(length=1)
COORDINATES: dict[str, Dimension | None] = dict.fromkeys(AXES, LENGTH)
POSITIONS = COORDINATES | dict.fromkeys(("X", "Y", "Z", "ux", "uy", "uz"), LENGTH)


def _is_identifier(name: str) -> str:
    if re.fullmatch(r"[A-Za-z_][\w-]*", name) is None:
        raise ValueError(f"{shown(name)} is no name: use letters, digits, _ and -, beginning with a letter")
    return name


Name = Annotated[str, AfterValidator(_is_identifier)]
LengthUnit = Annotated[Length, BeforeValidator(lambda v: f"1 {v}" if isinstance(v, str) and v[:1].isalpha() else v)]
FORMATS = (".py", ".geo", ".msh", ".xdmf", ".vtu")


def directory_of(info: ValidationInfo) -> Path:
    """What paths in the job are relative to."""
    directory: Path = (info.context or {}).get("directory", Path())
    return directory


class MeshFile(Spec):
    """A mesh: a generator, run when it is needed, or a ready-made file."""

    file: str
    """path from the job file to a gmsh generator (.py, .geo) or a ready-made mesh (.msh, .xdmf, .vtu)"""
    parameters: Mapping[str, Value] = {}
    """parameters of the generator, as numbers in SI or quantities"""
    unit: LengthUnit = 1.0
    """length unit of the coordinates in a ready-made file, such as mm"""

    @field_validator("file")
    @classmethod
    def _exists(cls, file: str, info: ValidationInfo) -> str:
        path = directory_of(info) / file
        if path.suffix not in FORMATS:
            raise ValueError(f"{shown(file)} is no mesh that can be read; the endings are {', '.join(FORMATS)}")
        if not path.is_file():
            others = [p.name for p in path.parent.glob("*")] if path.parent.is_dir() else []
            raise ValueError(f"there is no file '{path}'.{did_you_mean(path.name, others, list_all=False)}".rstrip("."))
        return file

    @field_validator("parameters", mode="plain")
    @classmethod
    def _fit_the_generator(cls, given: object, info: ValidationInfo) -> Mapping[str, Value]:
        if not isinstance(given, Mapping):
            raise ValueError(f"must be a mapping of names to values, not {shown(given)}")
        if "file" not in info.data:  # already reported
            return {}
        path = directory_of(info) / info.data["file"]
        if not is_generator(path):
            raise_if_any([((), f"only generators have parameters, and {path.name} is none")] if given else [])
            return {}
        values, problems = read_parameters(path, given)
        raise_if_any(problems)
        return values

    @model_validator(mode="after")
    def _unit_of_a_file(self) -> Self:
        if "unit" in self.model_fields_set and is_generator(Path(self.file)):
            raise Problems((("unit",), "has no use with a generator, which gives its coordinates in metres"))
        return self


class Mesh(MeshFile):
    """The mesh that the job is solved on: of the reference body in a forward analysis, else of the current one."""

    geometry_degree: Literal[1, 2] | None = None
    """degree of the cells' geometry; left out, that of the file, and 1 for generators"""
    partition: Literal["metis", "scotch"] = "metis"
    """what distributes the cells over the ranks"""


class Support(Spec):
    """Prescribed displacement on a region: zero for the components in ``fix``, or given by formulas."""

    region: str
    """physical group of the mesh, a name from 'regions', or 'boundary' for the whole of it"""
    fix: ListOf[Literal["x", "y", "z"]] | None = None
    """components that are held, some of x, y, z"""
    displacement: Triple[Expression | None] | None = None
    """three formulas of x, y, z in the given mesh, or nothing (null) for a free component"""
    constants: Mapping[str, AnyQuantity] = {}
    """values of further names in the formulas"""

    @property
    def held(self) -> frozenset[Axis]:
        """The components that this support prescribes."""
        if self.displacement is None:
            return frozenset(self.fix or ())
        return frozenset(a for a, formula in zip(AXES, self.displacement, strict=True) if formula is not None)

    @model_validator(mode="after")
    def _is_one_of_two(self) -> Self:
        raise_if_any(self._problems())
        return self

    def _problems(self) -> list[tuple[Location, str]]:
        if (self.fix is None) == (self.displacement is None):
            return [((), "needs exactly one of 'fix' (components to hold) and 'displacement' (three formulas)")]
        if not self.held:
            return [((), "holds no component; remove it or name some of x, y, z")]
        if self.displacement is None:
            return [(("constants",), "have no use without 'displacement'")] if self.constants else []
        taken = {*AXES, *CONSTANTS} & self.constants.keys()
        if taken:
            return [(("constants", name), "is already the name of something else") for name in sorted(taken)]
        known = COORDINATES | dict.fromkeys(self.constants)
        formulas = enumerate(self.displacement)
        return [(("displacement", i), text) for i, f in formulas if f is not None and (text := fault(f, known, LENGTH))]


def fault(formula: Expression, known: dict[str, Dimension | None], wanted: Dimension | bool) -> str:
    """What is wrong with a formula of the ``known`` variables for a ``wanted`` dimension (True: a condition), or ''."""
    try:
        found = formula.check(known)
    except ValueError as error:
        return str(error)
    if found == wanted or (found is None and wanted is not True):
        return ""
    return f"must be {_kind(wanted)}, but '{formula}' is {_kind(found)}"


def _kind(found: Dimension | bool | None) -> str:
    return "a condition, such as x < 1 mm" if found is True else str(found or "a number")


class Discretisation(Spec):
    """Finite-element spaces: displacement ``P_k``, and in the mixed form a continuous pressure ``P_m`` with m < k."""

    formulation: Literal["auto", "displacement", "mixed"] = "auto"
    """auto takes the mixed form where the bulk modulus is more than 20 times the shear modulus"""
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


class Solver(Spec):
    """Continuation in the load factor, and the Newton iteration at each of its steps."""

    strategy: Literal["adaptive", "fixed"] = "adaptive"
    """adaptive finds the largest steps that converge; fixed takes equal ones"""
    steps: Annotated[int, Field(ge=1)] = 10
    """number of equal steps (strategy: fixed)"""
    initial_step: Annotated[float, Field(gt=0, le=1)] = 1.0
    """first step in the load factor (strategy: adaptive)"""
    minimum_step: Annotated[float, Field(gt=0, le=1)] = 1e-3
    """step below which the load counts as unreachable (strategy: adaptive)"""
    maximum_iterations: Annotated[int, Field(ge=1)] = 25
    """Newton iterations after which a step has failed"""
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-10
    """residual at which a step has converged, relative to the full external load"""
    reuse_tangent: bool = True
    """keep a factorized tangent for as long as it converges well"""
    petsc: Mapping[str, PetscValue] = {}
    """PETSc options by name, without the dash"""

    @field_validator("petsc")
    @classmethod
    def _have_no_dash(cls, petsc: Mapping[str, Any]) -> Mapping[str, Any]:
        raise_if_any(
            ((key,), f"is written without the dash: {key.lstrip('-')}") for key in petsc if key.startswith("-")
        )
        return petsc

    @model_validator(mode="after")
    def _options_have_a_use(self) -> Self:
        other, idle = {"adaptive": ("fixed", {"steps"}), "fixed": ("adaptive", {"initial_step", "minimum_step"})}[
            self.strategy
        ]
        raise_if_any(
            ((key,), f"has no use with 'strategy: {self.strategy}'; remove it, or take 'strategy: {other}'")
            for key in sorted(idle & self.model_fields_set)
        )
        if self.minimum_step > self.initial_step:
            raise Problems((("minimum_step",), f"must not exceed initial_step, which is {self.initial_step:g}"))
        return self


class Checkpoint(Spec):
    """When converged states are saved for a resume."""

    every: Annotated[int, Field(ge=0), BeforeValidator(lambda value: 0 if value is False else value)] = 1
    """accepted steps between checkpoints; 0 for none"""
    keep: Annotated[int, Field(ge=1)] = 2
    """how many of the last ones are kept"""


class Output(Spec):
    """What a run writes beside its summary."""

    fields: bool = True
    """displacement, pressure, volume ratio and Cauchy stress for ParaView"""
    mesh: ListOf[Literal["msh", "vtu"]] = ("msh", "vtu")
    """formats of the recovered shape"""


class QuantityOfInterest(Spec):
    """A number to print and keep: the displacement or a formula at a point, or a formula reduced over a region.

    Formulas know the reference position X, Y, Z, the current position x, y, z and the displacement ux, uy, uz.
    """

    name: Name
    """what it is called in the summary"""
    of: Expression
    """'displacement' (the vector, at a point), or a formula"""
    at: Triple[Length] | None = None
    """a point in the given mesh"""
    on: str | None = None
    """a region, over whose nodes the formula is reduced"""
    reduce: Literal["max", "min", "mean", "max_abs", "rms"] | None = None
    """how the values on a region become one"""

    @property
    def is_displacement(self) -> bool:
        return self.of.source.strip() == "displacement"

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        problems: list[tuple[Location, str]] = []
        if (self.at is None) == (self.on is None):
            problems.append(((), "needs exactly one of 'at' (a point) and 'on' (a region)"))
        elif self.on is not None and self.reduce is None:
            problems.append((("reduce",), "is needed on a region: max, min, mean, max_abs or rms"))
        elif self.at is not None and self.reduce is not None:
            problems.append((("reduce",), "has no use at a point"))
        if self.is_displacement and self.on is not None:
            problems.append((("of",), "is a vector; on a region take a formula, such as norm(ux, uy, uz)"))
        elif not self.is_displacement:
            try:
                found = self.of.check(POSITIONS)
            except ValueError as error:
                problems.append((("of",), str(error)))
            else:
                if found is True:
                    problems.append((("of",), f"must be a number, but '{self.of}' is a condition"))
        raise_if_any(problems)
        return self
