"""The sections of a job file that describe the body: its mesh, where it is held, and what is asked about it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    BeforeValidator,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from hpcinv.files.names import exists, is_file
from hpcinv.files.untrusted import applies, mesh_fault
from hpcinv.job import msh_format
from hpcinv.job.mesh_generators import Value, in_unit, is_generator, read_parameters
from hpcinv.job.mesh_header import HEADER, SUFFIX
from hpcinv.quantity.expressions import Expression, faults, faults_with_constants
from hpcinv.quantity.parameter_paths import Number, with_scalar
from hpcinv.quantity.quantity import AnyQuantity, Length, Size
from hpcinv.quantity.schema import ListOf, Location, Name, Problems, Spec, Triple, raise_if_any, shown
from hpcinv.quantity.stress_measures import COMPONENTS, MEASURES
from hpcinv.quantity.suggestions import did_you_mean
from hpcinv.quantity.units import Dimension

type Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
LENGTH = Dimension(length=1)
COORDINATES: dict[str, Dimension | None] = dict.fromkeys(AXES, LENGTH)
POSITIONS = COORDINATES | dict.fromkeys(("X", "Y", "Z", "ux", "uy", "uz"), LENGTH)
STRESS = Dimension(length=-1, mass=1, time=-2)
STRESSES = (*COMPONENTS, *MEASURES, "energy")
FIELDS: dict[str, Dimension | None] = {"J": Dimension(), **dict.fromkeys(STRESSES, STRESS)}

LengthUnit = Annotated[Size, BeforeValidator(lambda v: f"1 {v}" if isinstance(v, str) and v[:1].isalpha() else v)]
REACTIONS = {"reaction": "N", "reaction_moment": "N m"}
FORMATS = (".py", ".geo", ".msh", ".xdmf", ".vtu", SUFFIX)


def directory_of(info: ValidationInfo) -> Path:
    """What paths in the job are relative to."""
    directory: Path = (info.context or {}).get("directory", Path())
    return directory


def _msh_fault(path: Path) -> str:
    try:
        return msh_format.fault_of(path)
    except OSError as error:
        return f"cannot be read: {error.strerror}"


class MeshFile(Spec):
    """A mesh: a generator, run when it is needed, or a ready-made file."""

    file: str
    """path from the job file to a gmsh generator (.py, .geo), a ready-made mesh (.msh, .xdmf, .vtu), or one that
    'hpcinv mesh partition' has made of these (.bp), which no rank reads as a whole"""
    unit: LengthUnit = 1.0
    """length unit of the coordinates in a ready-made file, or that a Python generator works in, such as mm: lengths
    reach it in that unit, for bodies so small or large that gmsh's absolute tolerances do not suit metres"""
    parameters: Mapping[str, Value] = {}
    """parameters of the generator, as numbers in SI or quantities"""

    @property
    def is_partitioned(self) -> bool:
        """Whether all ranks read some parts of it each, and none the whole."""
        return Path(self.file).suffix == SUFFIX

    @field_validator("file")
    @classmethod
    def _exists(cls, file: str, info: ValidationInfo) -> str:
        path = directory_of(info) / file
        if path.suffix not in FORMATS:
            raise ValueError(f"{shown(file)} is no mesh that can be read; the endings are {', '.join(FORMATS)}")
        if applies(info) and (fault := mesh_fault(directory_of(info), file)):
            raise ValueError(f"{shown(file)} {fault}")
        if not exists(path):
            others = [p.name for p in path.parent.glob("*")] if exists(path.parent) else []
            near = did_you_mean(path.name, others, list_all=False)
            raise ValueError(f"there is no file '{path}'.{near or ' Paths start from the directory of the job file'}")
        if not is_file(path / HEADER if path.suffix == SUFFIX else path):
            raise ValueError(f"'{path}' is not what its ending says; 'hpcinv mesh partition' makes a partitioned mesh")
        if path.suffix == msh_format.SUFFIX and (fault := _msh_fault(path)):
            raise ValueError(f"'{path}' {fault}")
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
        values, problems = read_parameters(path, given, info.data.get("unit", 1.0))
        raise_if_any(problems)
        return values

    @model_validator(mode="after")
    def _unit_of_a_file(self, info: ValidationInfo) -> Self:
        if "unit" in self.model_fields_set and self.is_partitioned:
            raise Problems((("unit",), "has no use with a partitioned mesh, which is in metres"))
        if "unit" not in self.model_fields_set or not is_generator(Path(self.file)):
            return self
        if Path(self.file).suffix == ".geo":
            raise Problems(
                (("unit",), "has no use with a .geo script, which does not say which parameters are lengths")
            )
        try:
            in_unit(directory_of(info) / self.file, self.parameters, self.unit)
        except ValueError as error:
            raise Problems((("unit",), str(error))) from None
        return self


class MeshSpec(MeshFile):
    """The mesh that the job is solved on: of the reference body in a forward analysis, else of the current one."""

    geometry_degree: Literal[1, 2] | None = None
    """degree of the cells' geometry; left out, that of the file, and 1 for generators"""
    maximum_cells: Annotated[int, Field(ge=1)] = 10_000_000
    """cells that a generator may make: where more are expected, meshing stops before it begins in earnest"""
    partition: Literal["metis", "scotch"] = "metis"
    """what distributes the cells over the ranks; a partitioned mesh (.bp) is so already, unless scotch does it anew"""

    @model_validator(mode="after")
    def _degree_of_parts(self) -> Self:
        if self.geometry_degree is not None and self.is_partitioned:
            text = "is that of the partitioned mesh; give it to 'hpcinv mesh partition' as --geometry-degree"
            raise Problems((("geometry_degree",), text))
        return self


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
    case: Name | None = None
    """load case (a name from 'load_cases') in which the body is moved; left out, the first"""

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

    def numbers(self) -> dict[Location, Number | str]:
        """The constants of the formulas, by place."""
        return {("constants", name): Number(value, None) for name, value in self.constants.items()}

    def with_number(self, place: Location, number: float) -> Self:
        """The same with another constant (SI) at one of the places of `numbers`."""
        return self.model_copy(update={"constants": with_scalar(self.constants, place[1:], number)})

    def _problems(self) -> list[tuple[Location, str]]:
        if (self.fix is None) == (self.displacement is None):
            return [((), "needs exactly one of 'fix' (components to hold) and 'displacement' (three formulas)")]
        if not self.held:
            return [((), "holds no component; remove it or name some of x, y, z")]
        if self.displacement is None and self.case is not None:
            return [(("case",), "has no use without 'displacement': what is fixed is fixed in every load case")]
        if self.displacement is None:
            return [(("constants",), "have no use without 'displacement'")] if self.constants else []
        return faults_with_constants("displacement", self.displacement, self.constants, COORDINATES, LENGTH)


class QuantityOfInterest(Spec):
    """A number to print and keep: the displacement or a formula at a point, a formula reduced over a region, or the
    force or moment of the supports of a region.

    Formulas know the reference position X, Y, Z, the current position x, y, z, the displacement ux, uy, uz, the volume
    ratio J, the Cauchy stress sxx, syy, szz, sxy, syz, sxz, scalars made of it such as p = -(sxx + syy + szz)/3 and
    von_mises, and the energy stored per reference volume.
    """

    name: Name
    """what it is called in the summary"""
    of: Expression
    """'displacement' (the vector, at a point), 'reaction' (the force that the supports of a region exert on the body),
    'reaction_moment' (its moment), or a formula"""
    at: Triple[Length] | None = None
    """a point in the given mesh"""
    on: str | None = None
    """a region over which the formula is reduced: positions over its nodes, else over its cells or, without, facets;
    or, for a reaction, the region of a support"""
    reduce: Literal["max", "min", "mean", "max_abs", "rms", "integral"] | None = None
    """how the values on a region become one"""
    over: Literal["reference", "current"] | None = None
    """body whose volume or area an integral, mean or rms is over; left out, means and rms of stresses: reference"""
    about: Triple[Length] | None = Field(default=None, exclude_if=lambda about: about is None)
    """the point that a reaction_moment is about; left out, the origin"""

    @property
    def is_displacement(self) -> bool:
        return self.of.source.strip() == "displacement"

    @property
    def is_reaction(self) -> bool:
        """Whether it is the force or the moment of supports."""
        return self.of.source.strip() in REACTIONS

    @property
    def is_moment(self) -> bool:
        """Whether it is the moment of supports."""
        return self.of.source.strip() == "reaction_moment"

    @property
    def is_vector(self) -> bool:
        return self.is_displacement or self.is_reaction

    @property
    def fields(self) -> frozenset[str]:
        """The names in the formula that only the solved scene knows."""
        return self.of.names & FIELDS.keys()

    @property
    def by_quadrature(self) -> bool:
        """Whether it is reduced over the volume or area of a region, rather than over its nodes."""
        return self.on is not None and (self.over is not None or bool(self.fields))

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        raise_if_any(self._problems_of_reaction() if self.is_reaction else self._problems())
        return self

    def _problems_of_reaction(self) -> list[tuple[Location, str]]:
        problems: list[tuple[Location, str]] = []
        if self.on is None:
            problems.append((("on",), "is needed for a reaction: the region of a support"))
        for field in ("at", "reduce", "over"):
            if getattr(self, field) is not None:
                problems.append(((field,), "has no use with a reaction, which is a sum over the region of a support"))
        if self.about is not None and not self.is_moment:
            problems.append((("about",), "has a use only with 'of: reaction_moment'"))
        return problems

    def _problems(self) -> list[tuple[Location, str]]:
        problems: list[tuple[Location, str]] = []
        if (self.at is None) == (self.on is None):
            problems.append(((), "needs exactly one of 'at' (a point) and 'on' (a region)"))
        elif self.on is not None and self.reduce is None:
            problems.append((("reduce",), "is needed on a region: max, min, mean, max_abs, rms or integral"))
        elif self.at is not None and self.reduce is not None:
            problems.append((("reduce",), "has no use at a point"))
        if self.over is None and self.on is not None and self.reduce == "integral":
            problems.append((("over",), "is needed for an integral: over the 'reference' or the 'current' body"))
        elif self.over is not None and (self.on is None or self.reduce in ("max", "min", "max_abs")):
            problems.append((("over",), "has a use only with an integral, a mean or rms on a region"))
        if self.is_displacement and self.on is not None:
            problems.append((("of",), "is a vector; on a region take a formula, such as norm(ux, uy, uz)"))
        elif not self.is_displacement:
            problems += faults([(("of",), self.of)], POSITIONS | FIELDS, None)
        if self.about is not None:
            problems.append((("about",), "has a use only with 'of: reaction_moment'"))
        return problems
