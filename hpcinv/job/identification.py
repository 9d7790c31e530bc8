"""The section ``identify`` of a job: parameters that are sought, and observations of the body's states."""

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, ValidationInfo

from hpcinv.base.files.names import FilePath, is_file
from hpcinv.base.files.untrusted import applies
from hpcinv.base.mesh_formats import FORMATS, mesh_fault
from hpcinv.base.quantity.keys import JobKey
from hpcinv.base.quantity.quantity import AnyMeasured, Length, LengthUnit, Measured, Quantity, Size
from hpcinv.base.quantity.schema import Faults, KeyPath, ListOf, Name, Spec, Triple, repeated, shown
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.job.cavities import Cavity
from hpcinv.job.filling_points import FillingPoint, filling_points, pressure_in, pressure_keys
from hpcinv.job.mesh_file import directory_of
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.sensitivities import TIES, Owner, Parameter, fault_of_setting, fault_of_tie, parameter
from hpcinv.job.states import StateSpec, rest_of
from hpcinv.job.vocabulary import CUBIC, LENGTH

TABLES = (".csv", ".txt", ".xlsx")
SURFACES = (".stl", ".ply", ".obj", ".vtp", *TABLES)


def _whole(name: object) -> object:
    """Return the name of a quantity, which is not one of its components."""
    if isinstance(name, str) and (component := re.fullmatch(r"(.*)\[\d\]", name)):
        raise ValueError(
            f"{shown(name)} is a component: give 'quantity: {component[1]}' with a value of 3 components, or observe a"
            " quantity of one component, such as 'of: uz'"
        )
    return name


class Prior(Spec):
    """A normal distribution that is known of a parameter before the observations."""

    mean: AnyMeasured | None = None
    """its mean; by default the number in the job"""
    sd: AnyMeasured
    """its standard deviation"""
    strength: Literal["given", "evidence"] = "given"
    """evidence: the parameter is a hidden force, which is the mean unless the observations exclude that with 95 %. All
    such standard deviations are then multiplied by one number: it makes the observations most probable"""


class Sought(Spec):
    """A parameter that is sought. Plain numbers are SI."""

    start: AnyMeasured | None = None
    """starting value; by default the number in the job"""
    bounds: Annotated[tuple[AnyMeasured | None, AnyMeasured | None], Field(strict=False)] = (None, None)
    """least and largest value, null for none"""
    prior: Prior | None = None
    """what is known of it before the observations"""
    also: ListOf[JobKey] = ()
    """keys of further numbers that have the same value, such as the density in other states"""
    scale: ListOf[JobKey] = ()
    """keys of further numbers that are multiplied by the same factor as this one, such as other stiffnesses of a law"""


def ties_of(sought: Sought) -> list[tuple[tuple[str, int], str]]:
    """Return the keys that change with a parameter, with their places in its section."""
    return [((kind, i), key) for kind in TIES for i, key in enumerate(getattr(sought, kind))]


class Landmark(Spec):
    """A material point and its observed position."""

    at: Triple[Length]
    """its position in the given mesh"""
    observed: Triple[Length]
    """its observed position"""


class LineStrain(Spec):
    """A line of material points, and by how much it was longer than in the given body."""

    line: ListOf[Triple[Length]]
    """its points in the given mesh, in order, with straight lines between them"""
    strain: Annotated[float, Quantity("", above=-1.0)]
    """relative change of its length from the given to the observed state, such as -0.18"""


class PressureAndVolume(Spec):
    """A point of a pressure-volume curve."""

    pressure: Annotated[float, Quantity("Pa", at_least=0.0)]
    """pressure in the cavity"""
    volume: Annotated[float, Quantity("m^3", above=0.0)]
    """volume of the cavity"""


class Observation(Spec):
    """Something that was measured in a state of the body, with its standard deviation: exactly one of ``mesh``,
    ``surface``, ``landmarks``, ``strains``, ``quantity``, ``curve`` and ``klotz``."""

    name: Name
    """its name in reports"""
    state: Name | None = None
    """observed state, other than the given one; not needed in a job without states, and for a quantity"""
    mesh: FilePath | None = None
    """path to a mesh (.msh, .xdmf, .vtu) with the nodes and cells of the given one, at their observed positions"""
    surface: FilePath | None = None
    """path to points of the surface (.stl, .ply, .obj, .vtp, or a table .csv, .txt, .xlsx with x, y, z), in any order;
    what counts is their distance from the computed surface"""
    on: str | None = None
    """region of the boundary on which the points of a surface lie; by default all of it"""
    landmarks: ListOf[Landmark] | FilePath | None = None
    """list of {at: point in the given mesh, observed: point}, or path to a table (.csv, .txt, .xlsx) of six columns"""
    strains: ListOf[LineStrain] | None = None
    """strains of lines of material points, such as the circumferential ones of a wall that an image tracks"""
    quantity: Annotated[Name, BeforeValidator(_whole)] | None = None
    """name of a quantity of interest, such as volume-supine"""
    value: AnyMeasured | Triple[Length] | None = None
    """observed value of the quantity"""
    curve: ListOf[PressureAndVolume] | None = None
    """measured pressure-volume curve of a cavity, in order of pressure, with straight lines between the points. Each
    computed volume of the cavity, the unloaded one included, is compared at its pressure"""
    klotz: Annotated[Literal["given"] | PressureAndVolume, Field(union_mode="left_to_right")] | None = None
    """Klotz's curve of human left ventricles, estimated from one point at the end of diastole: 'given' for pressure and
    volume in the given state, or {pressure, volume}"""
    cavity: Name | None = None
    """cavity (a name from 'cavities') of a curve"""
    unit: LengthUnit = 1.0
    """length unit of a file, such as mm"""
    sd: AnyMeasured
    """standard deviation of the quantity, of each coordinate of a node or landmark, or of each distance or strain"""

    @property
    def kind(self) -> str:
        return next(kind for kind in KINDS if getattr(self, kind) is not None)

    @property
    def is_curve(self) -> bool:
        return self.curve is not None or self.klotz is not None

    @property
    def file(self) -> str | None:
        """Path of its file, relative to the job's."""
        return self.mesh or self.surface or (self.landmarks if isinstance(self.landmarks, str) else None)

    def _contradictions(self, info: ValidationInfo) -> Faults:
        kinds = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            yield (), f"needs exactly one of {', '.join(KINDS)}" + (f", not {' and '.join(kinds)}" if kinds else "")
            return
        yield from self._unneeded_keys()
        yield from self._unordered_points()
        yield from self._unsuited_deviation()
        yield from self._unsuited_file(info)

    def _unneeded_keys(self) -> Faults:
        """Faults of keys that are missing, or not valid, with this kind of observation."""
        if (self.value is None) == (self.kind == "quantity"):
            yield ("value",), "is needed, and valid, with a quantity"
        if (self.cavity is None) == self.is_curve:
            yield ("cavity",), "is needed, and valid, with a curve and with klotz"
        if self.is_curve and self.state is not None:
            yield ("state",), "is not valid with a curve, which is of all states"
        if self.on is not None and self.kind != "surface":
            yield ("on",), "is valid only with a surface"
        if "unit" in self.model_fields_set and self.file is None:
            yield ("unit",), "is valid only with a file: give units with the numbers"

    def _unordered_points(self) -> Faults:
        """Faults of the points of a curve or of lines on the body, and of the range of Klotz's curve."""
        if self.curve is not None:
            pressures = [point.pressure for point in self.curve]
            if len(pressures) < 2 or pressures != sorted({*pressures}):
                yield ("curve",), "must have two points at least, with growing pressures"
        if isinstance(self.klotz, PressureAndVolume) and not 0 < self.klotz.pressure < KLOTZ_LIMIT:
            yield ("klotz", "pressure"), KLOTZ_RANGE
        for i, entry in enumerate(self.strains or ()):
            if len(entry.line) < 2 or any(a == b for a, b in pairwise(entry.line)):
                yield ("strains", i, "line"), "must have two points at least, each different from the one before it"

    def _unsuited_deviation(self) -> Faults:
        if self.sd.value <= 0:
            yield ("sd",), "must be above 0"
        if self.kind == "quantity":  # whose dimension the job knows
            return
        if self.is_curve:
            dimension, text = CUBIC, "volume"
        elif self.kind == "strains":
            dimension, text = Dimension(), "number, as strains are"
        else:
            dimension, text = LENGTH, "length, as positions are"
        if self.sd.dimension not in (dimension, Dimension()):
            yield ("sd",), f"must be a {text}, but it is {self.sd.dimension}"

    def _unsuited_file(self, info: ValidationInfo) -> Faults:
        if self.file is None:
            return
        suffixes = {
            "mesh": tuple(suffix for suffix in FORMATS if not FORMATS[suffix].is_partitioned),
            "surface": SURFACES,
            "landmarks": TABLES,
        }[self.kind]
        path = directory_of(info) / self.file
        if suffix_of(path) not in suffixes:
            yield (self.kind,), f"{shown(self.file)} must end in {' or '.join(suffixes)}"
        elif applies(info) and (fault := mesh_fault(directory_of(info), self.file)):
            yield (self.kind,), f"{shown(self.file)} {fault}"
        elif not is_file(path):
            yield (self.kind,), f"there is no file '{path}'. Paths start from the directory of the job file"


KINDS = ("mesh", "surface", "landmarks", "strains", "quantity", "curve", "klotz")
KLOTZ_LIMIT = 100 * 133.322387415  # Pa: the unloaded volume would be 0 or less
KLOTZ_RANGE = "must be between 0 and 100 mmHg for Klotz's curve"


class Identification(Spec):
    """Parameters of the job that 'hpcinv identify' finds, together with the rest shape, from observations."""

    parameters: Mapping[JobKey, Sought | None]
    """keys of numbers as in 'sensitivities', with start, bounds and prior, such as {material.mu: {start: 5 kPa}}"""
    observations: ListOf[Observation]
    """what was observed of the body in other states than the given one"""
    given_sd: Size | None = None
    """standard deviation of each coordinate of the given mesh; it is added to the deviation of observed positions"""
    maximum_evaluations: Annotated[int, Field(ge=1)] = 100
    """largest number of evaluations: solves of all states"""

    def sought(self, key: str) -> Sought:
        return self.parameters[key] or Sought()

    def keys_of(self, key: str) -> list[str]:
        """Keys of a parameter and all numbers that change with it."""
        return [key, *(other for _, other in ties_of(self.sought(key)))]

    @property
    def keys(self) -> list[str]:
        """Keys of all numbers that are sought."""
        return [other for key in self.parameters for other in self.keys_of(key)]


def _given_and_computed(states: Sequence[StateSpec]) -> tuple[str, list[str]]:
    """Return the name of the given state, and the names of those that are computed."""
    given = next((state.name for state in states if state.given), "")
    names = dict.fromkeys([*(state.name for state in states), rest_of(states)] if states else [])
    return given, [name for name in names if name != given]


def _below(where: KeyPath, faults: Faults) -> Faults:
    """Return faults with their places below another place."""
    return (((*where, *place), text) for place, text in faults)


def faults_of_identification(
    section: Identification,
    owners: Mapping[str, Owner],
    quantities: Sequence[QuantityOfInterest],
    states: Sequence[StateSpec],
    cavities: Mapping[str, Cavity],
) -> Faults:
    """Faults with their places in the section.

    Args:
        owners: laws, effects, fibres and supports by their keys.
    """
    given, shapes = _given_and_computed(states)
    if not section.parameters:
        yield ("parameters",), "must name one number of the job at least"
    for key, sought in section.parameters.items():
        yield from _below(("parameters", key), _faults_of_parameter(key, sought or Sought(), owners))
    keys = section.keys
    yield from ((("parameters",), f"{keys[i]} is duplicated") for i in repeated(keys))
    titles = [observation.name for observation in section.observations]
    for i in repeated(titles):
        yield ("observations", i, "name"), f"'{titles[i]}' is the name of an earlier observation"
    if not titles:
        yield ("observations",), "must have one entry at least: one scan by itself fixes no material"
    known = {quantity.name: quantity for quantity in quantities}
    for i, observation in enumerate(section.observations):
        if observation.is_curve:
            faults = _faults_of_curve(observation, section, quantities, states, cavities)
        else:
            faults = _faults_of_observation(observation, known, shapes, given)
        yield from _below(("observations", i), faults)


def _faults_of_parameter(key: str, sought: Sought, owners: Mapping[str, Owner]) -> Faults:
    """Faults of a parameter and of the numbers that change with it."""
    try:
        number = parameter(key, owners, None)
    except ValueError as error:
        yield (), str(error)
        return
    yield from _faults_of_sought(number, sought)
    if fault := fault_of_setting(number):
        yield (), fault
    for place, other in ties_of(sought):
        try:
            tied = parameter(other, owners, None)
            fault = fault_of_tie(tied, number, place[0]) or fault_of_setting(tied)
        except ValueError as error:
            fault = str(error)
        if fault:
            yield place, fault


def _faults_of_sought(number: Parameter, sought: Sought) -> Faults:
    """Faults of the start, the bounds and the prior of a parameter."""
    given: list[tuple[KeyPath, Measured | None]] = [
        (("start",), sought.start),
        (("bounds", 0), sought.bounds[0]),
        (("bounds", 1), sought.bounds[1]),
    ]
    if sought.prior is not None:
        given += [(("prior", "mean"), sought.prior.mean), (("prior", "sd"), sought.prior.sd)]
        if sought.prior.sd.value <= 0:
            yield ("prior", "sd"), "must be above 0"
    wrong = [
        (place, f"must be {number.dimension}, as {number.key} is, but it is {quantity.dimension}")
        for place, quantity in given
        if quantity is not None
        and number.dimension is not None
        and quantity.dimension not in (number.dimension, Dimension())
    ]
    yield from wrong
    if wrong:
        return
    low, high = bounds_of(sought)
    if not low < high:
        yield ("bounds",), "must be the least and the largest value, in this order"
    elif not low <= start_of(number, sought) <= high:
        where = "start" if sought.start is not None else "bounds"
        yield (where,), f"the starting value {start_of(number, sought):g} (SI) must be within the bounds"


def _faults_of_curve(
    observation: Observation,
    section: Identification,
    quantities: Sequence[QuantityOfInterest],
    states: Sequence[StateSpec],
    cavities: Mapping[str, Cavity],
) -> Faults:
    name = str(observation.cavity)
    if name not in cavities:
        yield ("cavity",), f"there is no cavity '{name}'.{did_you_mean(name, cavities)}"
        return
    if not states:
        yield (), "needs a job with 'states', which have the pressures of the curve"
        return
    try:
        points = list(filling_points(name, cavities, quantities, states))
        if observation.klotz == "given":
            number, given = next((i, state) for i, state in enumerate(states) if state.given)
            pressure, effects = pressure_in(given.effects, cavities[name])
            if not 0 < pressure < KLOTZ_LIMIT:
                yield ("klotz",), f"the pressure of '{name}' in the given state {KLOTZ_RANGE}"
            points.append(FillingPoint("", pressure, pressure_keys(number, effects)))
    except ValueError as error:
        yield ("cavity",), f"'{name}': {error}"
        return
    yield from _faults_of_points(observation, section, points)


def _faults_of_points(observation: Observation, section: Identification, points: Sequence[FillingPoint]) -> Faults:
    """Faults of the points at which a curve of a cavity is compared."""
    name = observation.cavity
    if not any(point.quantity for point in points):
        yield (
            ("cavity",),
            f"no volume of '{name}' is computed at a known pressure: add {{name: V, of: volume, cavity: {name}}} to"
            " 'quantities', and states with pressures in it",
        )
    if observation.curve is not None:
        low, high = observation.curve[0].pressure, observation.curve[-1].pressure
        outside = [point.quantity for point in points if not low <= point.pressure <= high]
        if outside:
            yield ("curve",), f"does not reach the pressure of {' and '.join(outside)}"
    sought = {key for point in points for key in point.keys} & {*section.keys}
    if sought:
        yield ("cavity",), f"its pressure {min(sought)} is sought: a curve needs known pressures"


def _faults_of_observation(
    observation: Observation, quantities: Mapping[str, QuantityOfInterest], shapes: Sequence[str], given: str
) -> Faults:
    if observation.kind == "quantity":
        yield from _faults_of_observed_quantity(observation, quantities)
    elif not shapes:
        if observation.state is not None:
            yield ("state",), "is not valid in a job without 'states'"
    elif observation.state is None:
        yield ("state",), f"is needed: one of {', '.join(shapes)}"
    elif observation.state == given:
        yield ("state",), f"'{given}' is the given state, which is the mesh itself: observe another one"
    elif observation.state not in shapes:
        yield ("state",), f"there is no computed state '{observation.state}'.{did_you_mean(observation.state, shapes)}"


def _faults_of_observed_quantity(observation: Observation, quantities: Mapping[str, QuantityOfInterest]) -> Faults:
    name = str(observation.quantity)
    if observation.state is not None:
        yield ("state",), "is not valid with a quantity: the quantity itself names its state"
    quantity = quantities.get(name)
    if quantity is None:
        yield ("quantity",), f"there is no quantity '{name}'.{did_you_mean(name, quantities)}"
        return
    if quantity.is_reaction:
        yield ("quantity",), "is a reaction, which has no derivatives"
        return
    if isinstance(observation.value, tuple) != quantity.is_vector:
        yield ("value",), f"must be {'a list of 3 lengths' if quantity.is_vector else 'one number'}"
    for field, measured in (("sd", observation.sd), ("value", observation.value)):
        if quantity.dimension is None or not isinstance(measured, Measured):
            continue
        if measured.dimension not in (quantity.dimension, Dimension()):
            yield (field,), f"must be {quantity.dimension}, as '{name}' is, but it is {measured.dimension}"


def start_of(number: Parameter, sought: Sought) -> float:
    """Starting value (SI) of a parameter."""
    return number.value if sought.start is None else sought.start.value


def bounds_of(sought: Sought) -> tuple[float, float]:
    """Least and largest value (SI)."""
    low, high = sought.bounds
    return -float("inf") if low is None else low.value, float("inf") if high is None else high.value


def prior_of(number: Parameter, sought: Sought) -> tuple[float, float] | None:
    """Mean and standard deviation (SI) that are known before, ``None`` if nothing is."""
    if sought.prior is None:
        return None
    mean = sought.prior.mean
    return number.value if mean is None else mean.value, sought.prior.sd.value
