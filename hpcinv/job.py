"""The job: everything a run needs to know, read from one file, checked at once, and immutable from then on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, ValidationError, ValidationInfo, field_validator

from hpcinv.effects import AnyEffect, Direction
from hpcinv.errors import JobError
from hpcinv.expressions import Expression, faults
from hpcinv.fingerprint import fingerprint
from hpcinv.loading import read_yaml
from hpcinv.materials import Material
from hpcinv.schema import ListOf, Problems, Spec, at, problems_in, raise_if_any
from hpcinv.sections import AXES, COORDINATES, MeshFile, Name, QuantityOfInterest, Support
from hpcinv.sections import MeshSpec as MeshSpec  # part of this module's interface
from hpcinv.settings import Checkpoint, Discretisation, Output, Solver

NEARLY_INCOMPRESSIBLE = 20.0  # bulk-to-shear ratio above which displacements alone lock


class Job(Spec):
    """From a deformed shape to the undeformed one (inverse), the other way (forward), or there and back (round_trip).

    Quantities are SI floats, whatever units the file has. Paths are as in the file; `resolve` makes them usable.
    """

    job: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")] = "job"
    """letters, digits, dots, _ and - that name the results; left out, the name of the file"""
    analysis: Literal["inverse", "forward", "round_trip"] = "inverse"
    """inverse: the mesh is the deformed body; forward: it is the undeformed one; round_trip: one after the other"""
    first: Literal["inverse", "forward"] | None = None
    """which leg of a round trip comes first; left out, inverse"""
    mesh: MeshSpec
    """the mesh of the given body, such as {file: ../meshes/beam.msh, unit: mm}"""
    regions: Mapping[Name, Expression] = {}
    """parts of the given body by conditions on x, y, z, for meshes without physical groups"""
    material: Material
    """the material law and its parameters"""
    effects: ListOf[AnyEffect] = ()
    """what loads or strains the body"""
    supports: Annotated[ListOf[Support], Field(json_schema_extra={"minItems": 1})]
    """where the body is held; unless something holds it, it can move as a rigid body and there is no one answer"""
    discretisation: Discretisation = Discretisation()
    """finite-element spaces"""
    solver: Solver = Solver()
    """continuation and Newton iteration"""
    checkpoint: Checkpoint = Checkpoint()
    """when converged states are saved"""
    output: Output = Output()
    """what is written beside the summary"""
    quantities: ListOf[QuantityOfInterest] = ()
    """numbers to report"""
    expected_shape: MeshFile | None = None
    """a mesh with the same nodes, from which the distance of the recovered shape is reported"""

    _path: Path | None = PrivateAttr(default=None)

    @property
    def path(self) -> Path | None:
        """The file that the job was read from."""
        return self._path

    def resolve(self, path: str | Path) -> Path:
        """A path of the job file as one that can be opened."""
        return (self._path.parent if self._path else Path()) / path

    @property
    def legs(self) -> tuple[Direction, ...]:
        """The directions to solve in, in order."""
        if self.analysis != "round_trip":
            return (self.analysis,)
        return ("forward", "inverse") if self.first == "forward" else ("inverse", "forward")

    @property
    def is_mixed(self) -> bool:
        """Whether the pressure is an unknown."""
        chosen = self.discretisation.formulation
        return chosen == "mixed" or (chosen == "auto" and _is_nearly_incompressible(self.material))

    @property
    def pressure_degree(self) -> int | None:
        """Degree of the pressure, None in the displacement form."""
        return (self.discretisation.pressure or self.discretisation.displacement - 1) if self.is_mixed else None

    def fingerprint(self) -> dict[str, Any]:
        """The physics as plain data: what must not change between a checkpoint and its resume."""
        return fingerprint(self)

    # The rules between sections stand with the later section, which sees the earlier ones that are right in themselves.

    @field_validator("first")
    @classmethod
    def _first_of_two(cls, first: str | None, info: ValidationInfo) -> str | None:
        if first is not None and info.data.get("analysis", "round_trip") != "round_trip":
            raise ValueError("has a use only with 'analysis: round_trip'")
        return first

    @field_validator("regions")
    @classmethod
    def _are_conditions(cls, regions: Mapping[str, Expression]) -> Mapping[str, Expression]:
        if "boundary" in regions:
            raise Problems((("boundary",), "is already the name of the whole boundary; take another"))
        raise_if_any(faults((((name,), formula) for name, formula in regions.items()), COORDINATES, True))
        return regions

    @field_validator("effects")
    @classmethod
    def _serve_the_analysis(cls, effects: tuple[AnyEffect, ...], info: ValidationInfo) -> tuple[AnyEffect, ...]:
        analysis = info.data.get("analysis")
        needed = {"forward", "inverse"} if analysis == "round_trip" else {analysis} - {None}
        raise_if_any(
            ((i,), f"cannot serve 'analysis: {analysis}'; it knows {', '.join(sorted(effect.directions))} only")
            for i, effect in enumerate(effects)
            if needed - effect.directions
        )
        return effects

    @field_validator("supports")
    @classmethod
    def _hold_the_body(cls, supports: tuple[Support, ...]) -> tuple[Support, ...]:
        free = set(AXES).difference(*(s.held for s in supports))
        if free:
            text = f"leave the body free to move along {' and '.join(sorted(free))}: hold it there in some region"
            raise ValueError(text)
        taken: set[tuple[str, str]] = set()
        for i, support in enumerate(supports):
            held = {(support.region, axis) for axis in support.held}
            for region, axis in sorted(held & taken):
                raise Problems(((i,), f"prescribes {axis} on '{region}' a second time"))
            taken |= held
        return supports

    @field_validator("discretisation")
    @classmethod
    def _suits_the_material(cls, discretisation: Discretisation, info: ValidationInfo) -> Discretisation:
        material = info.data.get("material")
        if material is None or not _is_nearly_incompressible(material):
            return discretisation
        if discretisation.formulation == "displacement" and material.bulk_modulus == float("inf"):
            raise Problems((("formulation",), "must be mixed (or auto), since the material is incompressible"))
        if discretisation.formulation == "auto" and discretisation.displacement == 1:
            text = (
                "must be 2 or more: the material is nearly incompressible, so the mixed form is chosen, in which 1 has "
                "no stable pressure (or state 'formulation: displacement')"
            )
            raise Problems((("displacement",), text))
        return discretisation

    @field_validator("quantities")
    @classmethod
    def _have_own_names(cls, quantities: tuple[QuantityOfInterest, ...]) -> tuple[QuantityOfInterest, ...]:
        names = [q.name for q in quantities]
        raise_if_any(
            ((i, "name"), f"'{name}' is the name of an earlier quantity")
            for i, name in enumerate(names)
            if name in names[:i]
        )
        return quantities


def _is_nearly_incompressible(material: Material) -> bool:
    return material.bulk_modulus > NEARLY_INCOMPRESSIBLE * material.shear_modulus


def load(path: str | Path) -> Job:
    """Read and check a job file.

    Raises:
        JobError: with one line for each thing that is wrong, of the form ``file: key: what, and what to do``.
    """
    return parse(read_yaml(Path(path)), Path(path))


def parse(data: Mapping[str, Any], path: Path) -> Job:
    """A job from the contents of its file; ``path`` names it in errors and anchors the relative paths in it.

    Raises:
        JobError: as `load`.
    """
    try:
        job = Job.model_validate({"job": path.stem, **data}, context={"directory": path.parent})
    except ValidationError as error:
        raise JobError([f"{path}: {at(where)}: {what}" for where, what in problems_in(error, Job)]) from None
    job._path = path
    return job


def json_schema() -> dict[str, Any]:
    """JSON Schema of a job file, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Job.model_json_schema()}
