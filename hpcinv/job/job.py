"""The job: all input of a run, read from one file, completely checked, and immutable."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, ValidationError, ValidationInfo, field_validator

from hpcinv.effects import AnyEffect, Direction, Effect
from hpcinv.effects.contact import Contact
from hpcinv.errors import JobError
from hpcinv.files.names import is_file
from hpcinv.files.untrusted import REFUSED, applies, is_asked, path_fault
from hpcinv.job.definitions import RESERVED, resolve
from hpcinv.job.fibres import FibreFamily
from hpcinv.job.identification import Identification, faults_of_identification
from hpcinv.job.layers import Layering, layerings_of
from hpcinv.job.mesh_generators import is_generator
from hpcinv.job.region_names import unknown_regions
from hpcinv.job.region_rules import EXCEPT, RegionRule, RegionUnion
from hpcinv.job.rules import (
    contradicting_directions,
    contradicting_meshes,
    read_demands,
    unknown_families,
    unsuited,
    unsuited_effects,
    unsuited_supports,
    wants_pressure,
)
from hpcinv.job.sections import REGION_NAMES, ExpectedShape, QuantityOfInterest, Support, directory_of
from hpcinv.job.sections import MeshSpec as MeshSpec  # part of this module's interface
from hpcinv.job.sensitivities import Owner, Parameter, Uncertain, read_sensitivities, uncertain_parameters
from hpcinv.job.settings import CertificateSettings, Checkpoint, Discretisation, FixedPoint, Output, Solver
from hpcinv.job.states import StateSpec, faults_of_states, given_on_current, rest_of, solve_order
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.materials import Material, MaterialLaw
from hpcinv.materials.formula_law.invariants import fault_of_name
from hpcinv.quantity.component import Ingredient
from hpcinv.quantity.expressions import LET, Expression, faults
from hpcinv.quantity.keys import JobKey, assigned
from hpcinv.quantity.plugins import fault_of_plugin, load_file, load_installed
from hpcinv.quantity.quantity import AnyQuantity
from hpcinv.quantity.schema import (
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
from hpcinv.quantity.spatial_fields import ELSEWHERE, ByRegion, entries
from hpcinv.quantity.suggestions import did_you_mean

MOST_ENTRIES = 10_000
"""entries of one list of a job, such as quantities: each takes a millisecond to check, and more in a run"""

UNNAMED = "(mapping)"  # in place of the file name of a job that was made in Python
_KEYS: Any = Mapping[str, str | float | Uncertain | None] | list[str]  # as in a file


@dataclass(frozen=True)
class PlannedSolve:
    """One solve of a job.

    Attributes:
        job: the job, or that of one state by itself.
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
    unions of regions and groups of the mesh by their names, such as {skin: [endo, epi]}"""
    plugins: ListOf[str] = ()
    """Python files, by paths relative to the job file, that define further laws and effects"""
    files: ListOf[str] = ()
    """further files that generators and plugins read, by paths relative to the job file: with another content
    of one it is another job. Files that they read in Python, or by gmsh from a name in the text, need no entry"""
    fibres: Mapping[Name, FibreFamily] = {}
    """families of fibres by name, for laws and effects that refer to them"""
    material: Material
    """the material law and its parameters, or one for each region of cells: {core: {law: …}, skin: {law: …}}"""
    load_cases: ListOf[Name] = ()
    """names of successive load cases; by default there is one"""
    states: ListOf[StateSpec] = ()
    """states of one body, in place of 'analysis' and 'effects': the given one, the rest shape, and others"""
    effects: ListOf[AnyEffect] = ()
    """loads and inelastic strains of the body"""
    supports: Annotated[ListOf[Support], Field(validate_default=True)] = ()
    """prescribed displacements; not needed if springs (effect: elastic-foundation) hold the body"""
    discretisation: Discretisation = Discretisation()
    """finite-element spaces"""
    solver: Solver = Solver()
    """continuation and Newton iteration"""
    method: Literal["direct", "sellier", "aitken", "anderson", "rausch"] = "direct"
    """direct: one solve on the deformed body; the others find the undeformed body by repeated forward solves"""
    fixed_point: FixedPoint = FixedPoint()
    """iteration of the methods other than direct"""
    certificate: CertificateSettings = CertificateSettings()
    """checks at the end of a run: quick, standard, full, off, or single switches such as {estimate: false}"""
    checkpoint: Checkpoint = Checkpoint()
    """saving of converged states"""
    output: Output = Output()
    """results that are written with the summary"""
    quantities: ListOf[QuantityOfInterest] = ()
    """numbers that are reported"""
    sensitivities: Mapping[JobKey, Uncertain] = {}
    """numbers of laws, effects, fibres and supports by which shape and quantities are differentiated: a list of their
    keys, or their standard deviations by key, such as {material.mu: 1 kPa, "effects[0].density": null}; numbers that
    change together are one entry, such as {"effects[0].density": {sd: 10 kg/m^3, also: ["effects[1].density"]}}"""
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
        return ("bp",) if self.mesh.is_partitioned else ("msh", "vtu")

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
        """Name of the state of which this is the job; empty without states."""
        return self._state

    @property
    def kind(self) -> str:
        """Description of the solves, for messages."""
        return f"{len(self.states)} states" if self.states else f"{self.analysis} analysis"

    @property
    def rest(self) -> str:
        """Name of the rest shape; empty without states."""
        return rest_of(self.states) if self.states else ""

    def _job_of_state(self, number: int) -> Job:
        """The job of one of the loaded states by itself."""
        state = self.states[number]
        changes = {
            "analysis": "inverse" if state.given else "forward",
            "states": (),
            "effects": state.effects,
            "supports": self.supports if state.supports is None else state.supports,
            "quantities": tuple(q for q in self.quantities if q.state == state.name),
        }
        job = self.model_copy(update=changes)
        job._state, job._whole = state.name, self
        job._places = _places_of(number, state)
        return job

    def place(self, section: str) -> str:
        """Place of a section of this job in its file, where that of a state differs."""
        return self._places.get(section, section)

    @property
    def laws(self) -> Mapping[str, MaterialLaw]:
        """The material laws by their place in the job: ``material``, or ``material.REGION`` for each region."""
        return _laws(self.material)

    @property
    def named_effects(self) -> list[tuple[str, Effect]]:
        return list(_numbered(self.place("effects"), self.effects).items())

    @property
    def families(self) -> dict[str, FibreFamily]:
        """The families of fibres that laws and effects use, by their place in the job."""
        return _families((*self.laws.values(), *self.effects), self.fibres)

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
            self.discretisation.formulation == "auto" and wants_pressure(self.laws)
        )

    @property
    def pressure_degree(self) -> int | None:
        """Degree of the pressure, or None in the displacement form."""
        return (self.discretisation.pressure or self.discretisation.displacement - 1) if self.is_mixed else None

    @property
    def layerings(self) -> tuple[Layering, ...]:
        """What divides the body into layers, with pressures of their own in the mixed form; the same for all states."""
        if self._whole is not None:
            return self._whole.layerings
        effects = _numbered("effects", self.effects)
        for i, state in enumerate(self.states):
            effects |= _numbered(_places_of(i, state)["effects"], state.effects)
        return layerings_of(self.laws, effects, self.differentiated)

    @property
    def differentiated(self) -> list[Parameter]:
        """Parameters by which the results are differentiated, in the order of ``sensitivities``."""
        return uncertain_parameters(self.sensitivities, _all_owners(dict(self)))

    @property
    def unsuited_to_nested_iteration(self) -> str:
        """Reason why the first solve cannot begin with the solution on coarser cells; empty if nothing forbids it."""
        first = self.plan[0]
        if not is_generator(Path(self.mesh.file)):
            return (
                "needs a mesh that a generator makes (.py, .geo) by sizes of cells, since a mesh file has no coarser"
                " cells; leave it out"
            )
        if self.solver.strategy != "adaptive":
            return "needs 'strategy: adaptive': other strategies are chosen for the path that they take"
        if self.method != "direct" and first.direction == "inverse":
            return "needs 'method: direct'"
        if self.accuracy:
            return "cannot be combined with 'accuracy', whose search begins with the solution on the mesh before"
        if first.direction == "forward" and any(effect.functions(1) for effect in first.job.effects):
            return "is not possible with a contact whose pressure or nearest points are found by iteration"
        return ""

    @property
    def has_derivatives(self) -> bool:
        """True if solutions have derivatives; those of contact with a rigid obstacle have none."""
        return _have_derivatives(self.effects, self.states)

    @property
    def owners(self) -> dict[str, Owner]:
        """The parts with numbers by which results can be differentiated, by their place in the job."""
        return _owners(self.material, self.effects, self.fibres, self.supports, self._places)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the plugins, which another rank imports before it unpickles their classes."""
        plugins = [self.resolve(p).resolve() for p in self.plugins]
        return _unpickled, (plugins, pickle.dumps((self.__class__, self.__getstate__())))

    # Rules between sections are validators of the later section, to which the valid earlier sections are known.

    @field_validator("let")
    @classmethod
    def _check_let(cls, given: Mapping[str, Expression], info: ValidationInfo) -> Mapping[str, Expression]:
        """Also puts the definitions into the validation context of the following sections."""
        raise_if_any(((name,), text) for name in given if (text := fault_of_name(name, RESERVED)))
        resolved = resolve(given)
        if resolved:
            if info.context is None:
                raise ValueError("is valid only in jobs that are read by 'load' or 'parse'")
            info.context[LET] = resolved
        return resolved

    @field_validator("plugins")
    @classmethod
    def _check_plugins(cls, plugins: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        load_installed()
        if applies(info):
            text = f"is a Python file that a run executes, and is {REFUSED}"
            raise_if_any(((i,), f"{shown(plugin)} {text}") for i, plugin in enumerate(plugins))
        problems: list[tuple[KeyPath, str]] = []
        for i, plugin in enumerate(plugins):
            with collected(problems, i):
                load_file(directory_of(info) / plugin)
        raise_if_any(problems)
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

    @field_validator("material")
    @classmethod
    def _check_material(cls, material: Material, info: ValidationInfo) -> Material:
        for where, law in _laws(material).items():
            region = tuple(where.split(".", 1)[1:])
            raise_if_any(((*region, *place), text) for place, text in unknown_families(law, info.data.get("fibres")))
        return material

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
        return regions

    @field_validator("states")
    @classmethod
    def _check_states(cls, states: tuple[StateSpec, ...], info: ValidationInfo) -> tuple[StateSpec, ...]:
        if not states:
            return states
        raise_if_any(faults_of_states(states))
        fibres, cases = info.data.get("fibres"), info.data.get("load_cases")
        for i, state in enumerate(states):
            direction: Direction = "inverse" if state.given else "forward"
            where = f"in a state that is solved {direction}"
            faults = unsuited_effects(state.effects, {direction}, direction, where, fibres, cases)
            raise_if_any(((i, "effects", *place), text) for place, text in faults)
            if state.supports is not None:
                faults = unsuited_supports(state.supports, state.effects, cases)
                raise_if_any(((i, "supports", *place), text) for place, text in faults)
        if any(state.given and state.is_rest for state in states):
            rest = rest_of(states)
            parts: list[tuple[KeyPath, Ingredient]] = [
                (("states", i, "effects", j), e) for i, s in enumerate(states) for j, e in enumerate(s.effects)
            ]
            parts += [(("fibres", name), family) for name, family in (fibres or {}).items()]
            laws = _laws(info.data["material"]) if "material" in info.data else {}
            parts += [(tuple(where.split(".", 1)), law) for where, law in laws.items()]
            for owner, part in parts:
                for place in given_on_current(part):
                    text = f"{dotted_key((*owner, *place))} is given on the current body, but the given one, '{rest}',"
                    raise ValueError(
                        f"{text} is the rest shape: give it on the reference body (in a formula by X, Y, Z)"
                    )
        return states

    @field_validator("effects")
    @classmethod
    def _check_effects(cls, effects: tuple[AnyEffect, ...], info: ValidationInfo) -> tuple[AnyEffect, ...]:
        if effects and info.data.get("states"):
            raise ValueError(
                "belong to states in a job with 'states': move them to 'effects' of each state that has them"
            )
        analysis, fibres, cases = (info.data.get(key) for key in ("analysis", "fibres", "load_cases"))
        needed = {"forward", "inverse"} if analysis == "round_trip" else {analysis} if analysis else set[str]()
        first: Direction = "forward" if "forward" in (analysis, info.data.get("first")) else "inverse"
        raise_if_any(unsuited_effects(effects, needed, first, f"with 'analysis: {analysis}'", fibres, cases))
        return effects

    @field_validator("supports")
    @classmethod
    def _check_supports(cls, supports: tuple[Support, ...], info: ValidationInfo) -> tuple[Support, ...]:
        if not {"effects", "states"} <= info.data.keys():  # already reported
            return supports
        cases = info.data.get("load_cases")
        for state in info.data["states"]:
            if not state.is_rest and state.supports is None:
                faults = unsuited_supports(supports, state.effects, cases)
                raise_if_any((place, f"in state '{state.name}': {text}") for place, text in faults)
        raise_if_any(unsuited_supports(supports, info.data["effects"], cases) if not info.data["states"] else ())
        return supports

    @field_validator("discretisation")
    @classmethod
    def _check_discretisation(cls, discretisation: Discretisation, info: ValidationInfo) -> Discretisation:
        if "material" in info.data:
            raise_if_any(unsuited(discretisation, _laws(info.data["material"])))
        return discretisation

    @field_validator("accuracy", mode="plain")
    @classmethod
    def _check_accuracy(cls, given: object, info: ValidationInfo) -> Mapping[str, float]:
        if "quantities" not in info.data:  # already reported
            return {}
        demands = read_demands(given, info.data["quantities"])
        if demands and info.data.get("identify") is not None:
            raise ValueError("cannot be combined with 'identify', which needs one mesh for all evaluations")
        if demands and info.data.get("states"):
            raise ValueError("is not possible with 'states': find mesh and degree for the given state by itself")
        if demands and info.data.get("expected_shape") is not None:
            raise ValueError(
                "cannot be combined with 'expected_shape', which needs the mesh of the job; remove one of them"
            )
        if demands and info.data.get("method", "direct") != "direct":
            raise ValueError("needs 'method: direct'")
        if demands and (mesh := info.data.get("mesh")) is not None and mesh.is_partitioned:
            raise ValueError("needs a mesh that can be refined, not a partitioned one: use its original file")
        solver = info.data.get("solver")
        if not demands and solver is not None and "maximum_unknowns" in solver.model_fields_set:
            raise ValueError("is needed if solver.maximum_unknowns is given, which applies only to it")
        return demands

    @field_validator("sensitivities", mode="before", json_schema_input_type=_KEYS)
    @classmethod
    def _check_sensitivities(cls, given: object, info: ValidationInfo) -> Mapping[str, Uncertain]:
        if not {"material", "effects", "fibres", "supports"} <= info.data.keys():  # already reported
            return {}
        uncertain, problems = read_sensitivities(given, _all_owners(info.data))
        raise_if_any(problems)
        if uncertain:
            _check_differentiable(info.data, "are")
        return uncertain

    @field_validator("identify")
    @classmethod
    def _check_identify(cls, section: Identification | None, info: ValidationInfo) -> Identification | None:
        needed = {"material", "effects", "fibres", "supports", "states", "quantities"}
        if section is None or not needed <= info.data.keys():  # already reported
            return section
        states, quantities = info.data["states"], info.data["quantities"]
        given = next((state.name for state in states if state.given), "")
        names = [state.name for state in states]
        shapes = [name for name in ([*names, rest_of(states)] if states else []) if name != given]
        owners = _all_owners(info.data)
        raise_if_any(faults_of_identification(section, owners, quantities, list(dict.fromkeys(shapes)), given))
        _check_differentiable(info.data, "is")
        return section

    @field_validator("quantities")
    @classmethod
    def _check_quantities(
        cls, quantities: tuple[QuantityOfInterest, ...], info: ValidationInfo
    ) -> tuple[QuantityOfInterest, ...]:
        names = [q.name for q in quantities]
        raise_if_any(((i, "name"), f"'{names[i]}' is the name of an earlier quantity") for i in repeated(names))
        if not {"supports", "states"} <= info.data.keys():  # already reported
            return quantities
        loaded = {state.name: state for state in info.data["states"] if not state.is_rest}
        raise_if_any(
            ((i, "state"), f"there is no loaded state '{q.state}'.{did_you_mean(q.state, loaded)}")
            for i, q in enumerate(quantities)
            if q.state is not None and q.state not in loaded
        )
        numbered = [
            (i, quantity) for i, q in enumerate(quantities) for quantity in _quantities_of_states(q, list(loaded))
        ]
        names = [q.name for _, q in numbered]
        raise_if_any(
            ((numbered[i][0], "name"), f"'{names[i]}' is the name of another quantity in a state")
            for i in repeated(names)
        )
        problems: list[tuple[KeyPath, str]] = []
        for i, quantity in numbered:
            supports = loaded[quantity.state].supports if quantity.state else None
            regions = list(dict.fromkeys(s.region for s in (info.data["supports"] if supports is None else supports)))
            effects = loaded[quantity.state].effects if quantity.state else info.data.get("effects", ())
            if quantity.prestrain_names and not any(effect.writes_its_stress for effect in effects):
                state = f" of state '{quantity.state}'" if quantity.state else ""
                what = f"has '{quantity.prestrain_names[0]}', but there is no prestrain among the effects{state}"
                problems.append(((i, "of"), what))
            if quantity.is_contact:
                problems += _missing_contact(
                    i, quantity, {name: s.effects for name, s in loaded.items()} or {"": effects}
                )
            elif quantity.is_reaction and quantity.on not in regions:
                where = f"those with supports are {', '.join(regions)}" if regions else "the job has no supports"
                state = f" in state '{quantity.state}'" if quantity.state else ""
                held = [name for name, s in loaded.items() if quantity.on in (x.region for x in s.supports or ())]
                where += _state_to_give(held)
                problems.append(((i, "on"), f"{shown(quantity.on)} is not the region of a support{state}: {where}"))
        raise_if_any(problems)
        return tuple(quantity for _, quantity in numbered)

    def _contradictions(self, info: ValidationInfo) -> Faults:
        for key in ("analysis", "first"):
            if self.states and key in self.model_fields_set:
                yield (key,), "is not valid with 'states', one of which is the given one; remove it"
        yield from contradicting_directions(self.analysis, self.first, self.method, self.fixed_point, self.states)
        yield from contradicting_meshes(self.mesh, self.output, self.expected_shape)
        if self.solver.nested_iteration == "on" and (text := self.unsuited_to_nested_iteration):
            yield ("solver", "nested_iteration"), text
        given_rest = any(state.given and state.is_rest for state in self.states)
        is_reference = given_rest if self.states else self.directions[0] == "forward"
        mesh, shape = ("reference", "undeformed") if is_reference else ("current", "deformed")
        text = f"must be '{mesh}' for a rule, which is evaluated on the mesh of the job, the {shape} body"
        rules = ((name, family) for name, family in self.fibres.items() if family.rule is not None)
        yield from ((("fibres", name, "given_on"), text) for name, family in rules if family.given_on != mesh)


def _quantities_of_states(quantity: QuantityOfInterest, loaded: Sequence[str]) -> list[QuantityOfInterest]:
    """The quantity, or one for each loaded state, with its name added to that of the quantity, if it names none."""
    if quantity.state is not None or not loaded:
        return [quantity]
    return [quantity.model_copy(update={"name": f"{quantity.name}-{name}", "state": name}) for name in loaded]


def _missing_contact(
    number: int, quantity: QuantityOfInterest, loads: Mapping[str, Iterable[Effect]]
) -> Iterator[tuple[KeyPath, str]]:
    """Fault of a result of contact on a region without one, with the effects of each loaded state."""
    state = quantity.state or ""
    regions = {name: [e.region for e in effects if isinstance(e, Contact)] for name, effects in loads.items()}
    if quantity.on in regions[state]:
        return
    where = f"those with contact are {', '.join(regions[state])}" if regions[state] else "there is no contact"
    remedy = _state_to_give([name for name, contact_regions in regions.items() if quantity.on in contact_regions])
    state_text = f" in state '{state}'" if state else ""
    yield (number, "on"), f"{shown(quantity.on)} is not the region of a contact{state_text}: {where}{remedy}"


def _state_to_give(states: Sequence[str]) -> str:
    """Return the end of a message that names the states in which a quantity has a value."""
    return f"; give the quantity the state that has one (state: {' or '.join(states)})" if states else ""


def _laws(material: MaterialLaw | Mapping[str, MaterialLaw]) -> dict[str, MaterialLaw]:
    if isinstance(material, MaterialLaw):
        return {"material": material}
    return {f"material.{region}": law for region, law in material.items()}


def _families(parts: Iterable[Ingredient], fibres: Mapping[str, FibreFamily]) -> dict[str, FibreFamily]:
    """The families of fibres that laws and effects use, by their place in the job."""
    needed = dict.fromkeys(name for part in parts for name in part.families)
    return {f"fibres.{name}": fibres[name] for name in needed}


def _owners(
    material: Material,
    effects: Sequence[Effect],
    fibres: Mapping[str, FibreFamily],
    supports: Sequence[Support],
    places: Mapping[str, str],
) -> dict[str, Owner]:
    """The parts of a job with numbers by which results can be differentiated, by their place in the job.

    Args:
        places: of the effects and of the supports in the job, where they are those of a state.
    """
    parts = {**_laws(material), **_numbered(places.get("effects", "effects"), effects)}
    return parts | _families(parts.values(), fibres) | _numbered(places.get("supports", "supports"), supports)


def _all_owners(data: Mapping[str, Any]) -> dict[str, Owner]:
    """The parts with numbers of a job and of all its states, from its sections."""
    material, fibres, supports = data["material"], data["fibres"], data["supports"]
    owners = _owners(material, data["effects"], fibres, supports, {})
    for i, state in enumerate(data.get("states", ())):
        state_supports = supports if state.supports is None else state.supports
        owners |= _owners(material, state.effects, fibres, state_supports, _places_of(i, state))
    return owners


def _check_differentiable(data: Mapping[str, Any], verb: str) -> None:
    """Raise ``ValueError`` if solutions have no derivatives."""
    if not _have_derivatives(data["effects"], data.get("states", ())):
        raise ValueError(
            f"{verb} not possible with contact with a rigid obstacle, whose pressure is found by iteration; give it the"
            " 'stiffness' of an elastic layer"
        )


def _have_derivatives(effects: Iterable[Effect], states: Iterable[StateSpec]) -> bool:
    """Return whether solutions have derivatives."""
    everywhere = [*effects, *(effect for state in states for effect in state.effects)]
    return not any("multiplier" in effect.functions(1) for effect in everywhere)


def _places_of(number: int, state: StateSpec) -> dict[str, str]:
    """Places of a state's sections in the job, by their names."""
    own = ["effects"] if state.supports is None else ["effects", "supports"]
    return {section: f"states[{number}].{section}" for section in own}


def _numbered[T](section: str, entries: Sequence[T]) -> dict[str, T]:
    return {f"{section}[{i}]": entry for i, entry in enumerate(entries)}


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


def parse(data: Mapping[str, Any], path: Path, *, untrusted: bool = False) -> Job:
    """Check the content of a job file, as `load` does; relative paths start from the directory of ``path``."""
    untrusted = untrusted or is_asked()
    large = {key: len(value) for key, value in data.items() if isinstance(value, list) and len(value) > MOST_ENTRIES}
    if large:
        text = f"entries, but may have {MOST_ENTRIES:,}"
        raise JobError(*(f"{path}: {key}: has {count:,} {text}" for key, count in large.items()))
    try:
        job = Job.model_validate(
            {"job": name_from(path), **data}, context={"directory": path.parent, "untrusted": untrusted}
        )
    except ValidationError as error:
        raise job_error(path, error, Job) from None
    except Exception as error:
        if (fault := fault_of_plugin(error)) is None:
            raise
        raise JobError(f"{path}: plugins: a law or effect failed where it was checked: {fault}") from error
    job._path, job._data, job._untrusted = path, data, untrusted
    # names by the values of an array are known when the mesh is read
    named = () if job.mesh.array_labels is not None else _named_regions(job)
    unknown = unknown_regions(job.resolve(job.mesh.file), {*job.regions, *job.mesh.faces}, named)
    if lines := [f"{path}: {dotted_key(where)}: {what}" for where, what in unknown]:
        raise JobError(*lines)
    return job


def _named_regions(job: Job) -> Iterator[tuple[KeyPath, str]]:
    """Names of all regions to which a job refers, with their places."""
    sections: list[tuple[KeyPath, Sequence[Support], Sequence[Effect]]] = [((), job.supports, job.effects)]
    sections += [(("states", i), state.supports or (), state.effects) for i, state in enumerate(job.states)]
    for name, rule in job.regions.items():
        for i, entry in enumerate(rule.entries if isinstance(rule, RegionUnion) else ()):
            yield ("regions", name, i), entry.removeprefix(EXCEPT).strip()
    for place, supports, effects in sections:
        for i, support in enumerate(supports):
            yield (*place, "supports", i, "region"), support.region
        for i, effect in enumerate(effects):
            for name, field in effect.surfaces.items():
                yield (*place, "effects", i, field), name
            for field in type(effect).model_fields:
                yield from _value_regions(getattr(effect, field), (*place, "effects", i, field))
    for where, law in job.laws.items():
        if (region := where.partition(".")[2]) and region != ELSEWHERE:
            yield ("material", region), region
        for field in type(law).model_fields:
            yield from _value_regions(getattr(law, field), (*where.split(".", 1), field))
    for name, family in job.fibres.items():
        for field, region in family.rule.surfaces.items() if family.rule is not None else ():
            yield ("fibres", name, "rule", field), region
    for i, quantity in enumerate(job.quantities):
        if quantity.on is not None:
            yield ("quantities", i, "on"), quantity.on


def _value_regions(value: object, where: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    names = dict.fromkeys(name for entry in entries(value) if isinstance(entry, ByRegion) for name in entry.values)
    for name in names:
        if name != ELSEWHERE:
            yield (*where, name), name


def json_schema(kind: type[Spec] = Job) -> dict[str, Any]:
    """JSON Schema of a job file, or of another ``kind`` of file, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **kind.model_json_schema()}
