"""Thermal expansion."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, ValidationInfo, model_validator

from hpcinv.base.quantity import ExpansionField, Faults, KeyPath, TemperatureField, raise_if_any
from hpcinv.base.quantity.schema import shown
from hpcinv.base.quantity.spatial_fields import in_each_region
from hpcinv.base.quantity.units import as_float, parse_temperature
from hpcinv.physics.effects.effect import Deformation, Effect

_KEYS = ("temperature", "reference_temperature")
_MEANINGS = {
    "temperature": "temperature of the deformed body, such as 400 °C, 673.15 K or 752 °F, or one for each region",
    "reference_temperature": "temperature of the undeformed body, such as 20 °C",
}


def _add_temperatures(schema: dict[str, Any], _kind: type[Any]) -> None:
    """Add two temperatures to the JSON schema, as an alternative to their difference."""
    number: dict[str, Any] = {"type": ["string", "number"]}
    either = {"anyOf": [number, {"type": "object", "additionalProperties": number}]}
    schema["properties"]["temperature"] = either | {"description": _MEANINGS["temperature"]}
    schema["properties"]["reference_temperature"] = number | {"description": _MEANINGS["reference_temperature"]}
    schema["required"] = [key for key in schema.get("required", ()) if key != "temperature_change"]
    schema["anyOf"] = [{"required": ["temperature_change"]}, {"required": [*_KEYS]}]


class ThermalExpansion(Effect):
    """A stress-free stretch ``F_g = (1 + alpha ΔT) I`` of the reference body; ``F = F_e F_g``.

    The stresses follow from the elastic part ``F_e``, with the energy ``J_g psi(F_e)`` per reference volume. The load
    factor scales the temperature change.

    Instead of ``temperature_change``, a difference in K, a job may give two temperatures: ``temperature`` of the
    deformed body (one number, or one for each region) and ``reference_temperature`` of the undeformed one, in °C, °F
    or K. A difference is never given in °C, since ``400 °C`` could mean either.

    Source: Vujošević & Lubarda (2002), Theoretical and Applied Mechanics 28–29.
    """

    model_config = ConfigDict(json_schema_extra=_add_temperatures)

    example: ClassVar = {"effect": "thermal-expansion", "coefficient": "3e-4 1/K", "temperature_change": "40 K"}

    effect: Literal["thermal-expansion"] = "thermal-expansion"
    coefficient: ExpansionField
    """coefficient of linear expansion, alpha"""
    temperature_change: TemperatureField
    """temperature of the deformed body less the undeformed one's, ΔT, in K; or give both temperatures"""

    @model_validator(mode="before")
    @classmethod
    def _change_of_temperatures(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not any(key in data for key in _KEYS):
            return data
        raise_if_any(_misfits(data))
        undeformed = _kelvins(data["reference_temperature"], "reference_temperature")
        deformed = data["temperature"]
        rest = {key: value for key, value in data.items() if key not in _KEYS}
        if isinstance(deformed, Mapping):
            parts = {region: _kelvins(value, "temperature") for region, value in deformed.items()}
            return rest | {"temperature_change": {region: value - undeformed for region, value in parts.items()}}
        return rest | {"temperature_change": _kelvins(deformed, "temperature") - undeformed}

    @classmethod
    def known_keys(cls) -> tuple[str, ...]:
        return (*super().known_keys(), *_KEYS)

    def _contradictions(self, info: ValidationInfo) -> Faults:
        """Yield stretches of plain numbers that are not positive; fields are checked on the mesh."""
        for region, (alpha, change) in in_each_region((self.coefficient, self.temperature_change)):
            if (stretch := 1 + alpha * change) > 0:
                continue
            where = f" in region '{region}'" if region else ""
            text = f"gives the stretch 1 + alpha ΔT = {stretch:g}{where}, which must be above 0"
            yield ("coefficient",), f"{text}: correct {alpha:g} 1/K, or the temperature change of {change:g} K"

    def positive(self, par: Any, directions: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"the stretch 1 + alpha ΔT": 1 + par.coefficient * par.temperature_change}

    def inelastic_strain(self, k: Deformation, load: Any, par: Any) -> Any:
        return load * par.coefficient * par.temperature_change * k.I


def _misfits(data: Mapping[str, Any]) -> list[tuple[KeyPath, str]]:
    """Return problems: one temperature is missing, or their difference is given too."""
    if "temperature_change" in data:
        return [((key,), "is not valid with 'temperature_change'; remove one of them") for key in _KEYS if key in data]
    pairs = (_KEYS, _KEYS[::-1])
    return [((key,), f"is needed with '{other}': {_MEANINGS[key]}") for key, other in pairs if key not in data]


def _kelvins(value: object, key: str) -> float:
    try:
        if isinstance(value, str):
            return parse_temperature(value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"must be a temperature, such as 400 °C or 673.15 K, not {shown(value)}")
        if not 0 <= (kelvins := as_float(value)) < float("inf"):
            raise ValueError(f"must be a temperature in K, 0 or more, not {shown(value)}")
    except ValueError as error:
        raise_if_any([((key,), str(error))])
        raise
    return kelvins
