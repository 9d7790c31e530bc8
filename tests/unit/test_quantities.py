"""Numbers with units against values from the definitions of the units."""

from __future__ import annotations

import math
from typing import Annotated

import pytest
from pydantic import TypeAdapter, ValidationError

from hpcinv.base.quantity.quantity import (
    AnyQuantity,
    BulkStress,
    Density,
    Dimensionless,
    Length,
    Quantity,
    Stress,
    quantities_of,
)
from hpcinv.base.quantity.schema import Spec, Triple
from hpcinv.base.quantity.units import Dimension, parse_quantity, readable
from hpcinv.base.quantity.written_units import as_shown, written_units
from hpcinv.physics.effects.gravity import Gravity
from hpcinv.physics.materials.mooney_rivlin import MooneyRivlin

LENGTH, STRESS, DENSITY = Dimension(1, 0, 0), Dimension(-1, 1, -2), Dimension(-3, 1, 0)


def read(kind: object, value: object) -> float:
    return TypeAdapter(kind).validate_python(value)


@pytest.mark.parametrize(
    ("text", "si", "dimension"),
    [
        ("8.5 mm", 8.5e-3, LENGTH),
        ("8.5mm", 8.5e-3, LENGTH),
        ("3 µm", 3e-6, LENGTH),
        ("3 um", 3e-6, LENGTH),
        ("1 in", 0.0254, LENGTH),
        ("120 ml", 120e-6, Dimension(3, 0, 0)),
        ("120 mL", 120e-6, Dimension(3, 0, 0)),
        ("1 ft", 0.3048, LENGTH),
        ("963 kg/m^3", 963.0, DENSITY),
        ("0.963 g/cm^3", 963.0, DENSITY),
        ("963 kg m^-3", 963.0, DENSITY),
        ("963 kg/m**3", 963.0, DENSITY),
        ("963 kg/m³", 963.0, DENSITY),
        ("1 N/mm^2", 1e6, STRESS),
        ("120 mmHg", 120 * 133.322387415, STRESS),
        ("10 cmH2O", 980.665, STRESS),
        ("1 psi", 0.45359237 * 9.80665 / 0.0254**2, STRESS),
        ("1013.25 hPa", 101325.0, STRESS),
        ("1 atm", 101325.0, STRESS),
        ("1 mbar", 100.0, STRESS),
        ("-1 g_n", -9.80665, Dimension(1, 0, -2)),
        ("9.81 m/s²", 9.81, Dimension(1, 0, -2)),
        ("2 min", 120.0, Dimension(0, 0, 1)),
        ("2 ms", 0.002, Dimension(0, 0, 1)),
        ("30 rpm", math.pi, Dimension(0, 0, -1)),
        ("4 1/s", 4.0, Dimension(0, 0, -1)),
        ("180 deg", math.pi, Dimension()),
        ("5 %", 0.05, Dimension()),
        ("1 t", 1000.0, Dimension(0, 1, 0)),
        ("1 kN m", 1000.0, Dimension(2, 1, -2)),
    ],
)
def test_units_have_their_defined_value_and_dimension(text: str, si: float, dimension: Dimension) -> None:
    assert parse_quantity(text) == (pytest.approx(si, rel=1e-15), dimension)


@pytest.mark.parametrize("number", ["8.5", "7", "0.3", "182", "1.1", "2.675e-2"])
def test_a_unit_changes_nothing_about_a_float(number: str) -> None:
    assert read(Length, f"{number} mm") == float(f"{number}e-3" if "e" not in number else "2.675e-5")


def test_a_plain_number_is_si() -> None:
    assert read(Stress, 1200) == 1200.0
    assert isinstance(read(Stress, 1200), float)


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        (Density, "8.5 mm", "must be a density (in kg/m^3, or with a unit), but '8.5 mm' is a length"),
        (Stress, "3", "but '3' is a pure number"),
        (Length, "963 kg/m^4", "is a quantity in m^-4 kg"),
        (Length, "3 mmm", "unknown unit 'mmm'. Did you mean 'mm'?"),
        (Stress, "3 kPA", "unknown unit 'kPA'. Did you mean 'kPa'?"),
        (Length, "abc", "'abc' is not a number, with or without a unit"),
        (Length, "3 m //s", "'m //s' is not a unit"),
        (Length, "1,5 mm", "is not a unit"),
        (Length, True, "not True"),
        (Length, None, "must be a length (in m, or with a unit), not None"),
        (Length, math.nan, "must be finite"),
        (Length, math.inf, "must be finite"),
        (Length, "1e999 m", "must be finite"),
        (Length, 10**400, "must be finite"),
        (Length, 1e-320, "must be 0 or at least 2.2e-308"),
        (Length, "-1e-310 m", "must be 0 or at least 2.2e-308"),
        (Stress, "incompressible", "is not a number"),
        (Dimensionless, "1 m", "must be a pure number, but '1 m' is a length"),
    ],
)
def test_invalid_quantities_are_refused_with_a_reason(kind: object, value: object, message: str) -> None:
    with pytest.raises(ValidationError) as caught:
        read(kind, value)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "text", "si"),
    [
        (Dimensionless, "1/3", 1 / 3),
        (Stress, "1e6/10", 1e5),
        (Dimensionless, "-1/1.04", -1 / 1.04),
        (Stress, "2*1.5 kPa", 3000.0),
        (Length, "2*(3 mm + 1 cm)", 0.026),
        (Length, "(1 + 1/2)*2 mm", 0.003),
        (Stress, "1000 kg/m^3*9.81 m/s^2*2 m", 19620.0),
        (Dimensionless, "sin(30 deg)", 0.5),
    ],
)
def test_arithmetic_is_a_number(kind: object, text: str, si: float) -> None:
    assert read(kind, text) == pytest.approx(si, rel=1e-15)


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (Length, "10/2 cm", "but '10/2 cm' is a quantity in m^-1"),
        (Stress, "(1/3)*1 mm", "but '(1/3)*1 mm' is a length"),
        (Length, "1/0", "must be finite"),
        (Length, "2*depth", "unknown unit 'depth'"),
        (Length, "1/3 foo", "is not a unit"),
        (Length, "(1 mm) < (2 mm)", "is a condition, not a number"),
    ],
)
def test_arithmetic_has_a_dimension(kind: object, text: str, message: str) -> None:
    with pytest.raises(ValidationError) as caught:
        read(kind, text)
    assert message in str(caught.value)


def test_incompressible_is_an_infinite_stiffness_and_stays_readable_in_json() -> None:
    adapter = TypeAdapter(BulkStress)
    assert adapter.validate_python("incompressible") == math.inf
    assert adapter.validate_python(math.inf) == math.inf
    assert adapter.dump_python(math.inf, mode="json") == "incompressible"
    assert adapter.dump_python(5.0, mode="json") == 5.0


def test_any_quantity_takes_every_dimension() -> None:
    assert read(AnyQuantity, "3 kPa") == 3000.0
    assert read(AnyQuantity, "3 mm") == 0.003


def test_dimensions_are_read_from_the_fields_of_a_model() -> None:
    assert quantities_of(MooneyRivlin) == {"c1": STRESS, "c2": STRESS, "d1": STRESS}
    assert quantities_of(Gravity)["acceleration"] == Dimension(1, 0, -2)
    assert quantities_of(Gravity)["density"].mass == 1


def test_dimensions_are_found_inside_optional_and_nested_annotations() -> None:
    class Sample(Spec):
        a: Length | None = None
        b: Triple[Length] | None = None
        c: Annotated[float, Quantity("N/m")] = 1.0
        d: AnyQuantity = 1.0
        e: int = 1

    assert quantities_of(Sample) == {"a": LENGTH, "b": LENGTH, "c": Dimension(0, 1, -2)}


def test_values_are_shown_in_the_units_of_a_job() -> None:
    job = {
        "mesh": {"file": "scan 12 m.msh", "unit": "mm"},
        "regions": {"foot": "z < 2 mm", "tip": "norm(x - 3 cm, y) < 5 mm"},
        "material": {"law": "neo-hookean", "mu": "20 kPa", "kappa": "1 MPa", "density": "1000 kg/m^3"},
        "effects": [{"effect": "pressure", "pressure": "1.5 kPa"}, {"effect": "gravity", "acceleration": "9.81 m/s^2"}],
    }
    units = written_units(job)
    assert units == {"m": "mm", "Pa": "kPa"}
    assert as_shown(0.0705, "m", units) == "70.5 mm"
    assert as_shown([0.0, -0.1325, 1e-9], "m", units) == "(0, -132.5, 1e-06) mm"
    assert as_shown([0.001, -3.2e-17, None], "m", units) == "(1, 0, not finite) mm"
    assert as_shown(2.5e6, "Pa", units) == "2500 kPa"
    assert as_shown(0.00025, "m^3", units) == "250 ml"  # not chosen by a job
    assert as_shown(0.25, "", units) == "0.25"
    assert as_shown(None, "m", units) == "not finite"
    assert as_shown(0.07, "m", {}) == "70 mm"
    assert written_units({"material": {"mu": 20000.0}}) == {}


@pytest.mark.parametrize("unit", ["m", "m^3", "kg", "N", "Pa"])
def test_readable_values_are_what_they_say(unit: str) -> None:
    for power in range(-20, 13):
        value, dimension = parse_quantity(readable(3 * 10.0**power, unit))
        assert value == pytest.approx(3 * 10.0**power, rel=1e-12)
        assert dimension == parse_quantity(f"1 {unit}")[1]
