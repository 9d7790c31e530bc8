"""Base class of the material laws."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from pydantic import ConfigDict, ModelWrapValidatorHandler, PrivateAttr, ValidationInfo, model_validator

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.parameter_paths import Number, replace_scalar
from hpcinv.base.quantity.schema import Faults, KeyPath, Problems, has_validators
from hpcinv.base.quantity.spatial_fields import in_each_region, is_uniform
from hpcinv.base.quantity.units import Dimension, parse_unit
from hpcinv.physics.materials.formula_law.evaluation import evaluate_of_any_parameters
from hpcinv.physics.materials.moduli import NAMES, Moduli, moduli_schema, rates, shear_and_bulk, young_and_poisson

if TYPE_CHECKING:
    from hpcinv.physics.kinematics.kinematics import Deformation as Deformation
else:  # it loads UFL, which the check of a job does not need
    Deformation = Any

_STRESS = parse_unit("Pa")[1]
_UNFINISHED = "moduli of the law are not known yet"


@dataclass(frozen=True)
class StartingValues:
    """Published or fitted parameters of a law, as first values for a similar material.

    Attributes:
        parameters: parameters in the form of a job file, without the law's name.
        source: publication, or description of the fit.
    """

    parameters: Mapping[str, Any]
    of: str
    source: str


def _add_moduli(schema: dict[str, Any], law: type[Any]) -> None:
    """Add elastic moduli to the JSON schema of a law, as alternatives to the parameters that they determine."""
    if law.replaceable is not None:
        schema["properties"] |= moduli_schema()
        needed = [key for key in schema.get("required", ()) if key in law.replaceable]
        schema["required"] = [key for key in schema.get("required", ()) if key not in law.replaceable]
        if needed:
            others = [[name] for name in NAMES if name not in needed]
            schema["anyOf"] = [{"required": keys} for keys in (needed, *others)]


class MaterialLaw(Ingredient):
    """A hyperelastic law ``psi = formula + volumetric_modulus/2 · dilatation²``.

    A subclass with a literal field ``law`` is registered under that name. Its parameters are fields, with the same
    names in the formula; the moduli read them from ``par`` as floats, arrays or UFL scalars.
    """

    model_config = ConfigDict(json_schema_extra=_add_moduli)

    formula: ClassVar[str]
    """The energy without its volumetric part, in the syntax of the law 'formula'; fibres have the names of the fields
    that name their families. It must be stress-free at ``F = I`` for all values of the parameters."""
    starting_values: ClassVar[Mapping[str, StartingValues]] = {}
    """Published parameters, or parameters fitted to published tests, by ``rubber`` and ``tissue``."""
    replaceable: ClassVar[tuple[str | None, str] | None] = None
    """The parameters that a job may replace by elastic moduli: one that the shear modulus determines (``None`` if the
    other parameters determine that modulus) and one that the bulk modulus determines; both moduli are linear in them.
    ``None`` for laws with fibres."""
    bulk_measure: ClassVar[str] = "bulk_modulus"
    """The modulus, among `Moduli`, that corresponds to the second of these parameters."""
    _stated: Mapping[str, Any] | None = PrivateAttr(None)
    """Values (SI) in the job of moduli (`Moduli`) and of parameters of the law; ``None`` without moduli."""

    @property
    @abstractmethod
    def volumetric_formula(self) -> str:
        """The volumetric energy, ``volumetric_modulus/2 · dilatation²``, in the same syntax."""

    @property
    def own_formula(self) -> str:
        """The `formula`, with all terms for the parameters of this law."""
        return self.formula

    def isochoric_energy(self, k: Deformation, par: Any) -> Any:
        """Return the energy per reference volume without its volumetric part, as a UFL expression."""
        return self._evaluated_formula(k, par)[0]

    @abstractmethod
    def dilatation(self, k: Deformation) -> Any:
        """Return the volumetric strain ``theta``, zero at ``F = I``, the conjugate of the mixed form's pressure."""

    def volumetric_modulus(self, par: Any) -> Any:
        """Return the factor of the volumetric energy, by default the bulk modulus; infinite if incompressible."""
        return self.bulk_modulus(par)

    def shear_modulus(self, par: Any) -> Any:
        """Return the shear modulus of the undeformed material without its fibres, by default the parameter ``mu``."""
        return par.mu

    @abstractmethod
    def bulk_modulus(self, par: Any) -> Any:
        """Return the bulk modulus of the undeformed material; infinite if it is incompressible."""

    def domain(self, k: Deformation, par: Any) -> tuple[Any, ...]:
        """Return UFL scalars that are positive where the law is defined.

        By default these are the scalars of the formula, or none if a law overrides `isochoric_energy`.
        """
        is_own = type(self).isochoric_energy is not MaterialLaw.isochoric_energy
        return () if is_own else self._evaluated_formula(k, par)[1]

    def _evaluated_formula(self, k: Deformation, par: Any) -> tuple[Any, tuple[Any, ...]]:
        return evaluate_of_any_parameters(self.own_formula, par, k, self._families_by_formula_name())

    def _families_by_formula_name(self) -> dict[str, str]:
        """Return families of fibres by the field that names them, with a number for lists."""
        families = {}
        for family, field in self.families.items():
            value = getattr(self, field)
            families[f"{field}{value.index(family) + 1}" if isinstance(value, tuple) else field] = family
        return families

    @property
    def energy_formula(self) -> str:
        """The whole energy, in the syntax of the law 'formula'."""
        return f"{self.own_formula} + {self.volumetric_formula}"

    @property
    def is_split(self) -> bool:
        """True if the volumetric energy is a separate term, whose pressure can be an unknown."""
        return True

    @property
    def is_incompressible(self) -> bool:
        """True if the volume cannot change."""
        return any(isinstance(value, float) and math.isinf(value) for value, _ in self.quantities().values())

    @property
    def stiffness_ratio(self) -> float | None:
        """Largest ratio of bulk to shear modulus; ``None`` if it depends on fields of the mesh."""
        if self.is_incompressible:
            return math.inf
        return max((self.bulk_modulus(par) / self.shear_modulus(par) for par in self.cases()), default=None)

    @property
    def varies_freely(self) -> bool:
        """True if its moduli depend on fields of the mesh, so that they have no `stiffness_ratio`."""
        return not self.is_incompressible and next(self.cases(), None) is None

    def __eq__(self, other: object) -> bool:
        """Return whether parameters are equal, whatever moduli gave them."""
        return type(self) is type(other) and self.__dict__ == other.__dict__

    def __hash__(self) -> int:
        return hash((type(self), *self.__dict__))

    def cases(self) -> Iterator[Any]:
        """Yield namespaces of numbers (SI), one for each region with different values; none if they are fields."""
        quantities = self.quantities()
        for _, numbers in in_each_region(tuple(value for value, _ in quantities.values())):
            yield SimpleNamespace(**dict(zip(quantities, numbers, strict=True)))

    def numbers(self) -> dict[KeyPath, Number | str]:
        """Return all numbers, moduli that the job gives, and in any case Young's modulus and Poisson's ratio."""
        numbers = super().numbers()
        if self._stated is not None:
            for name in NAMES:
                if math.isfinite(value := self._stated.get(name, math.inf)):
                    numbers[name,] = Number(value, Dimension() if name == "poisson" else _STRESS)
        if self.replaceable is not None and self.replaceable[0] is not None and self.is_uniform:
            young, poisson = self.young_and_poisson()
            numbers["young",] = Number(young, _STRESS)
            numbers["poisson",] = "is 0.5, the end of its range" if poisson == 0.5 else Number(poisson, Dimension())
        return numbers

    def unset_number(self, place: KeyPath) -> str:
        name, *rest = place
        stated = self._stated if self._stated is not None else {n: getattr(self, n) for n in type(self).model_fields}
        entries = stated.get(str(name))
        is_left_out = isinstance(entries, tuple) and bool(rest) and isinstance(rest[0], int) and rest[0] >= len(entries)
        if name in stated and not is_left_out:
            return ""
        given = [n for n in stated if n in NAMES or n in self.quantities()]
        return f"follows from {' and '.join(given)}, which the law has: state it there instead of one of them"

    def number_replaced(self, place: KeyPath, number: float) -> Self:
        """Return a copy with another number; of what the job gives, the moduli that it gives stay as they are."""
        name, *rest = place
        if self._stated is None or name not in self._stated:
            return super().number_replaced(place, number)
        value = number if name in NAMES else replace_scalar(getattr(self, str(name)), tuple(rest), number)
        return type(self).model_validate({**self._stated, str(name): value})

    def rates(self, place: KeyPath) -> dict[str, tuple[Any, Dimension]]:
        """Return derivatives by a number, with the others fixed that the job gives.

        By Young's modulus and Poisson's ratio, where the job does not give them, the other one of the two is fixed.
        """
        stated = self._stated or {}
        if place not in (("young",), ("poisson",)) or (place == ("young",) and "young" in stated):
            return super().rates(place)
        assert self.replaceable is not None
        shear, bulk = self.replaceable
        mu, kappa = self.shear_modulus(self._parameters()), self._bulk()
        fixed = "young" if place == ("poisson",) else "poisson"
        if place == ("poisson",) and "poisson" in stated:
            own = "shear_modulus" if shear is None or shear in stated else self.bulk_measure
            fixed = next((name for name in NAMES if name in stated and name != "poisson"), own)
        if math.isinf(kappa):
            shear_rate, bulk_rate = mu / self.young_and_poisson()[0], math.inf
        else:
            shear_rate, bulk_rate = rates(str(place[0]), fixed, mu, kappa)
        changes: dict[str, tuple[Any, Dimension]] = {}
        if shear is not None and shear_rate:
            change = shear_rate / self._slope(self.shear_modulus, self.place_of(shear))
            changes[shear] = (self._parameter_value(shear, change), _STRESS)
            bulk_rate -= change * self._slope(self.bulk_modulus, self.place_of(shear))
        if math.isfinite(bulk_rate):
            changes[bulk] = (bulk_rate / self._slope(self.bulk_modulus, self.place_of(bulk)), _STRESS)
        return changes

    @classmethod
    def known_keys(cls) -> tuple[str, ...]:
        return (*super().known_keys(), *(NAMES if cls.replaceable else ()))

    @classmethod
    def leaves_out(cls, parameter: str, data: Mapping[str, Any]) -> bool:
        """Return whether a job lacks a parameter that is `replaceable`."""
        return parameter not in data

    @classmethod
    def put(cls, parameter: str, value: Any, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return the data of a job with a value of a `replaceable` parameter added."""
        return {**data, parameter: value}

    def place_of(self, parameter: str) -> KeyPath:
        """Return the place of the number of a `replaceable` parameter."""
        return (parameter,)

    @property
    def is_uniform(self) -> bool:
        """True if its parameters are the same everywhere."""
        return all(is_uniform(value) for value, _ in self.quantities().values())

    def _parameters(self) -> Any:
        """Return the parameters (SI) as a namespace, for the moduli."""
        return SimpleNamespace(**{name: value for name, (value, _) in self.quantities().items()})

    def _bulk(self) -> float:
        return math.inf if self.is_incompressible else float(self.bulk_modulus(self._parameters()))

    def young_and_poisson(self) -> tuple[float, float]:
        """Return Young's modulus (Pa) and Poisson's ratio at small strain, of anisotropic laws of their matrix."""
        return young_and_poisson(self.shear_modulus(self._parameters()), self._bulk())

    def _slope(self, modulus: Callable[[Any], Any], place: KeyPath) -> float:
        """Return the derivative of a modulus by a number in which it is linear."""
        # A step of the size of the moduli loses no digits.
        step = float(self.shear_modulus(self._parameters()))
        start, end = (Ingredient.number_replaced(self, place, x)._parameters() for x in (0.0, step))
        return float(modulus(end) - modulus(start)) / step

    def _solved(self, modulus: Callable[[Any], Any], value: float, place: KeyPath) -> float:
        """Return the number at a place for which a modulus has a given value."""
        start = Ingredient.number_replaced(self, place, 0.0)._parameters()
        return (value - float(modulus(start))) / self._slope(modulus, place)

    def _parameter_value(self, parameter: str, value: float) -> Any:
        """Return a value at the place of a parameter, with 0 in the other entries of a list."""
        place = self.place_of(parameter)
        if len(place) == 1:
            return value
        return tuple(value if i == place[1] else 0.0 for i in range(len(getattr(self, parameter))))

    @classmethod
    def is_read_by_fields(cls, data: Mapping[str, Any]) -> bool:
        # These do nothing more without moduli.
        return not _has_moduli(data) and has_validators(cls, "_validate", "_replace_moduli", "_keep_stated")

    @model_validator(mode="before")
    @classmethod
    def _replace_moduli(cls, data: Any, info: ValidationInfo) -> Any:
        """Replace elastic moduli by parameters of the law."""
        if cls.replaceable is None or not _has_moduli(data):
            return data
        moduli = _moduli_in(data)
        own = {name: value for name, value in data.items() if name not in NAMES}
        shear, bulk = cls.replaceable
        wanted = [name for name in cls.replaceable if name is not None and cls.leaves_out(name, own)]
        _check_number_of_moduli(cls, moduli, finds_shear=shear in wanted, finds_bulk=bulk in wanted)
        trial = own
        for name in wanted:
            trial = cls.put(name, 1.0, trial)
        law = cls.model_validate(trial, context={**(info.context or {}), _UNFINISHED: True})
        if not law.is_uniform:
            raise Problems(((next(iter(moduli)),), "can be given only where the other parameters are plain numbers"))
        if shear not in wanted:
            moduli["shear_modulus"] = law.shear_modulus(law._parameters())
        if bulk not in wanted:
            moduli[cls.bulk_measure] = getattr(law, bulk) if cls.bulk_measure == "lame" else law._bulk()
        try:
            mu, kappa = shear_and_bulk(moduli)
        except ValueError as error:
            raise Problems(((next(name for name in NAMES if name in data),), str(error))) from None
        return law._parameters_for(own, wanted, mu, kappa)

    def _parameters_for(
        self, own: Mapping[str, Any], wanted: Sequence[str], mu: float, kappa: float
    ) -> Mapping[str, Any]:
        """Return parameters with those that are wanted, such that the law has these moduli (Pa)."""
        law, (shear, bulk) = self, self.replaceable or ("", "")
        if shear is not None and shear in wanted:
            solved = law._solved(law.shear_modulus, mu, law.place_of(shear))
            law, own = law.number_replaced(law.place_of(shear), solved), self.put(shear, solved, own)
        if bulk in wanted:
            finite = math.isfinite(kappa)
            own = self.put(bulk, law._solved(law.bulk_modulus, kappa, (bulk,)) if finite else "incompressible", own)
        return own

    @model_validator(mode="wrap")
    @classmethod
    def _keep_stated(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Keep what a job gives if that includes moduli."""
        law = handler(data)
        if cls.replaceable is None or not _has_moduli(data):
            return law
        own: dict[str, Any] = {name: getattr(law, name, value) for name, value in data.items() if name not in NAMES}
        shear = cls.replaceable[0]
        if shear is not None and shear in own and cls.leaves_out(shear, data):  # a list without its last entry
            own[shear] = own[shear][:-1]
        law._stated = own | _moduli_in(data)
        return law

    def _contradictions(self, info: ValidationInfo) -> Faults:
        sheet = self.__dict__.get("sheet")
        if sheet is not None and sheet == self.__dict__.get("fibre"):
            yield ("sheet",), "must be another family than fibre"
        if info.context and _UNFINISHED in info.context:
            return
        for par in self.cases():
            for name, value in (("shear", self.shear_modulus(par)), ("bulk", self.bulk_modulus(par))):
                if not value > 0:
                    yield (
                        (),
                        f"the {name} modulus that follows from these parameters must be positive, but is {value:g} Pa",
                    )


def _has_moduli(data: Any) -> bool:
    return isinstance(data, Mapping) and not data.keys().isdisjoint(NAMES)


def _moduli_in(data: Mapping[str, Any]) -> dict[str, float]:
    """Return the moduli (SI; a ratio) that a job gives."""
    given = Moduli.model_validate({name: data[name] for name in NAMES if name in data})
    return given.model_dump(exclude_none=True)


def _check_number_of_moduli(
    law: type[MaterialLaw], moduli: Mapping[str, float], *, finds_shear: bool, finds_bulk: bool
) -> None:
    """Raise `Problems` unless a job gives two independent moduli, counting parameters of the law."""
    assert law.replaceable is not None
    shear, bulk = law.replaceable
    own = {} if finds_shear else {"shear_modulus": shear or "the other parameters"}
    own |= {} if finds_bulk else {law.bulk_measure: bulk}
    first = next(iter(moduli))
    if shear is None and "young" in moduli:
        raise Problems((("young",), "follows from the energy and the bulk modulus: give poisson or kappa"))
    for name in own.keys() & moduli.keys():
        raise Problems(((name,), f"is determined by {own[name]} already: remove one of them"))
    given = [*moduli, *own.values()]
    if len(given) > 2:
        raise Problems(((first,), f"give any two moduli, not {len(given)}: {', '.join(given)}"))
    if len(given) < 2:
        others = [name for name in (*NAMES, *(name for name in (shear, bulk) if name)) if name != first]
        raise Problems(((first,), f"needs a second modulus: one of {', '.join(others)}"))
