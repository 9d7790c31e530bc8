"""Our table of units against an independent one: pint's, which validation itself would take too long to load."""

from __future__ import annotations

import pint
import pytest

from hpcinv.base.quantity.units import DERIVED, PREFIXES, WITH_PREFIX, parse_quantity

THEIRS = pint.UnitRegistry()
NAMES = {"µ": "u", "μ": "u", "h": "hour", "min": "minute", "g_n": "standard_gravity", "°": "degree", "%": "percent"}
UNITS = sorted({"m", "kg", "s", "rad", *DERIVED})


def theirs(unit: str, prefix: str = "") -> tuple[float, dict[str, float]]:
    quantity = THEIRS.Quantity(1.0, NAMES.get(prefix, prefix) + NAMES.get(unit, unit)).to_base_units()
    return quantity.magnitude, {k.strip("[]"): v for k, v in quantity.dimensionality.items()}


@pytest.mark.parametrize("unit", UNITS)
def test_unit_is_what_pint_says(unit: str) -> None:
    value, dimension = parse_quantity(f"1 {unit}")
    magnitude, dimensionality = theirs(unit)
    # Conventional units of pressure are defined to seven digits or so; all others exactly.
    assert value == pytest.approx(magnitude, rel=1e-6 if unit in ("mmHg", "cmH2O") else 1e-15)
    assert {k: v for k, v in dimension._asdict().items() if v} == dimensionality


@pytest.mark.parametrize("unit", WITH_PREFIX)
def test_prefixes_are_what_pint_says(unit: str) -> None:
    for prefix in set(PREFIXES) - {"h"}:  # pint's "h" before a unit is hecto too, but before "m" an hour-metre
        assert parse_quantity(f"1 {prefix}{unit}")[0] == pytest.approx(theirs(unit, prefix)[0], rel=1e-15)
