"""The job: all input of a run, read from one file, completely checked, and immutable."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_validator,
)

from hpcinv.base.files.names import FilePath, is_file
from hpcinv.base.files.untrusted import applies
from hpcinv.base.quantity.expressions import Expression, faults
from hpcinv.base.quantity.keys import JobKey, assigned
from hpcinv.base.quantity.plugins import fault_of_plugin, load_file
from hpcinv.base.quantity.quantity import AnyQuantity
from hpcinv.base.quantity.schema import (
    Faults,
    FileName,
    KeyPath,
    ListOf,
    Name,
    Problems,
    Spec,
    collected,
    dotted_key,
    job_error,
    name_from,
    raise_if_any,
    repeated,
    shown,
)
from hpcinv.base.reading.door import REFUSED, is_asked, path_fault
from hpcinv.base.reading.mesh_format import Groups
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.base.updates import UPDATES
from hpcinv.errors import JobError
from hpcinv.job import rules
from hpcinv.job.cavities import CONTROLS, Cavity, cavities_of_state
from hpcinv.job.combinations import refusal
from hpcinv.job.contradictions import CONTRADICTIONS
from hpcinv.job.fibres import FibreFamily
from hpcinv.job.identification import Identification
from hpcinv.job.interfaces import Interface, interface_of
from hpcinv.job.layers import Layering, layerings_of
from hpcinv.job.mesh_file import ExpectedShape, MeshFile, directory_of
from hpcinv.job.mesh_section import MeshSpec as MeshSpec
from hpcinv.job.owners import families_of, have_derivatives, laws_of, numbered, owners_in_states, owners_of, places_of
from hpcinv.job.preamble import read_preamble
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.region_names import unknown_regions
from hpcinv.job.region_references import REFERENCES, References
from hpcinv.job.region_rules import RegionRule, RegionUnion, VertexSet
from hpcinv.job.sensitivities import Owner, Parameter, Uncertain, read_sensitivities, uncertain_parameters
from hpcinv.job.settings import CertificateSettings, Checkpoint, Discretisation, FixedPoint, Output, Solver
from hpcinv.job.state_differences import quantities_in
from hpcinv.job.states import StateSpec, faults_of_states, rest_of, solve_order
from hpcinv.job.support import Motion, RemoteLoad, Support
from hpcinv.job.vocabulary import REGION_NAMES
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import AnyEffect, Direction, Effect
from hpcinv.physics.effects.contact import Contact
from hpcinv.physics.materials import Material, MaterialLaw

MOST_ENTRIES = 10_000
"""entries of one list of a job, such as quantities: each takes a millisecond to check, and more in a run"""

UNNAMED = "(mapping)"  # instead of the file name of a job that was made in Python
SECTIONS = "sections"
"""Entry that `parse` adds to a context: the job before what follows from several of its sections."""
_KEYS: Any = Mapping[str, str | float | Uncertain | None] | list[str]  # as in a file


@dataclass(frozen=True)
class PlannedSolve:
    """One solve of a job.

    Attributes:
        job: the job, or the job of one state by itself.
        mesh: number of the earlier solve that finds the body on which this one is solved; ``None`` for the given mesh.
        start: number of the earlier solve at whose solution the load path begins; ``None`` for the unloaded body.
        shape: name of the state whose shape it computes; empty without states.
    """

    job: Job
    direction: Direction
    mesh: int | None
    start: int | None = None
    shape: str = ""


class Job(Spec):
    """From a deformed shape to the undeformed one (inverse), the reverse (forward), or both (round_trip).

    Quantities are SI floats. Paths are as in the file; use `resolve` to open them.
    """

    job: FileName = "job"
    """up to 100 letters, digits, dots, _, - (no dot or - first), the name of the results; by default the file name"""
    analysis: Literal["inverse", "forward", "round_trip"] = "inverse"
    """inverse: the mesh is the deformed body; forward: it is the undeformed one; round_trip: one after the other"""
    first: Literal["inverse", "forward"] | None = None
    """direction of a round trip that is solved first; by default inverse"""
    mesh: MeshSpec
    """the mesh of the given body, such as {file: ../meshes/beam.msh, unit: mm}"""
    let: Mapping[Name, Expression] = {}
    """names for parts of formulas, such as {r: "norm(x, y)"}, which all formulas of the job can use"""
    regions: Mapping[Name, RegionRule] = {}
    """parts of the given body by conditions on x, y, z, the outer normal nx, ny, nz, and the number of the cavity; or
    unions of regions and groups of the mesh by their names, such as {skin: [endo, epi]}; or the facet nearest to a
    point with all that is smooth with it, such as {foot: {smooth: [0, 0, 2 mm], angle: 30 deg}}; or vertices, for
    supports of a body whose loads balance, such as {corner: {vertices: [[0, 0, 0]]}}"""
    plugins: ListOf[FilePath] = ()
    """Python files, by paths relative to the job file, that define further laws and effects"""
    files: ListOf[FilePath] = ()
    """further files that generators and plugins read, by paths relative to the job file: with another content
    of one it is another job. Files that they read in Python, or by gmsh from a name in the text, need no entry"""
    fibres: Mapping[Name, FibreFamily] = {}
    """families of fibres by name, for laws and effects that refer to them"""
    material: Material
    """the material law and its parameters, or one for each region of cells: {core: {law: …}, skin: {law: …}}"""
    load_cases: ListOf[Name] = ()
    """names of successive load cases; by default there is one"""
    states: ListOf[StateSpec] = ()
    """states of one body, instead of 'analysis' and 'effects': the given one, the rest shape, and others"""
    effects: ListOf[AnyEffect] = ()
    """loads and inelastic strains of the body"""
    supports: Annotated[ListOf[Support], Field(validate_default=True)] = ()
    """prescribed displacements; not needed if springs (effect: elastic-foundation) hold the body"""
    interfaces: ListOf[Interface] = Field(default=(), exclude_if=lambda interfaces: not interfaces)
    """surfaces of the mesh that belong together, such as {between: [lung, wall], kind: tied}"""
    uncertainty: Literal["contact"] | None = Field(default=None, exclude_if=lambda value: value is None)
    """contact: intervals of quantities over all contact pressures that the given shape admits"""
    cavities: Mapping[Name, Cavity] = Field(default={}, exclude_if=lambda cavities: not cavities)
    """hollows of the body by name, such as {lv: {surface: endo}}, whose volumes are possible quantities; their
    pressures may be unknown, with a given volume, gas or windkessel"""
    discretisation: Discretisation = Discretisation()
    """finite-element spaces"""
    solver: Solver = Solver()
    """continuation and Newton iteration"""
    method: Literal["direct", *UPDATES] = "direct"  # type: ignore[valid-type]
    """direct: one solve on the deformed body; the others find the undeformed body by repeated forward solves"""
    fixed_point: FixedPoint = FixedPoint()
    """iteration of the methods other than direct"""
    certificate: CertificateSettings = CertificateSettings()
    """checks at the end of a run: quick, standard, full, off, or single switches such as {estimate: false}"""
    checkpoint: Checkpoint = Checkpoint()
    """saving of converged states"""
    second_opinion: Literal["calculix"] | None = Field(default=None, exclude_if=lambda program: program is None)
    """calculix: CalculiX loads the rest shape, too, and its body is compared with the given one"""
    output: Output = Output()
    """results that are written with the summary"""
    quantities: ListOf[QuantityOfInterest] = ()
    """numbers that are reported"""
    sensitivities: Mapping[JobKey, Uncertain] = {}
    """numbers of laws, effects, fibres, supports and cavities by which shape and quantities are differentiated: a list
    of their keys, or their standard deviations by key, such as {material.mu: 1 kPa, "effects[0].density": null};
    numbers that change together are one entry, such as
    {"effects[0].density": {sd: 10 kg/m^3, also: ["effects[1].density"]}}"""
    identify: Identification | None = Field(default=None, exclude_if=lambda section: section is None)
    """parameters that 'hpcinv identify' finds together with the rest shape, and observations of other states"""
    expected_shape: ExpectedShape | None = None
    """a mesh with the same nodes, a closed surface or a segmented image, whose distance from the recovered shape is
    reported"""
    accuracy: Mapping[Name, AnyQuantity] = {}
    """largest errors of quantities by name, such as {tip: 0.1 mm}; degree and mesh are then chosen accordingly"""

    _path: Path | None = PrivateAttr(default=None)
    _data: Mapping[str, Any] = PrivateAttr(default_factory=dict)
    _untrusted: bool = PrivateAttr(default=False)
    _state: str = PrivateAttr(default="")
    _whole: Job | None = PrivateAttr(default=None)
    _places: Mapping[str, str] = PrivateAttr(default_factory=dict)

    def __eq__(self, other: object) -> bool:
        """Equality of all values, of the path of the file, and of trust."""
        if not isinstance(other, Job):
            return NotImplemented
        return (dict(self), self._path, self._untrusted) == (dict(other), other._path, other._untrusted)

    @property
    def path(self) -> Path | None:
        """The file from which the job was read; paths in the job are relative to its directory."""
        return self._path

    @property
    def data(self) -> Mapping[str, Any]:
        """Content of the file, before validation."""
        return self._data

    def with_(self, changes: Mapping[str, Any]) -> Job:
        """Copy of the job with other values at some keys, such as ``{"effects[1].pressure": "12 kPa"}``.

        Missing sections are added.

        Raises:
            JobError: a key is not valid, or the changed job is not.
        """
        path = self._path or Path(UNNAMED)
        try:
            return parse(assigned(self._data, changes), path, untrusted=self._untrusted)
        except ValueError as error:
            raise JobError(f"{path}: {error}") from None

    @property
    def is_untrusted(self) -> bool:
        """True if the job was read as untrusted, so that nothing in it is executed."""
        return self._untrusted

    def resolve(self, path: str | Path) -> Path:
        """A path in the job as one that can be opened."""
        return (self._path.parent if self._path else Path()) / path

    @property
    def shape_formats(self) -> tuple[str, ...]:
        if self.output.mesh is not None:
            return self.output.mesh
        given = suffix_of(self.mesh.file).removeprefix(".")
        return (
            ("bp",)
            if self.mesh.is_partitioned
            else (given if given in self.mesh.kind.saved else "msh", *({"vtu"} - {given}))
        )

    @property
    def directions(self) -> tuple[Direction, ...]:
        """The directions in which the job is solved, in order."""
        if self.states:
            return tuple(solve.direction for solve in self.plan)
        if self.analysis != "round_trip":
            return (self.analysis,)
        return ("forward", "inverse") if self.first == "forward" else ("inverse", "forward")

    @property
    def plan(self) -> tuple[PlannedSolve, ...]:
        """The solves of the job in order: of each loaded state, or of each direction of an analysis."""
        if not self.states:
            first, *more = self.directions
            return (PlannedSolve(self, first, None), *(PlannedSolve(self, direction, 0) for direction in more))
        order = solve_order(self.states)
        has_rest = not self.states[order[0]].given  # then the mesh is the rest shape
        solves: list[PlannedSolve] = []
        for i in order:
            direction: Direction = "inverse" if self.states[i].given else "forward"
            names = [solve.job.state for solve in solves]
            start = names.index(start_name) if (start_name := self.states[i].start) in names else None
            shape = self.rest if self.states[i].given else self.states[i].name
            mesh = 0 if solves and not has_rest else None
            solves.append(PlannedSolve(self._job_of_state(i), direction, mesh, start, shape))
        return tuple(solves)

    @property
    def state(self) -> str:
        """Name of the state that this job has; empty without states."""
        return self._state

    @property
    def kind(self) -> str:
        """Description of the solves, for messages."""
        return (
            f"{len(self.states)} state{'s' if len(self.states) > 1 else ''}"
            if self.states
            else f"{self.analysis} analysis"
        )

    @property
    def rest(self) -> str:
        """Name of the rest shape; empty without states."""
        return rest_of(self.states) if self.states else ""

    def _job_of_state(self, number: int) -> Job:
        """The job of one of the loaded states by itself."""
        state = self.states[number]
        cavities = cavities_of_state(self.cavities, state)
        changes = {
            "analysis": "inverse" if state.given else "forward",
            "states": (),
            "cavities": cavities,
            "effects": (*state.effects, *(effect for cavity in cavities.values() for effect in cavity.pressures)),
            "supports": self.supports if state.supports is None else state.supports,
            "quantities": quantities_in(self.quantities, state.name),
        }
        job = self.model_copy(update=changes)
        job._state, job._whole = state.name, self
        job._places = places_of(number, state)
        return job

    def place(self, section: str) -> str:
        """Place of a section of this job in its file, where a state's place differs."""
        return self._places.get(section, section)

    @property
    def controlled_cavities(self) -> dict[str, Cavity]:
        """The cavities of unknown pressure by name."""
        return {name: cavity for name, cavity in self.cavities.items() if cavity.is_controlled}

    @property
    def remote_loads(self) -> dict[int, RemoteLoad]:
        """The remote loads by the numbers of their supports."""
        return {number: spec.remote for number, spec in enumerate(self.supports) if spec.remote is not None}

    def with_motions(self, motions: Mapping[int, Motion]) -> Job:
        """Return the job with rigid motions instead of the remote loads of these supports."""
        supports = list(self.supports)
        for number, motion in motions.items():
            supports[number] = supports[number].model_copy(update={"motion": motion, "remote": None})
        return self.model_copy(update={"supports": tuple(supports)})

    @property
    def own_effect_count(self) -> int:
        """Number of the effects of the file; the effects of unknown pressures of cavities follow them."""
        return len(self.effects) - sum(len(cavity.pressures) for cavity in self.cavities.values())

    def cavity_effects(self, name: str) -> list[int]:
        """Return the places among the effects of a cavity's unknown pressure."""
        first = self.own_effect_count
        for other, cavity in self.cavities.items():
            places = range(first, first + len(cavity.pressures))
            if other == name:
                return list(places)
            first = places.stop
        raise KeyError(name)

    def with_pressures(self, pressures: Mapping[str, float]) -> Job:
        """Return the job with unknown pressures (Pa) of cavities as given ones; the first cavities come first."""
        effects, cavities = list(self.effects), dict(self.cavities)
        for name, pressure in pressures.items():
            for place in self.cavity_effects(name):
                effects[place] = effects[place].model_copy(update={"pressure": pressure})
            cavities[name] = cavities[name].model_copy(update=dict.fromkeys(CONTROLS))
        return self.model_copy(update={"effects": tuple(effects), "cavities": cavities})

    @property
    def laws(self) -> Mapping[str, MaterialLaw]:
        """The material laws by their place in the job: ``material``, or ``material.REGION`` for each region."""
        return laws_of(self.material)

    @property
    def named_effects(self) -> list[tuple[str, Effect]]:
        return list(numbered(self.place("effects"), self.effects).items())

    @property
    def all_interfaces(self) -> tuple[Interface, ...]:
        """The interfaces, and contacts with rigid obstacles that take the part of one."""
        contacts = (effect for effect in self.effects if isinstance(effect, Contact) and effect.is_paired)
        return (*self.interfaces, *map(interface_of, contacts))

    @property
    def families(self) -> dict[str, FibreFamily]:
        """The families of fibres that laws and effects use, by their place in the job."""
        return families_of((*self.laws.values(), *self.effects), self.fibres)

    @property
    def case_count(self) -> int:
        return max(len(self.load_cases), 1)

    def case_of(self, part: Effect | Support) -> int:
        """Index of the load case of an effect or support."""
        return 0 if part.case is None else self.load_cases.index(part.case)

    @property
    def is_mixed(self) -> bool:
        """True if the pressure is an unknown."""
        return self.discretisation.formulation == "mixed" or (
            self.discretisation.formulation == "auto" and self.wants_pressure
        )

    @property
    def wants_pressure(self) -> bool:
        """True if the displacement form would lock, and the pressure can be an unknown."""
        return rules.wants_pressure(self.laws)

    @property
    def pressure_degree(self) -> int | None:
        """Degree of the pressure, or None in the displacement form."""
        return (self.discretisation.pressure or self.discretisation.displacement - 1) if self.is_mixed else None

    @property
    def layerings(self) -> tuple[Layering, ...]:
        """Data that divide the body into layers, with separate pressures in the mixed form; the same for all states."""
        if self._whole is not None:
            return self._whole.layerings
        effects = numbered("effects", self.effects)
        for i, state in enumerate(self.states):
            effects |= numbered(places_of(i, state)["effects"], state.effects)
        return layerings_of(self.laws, effects, self.differentiated)

    @property
    def differentiated(self) -> list[Parameter]:
        """Parameters by which the results are differentiated, in the order of ``sensitivities``."""
        return uncertain_parameters(self.sensitivities, self._owners_in_states) if self.sensitivities else []

    @property
    def unsuited_to_nested_iteration(self) -> str:
        """Reason why the first solve cannot begin with the solution on coarser cells; empty if nothing forbids it."""
        return refusal(self, "nested iteration")

    @property
    def has_derivatives(self) -> bool:
        """True if solutions have derivatives; with contact with a rigid obstacle they have none."""
        return have_derivatives(self.effects, self.states)

    @property
    def owners(self) -> dict[str, Owner]:
        """The parts with numbers by which results can be differentiated, by their place in the job."""
        return owners_of(self.material, self.effects, self.fibres, self.supports, self._places)

    @property
    def _owners_in_states(self) -> dict[str, Owner]:
        """The `owners` of the job and of all its states."""
        return owners_in_states(
            self.material,
            self.effects,
            self.fibres,
            self.supports,
            self.states,
            self.cavities,
            self.mesh.sections_of_kind,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the plugins, which another rank imports before it unpickles their classes."""
        plugins = [self.resolve(p).resolve() for p in self.plugins]
        return _unpickled, (plugins, pickle.dumps((self.__class__, self.__getstate__())))

    @model_validator(mode="before")
    @classmethod
    def _preamble_first(cls, data: Any, info: ValidationInfo) -> Any:
        """Load plugins and resolve definitions; the other sections depend on them."""
        if not isinstance(data, Mapping):
            return data
        problems: list[tuple[KeyPath, str]] = []
        with collected(problems):
            data = {**data, **read_preamble(data, info)}
        raise_if_any(problems)
        return data

    @field_validator("plugins")
    @classmethod
    def _refuse_untrusted_plugins(cls, plugins: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        if applies(info):
            text = f"is a Python file that a run executes, and is {REFUSED}"
            raise_if_any(((i,), f"{shown(plugin)} {text}") for i, plugin in enumerate(plugins))
        return plugins

    @field_validator("files")
    @classmethod
    def _check_files(cls, files: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        for i, file in enumerate(files):
            if applies(info) and (fault := path_fault(directory_of(info), file)):
                raise Problems(((i,), f"{shown(file)} {fault}"))
            if not is_file(directory_of(info) / file):
                raise Problems(((i,), f"there is no file '{directory_of(info) / file}'. Paths start from the job file"))
        return files

    @field_validator("load_cases")
    @classmethod
    def _check_load_cases(cls, cases: tuple[str, ...]) -> tuple[str, ...]:
        raise_if_any(((i,), f"'{cases[i]}' is duplicated") for i in repeated(cases))
        return cases

    @field_validator("regions")
    @classmethod
    def _check_regions(cls, regions: Mapping[str, RegionRule]) -> Mapping[str, RegionRule]:
        if "boundary" in regions:
            raise Problems((("boundary",), "is already the name of the whole boundary; choose another"))
        conditions = {name: rule for name, rule in regions.items() if isinstance(rule, Expression)}
        raise_if_any(faults((((name,), formula) for name, formula in conditions.items()), REGION_NAMES, True))
        names = list(regions)
        for i, (name, rule) in enumerate(regions.items()):
            later = [m for m in rule.names if m in names[i:]] if isinstance(rule, RegionUnion) else []
            if later:
                raise Problems(((name,), f"names '{later[0]}', which is not defined above it; change the order"))
            members = rule.names if isinstance(rule, RegionUnion) else ()
            if single := [m for m in members if isinstance(regions.get(m), VertexSet)]:
                raise Problems(((name,), f"names '{single[0]}', which is a set of vertices: only supports hold these"))
        return regions

    @field_validator("states")
    @classmethod
    def _check_states(cls, states: tuple[StateSpec, ...]) -> tuple[StateSpec, ...]:
        raise_if_any(faults_of_states(states) if states else ())
        return states

    @field_validator("quantities")
    @classmethod
    def _check_quantities(cls, quantities: tuple[QuantityOfInterest, ...]) -> tuple[QuantityOfInterest, ...]:
        names = [q.name for q in quantities]
        raise_if_any(((i, "name"), f"'{names[i]}' is the name of an earlier quantity") for i in repeated(names))
        return quantities

    @field_validator("sensitivities", mode="wrap", json_schema_input_type=_KEYS)
    @classmethod
    def _leave_sensitivities(cls, given: object, handler: ValidatorFunctionWrapHandler) -> object:
        return given  # `_completed` reads it

    @field_validator("accuracy", mode="wrap")
    @classmethod
    def _leave_accuracy(cls, given: object, handler: ValidatorFunctionWrapHandler) -> object:
        return given  # `_completed` reads it

    def _completed(self, info: ValidationInfo) -> Self:
        """The job with what follows from several sections."""
        if info.context is not None:
            info.context[SECTIONS] = self
        return self.model_copy(update=self._following_sections())

    def _following_sections(self) -> dict[str, Any]:
        """Quantities of all states, numbers whose dimension follows from another section, cut meshes, pressures."""
        problems: list[tuple[KeyPath, str]] = []
        sections: dict[str, Any] = {}
        if self.quantities:
            with collected(problems, "quantities"):
                sections["quantities"] = rules.quantities_of_states(
                    self.quantities, self.supports, self.effects, self.states
                )
        if self.sensitivities != {}:
            with collected(problems, "sensitivities"):
                sections["sensitivities"] = read_sensitivities(self.sensitivities, self._owners_in_states)
        if self.accuracy != {}:
            with collected(problems, "accuracy"):
                sections["accuracy"] = rules.read_demands(self.accuracy, sections.get("quantities", self.quantities))
        raise_if_any(problems)
        if self.interfaces:
            sections["mesh"] = self.mesh.cut(tuple(interface.between for interface in self.interfaces))
        if pressures := [effect for cavity in self.cavities.values() for effect in cavity.pressures]:
            sections["effects"] = (*self.effects, *pressures)
        return sections

    def _contradictions(self, info: ValidationInfo) -> Faults:
        for contradictions in CONTRADICTIONS:
            yield from contradictions(self)


def _unpickled(plugins: list[Path], data: bytes) -> Job:
    for plugin in plugins:
        load_file(plugin)
    kind, state = pickle.loads(data)
    job: Job = kind.__new__(kind)
    job.__setstate__(state)
    return job


def load(
    source: str | PathLike[str] | Mapping[str, Any], *, directory: str | PathLike[str] = ".", untrusted: bool = False
) -> Job:
    """Read and check a job: a file, or a mapping with the content of one.

    Args:
        directory: base of relative paths in a mapping; paths in a file are relative to the directory of the file.
        untrusted: refuse everything that could execute code (plugins, generators, partitioned meshes, PETSc options not
            known to be harmless) or leads out of the directory.

    Raises:
        JobError: with one line for each fault, of the form ``file: key: fault, and remedy``.
    """
    if isinstance(source, Mapping):
        return parse({"job": "job", **source}, Path(directory) / UNNAMED, untrusted=untrusted)
    if not isinstance(source, str | PathLike):
        raise JobError(f"a job is a path of a file or a mapping with the content of one, not {shown(source)}")
    return parse(read_yaml(Path(source)), Path(source), untrusted=untrusted)


def parse(
    data: Mapping[str, Any], path: Path, *, untrusted: bool = False, context: dict[str, Any] | None = None
) -> Job:
    """Check the content of a job file, as `load` does; relative paths start from the directory of ``path``.

    Args:
        context: to it is added what the sections are read with, and `SECTIONS`.
    """
    untrusted = untrusted or is_asked()
    large = {key: len(value) for key, value in data.items() if isinstance(value, list) and len(value) > MOST_ENTRIES}
    if large:
        text = f"entries, but may have {MOST_ENTRIES:,}"
        raise JobError(*(f"{path}: {key}: has {count:,} {text}" for key, count in large.items()))
    context = {} if context is None else context
    context |= {"directory": path.parent, "untrusted": untrusted}
    try:
        job = Job.model_validate({"job": name_from(path), **data}, context=context)
    except ValidationError as error:
        raise job_error(path, error, Job) from None
    except Exception as error:
        if (fault := fault_of_plugin(error)) is None:
            raise
        raise JobError(f"{path}: plugins: a law or effect failed where it was checked: {fault}") from error
    keep_source(job, path, data, untrusted=untrusted)
    _check_regions(job)
    return job


def keep_source(job: Job, path: Path, data: Mapping[str, Any], *, untrusted: bool) -> None:
    """Let a job remember from where it was read."""
    job._path, job._data, job._untrusted = path, data, untrusted


def _check_regions(job: Job, groups: Groups | None = None) -> None:
    """Raise ``JobError`` for names of regions that neither the job nor its mesh has, as far as that is known.

    Args:
        groups: of the mesh file; by default by its header.
    """
    references = chain.from_iterable(references(job) for references in REFERENCES)
    if lines := [
        f"{job.path}: {dotted_key(where)}: {what}" for where, what in unknown_references(job, references, groups)
    ]:
        raise JobError(*lines)


def unknown_references(job: Job, references: References, groups: Groups | None = None) -> Faults:
    """Yield the references to regions that neither the job nor its mesh has, as far as that is known.

    Args:
        groups: of the mesh file; by default by its header.
    """
    # names by the values of an array are known when the mesh is read
    named = () if job.mesh.array_labels is not None else tuple(references)
    if named:
        known = {*job.regions, *job.mesh.faces, *job.mesh.layer_names}
        yield from unknown_regions(job.resolve(job.mesh.file), known, named, kind=job.mesh.kind, groups=groups)


def check_files(job: Job) -> list[Path]:
    """Read the mesh, image and surface files of a job without DOLFINx, and return those that are too large for that.

    Raises:
        JobError: a run would stop at a file, or at the name of a region that the mesh does not have.
    """
    problems, unread, known = list[str](), list[Path](), None
    sections: list[tuple[str, MeshFile, Iterable[str]]] = [("mesh", job.mesh, job.mesh.files)]
    if job.expected_shape is not None:
        sections.append(("expected_shape", job.expected_shape, [job.expected_shape.file]))
    for section, spec, files in sections:
        for file in files:
            found = on_demand("contents of a mesh file")(spec, file, job.resolve(file))
            unread += [] if found.is_read else [job.resolve(file)]
            problems += [f"{job.path}: {section}: '{file}' {found.fault}"] if found.fault else []
            known = found.groups if section == "mesh" and file == job.mesh.file else known
    if problems:
        raise JobError(*problems)
    if known is not None and not job.mesh.kind.reads_surface:  # whose file may have other names of its edges
        _check_regions(job, known)
    return unread


def json_schema(kind: type[Spec] = Job) -> dict[str, Any]:
    """JSON Schema of a job file, or of another ``kind`` of file, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **kind.model_json_schema()}
