"""Units of mechanics with exact factors (fractions), so that a conversion rounds only once.

A general units package takes 0.4 s to import, more than the whole validation of a job.
"""

import math
import re
from fractions import Fraction
from functools import cache, lru_cache
from typing import NamedTuple

from hpcinv.base.quantity.suggestions import did_you_mean


class Dimension(NamedTuple):
    """Exponents of length, mass, time and temperature; angles count as pure numbers."""

    length: int = 0
    mass: int = 0
    time: int = 0
    temperature: int = 0

    def __str__(self) -> str:
        """Name of the dimension for messages, such as ``a stress``."""
        return NAMES.get(self.unit, f"a quantity in {self.unit}")

    @property
    def unit(self) -> str:
        """The usual SI unit, else powers of the base units; empty for pure numbers."""
        if (usual := _usual_units().get(self)) is not None:
            return usual
        powers = zip(("m", "kg", "s", "K"), self, strict=True)
        return " ".join(unit if n == 1 else f"{unit}^{n}" for unit, n in powers if n)


BASE = {
    "m": Dimension(length=1),
    "kg": Dimension(mass=1),
    "s": Dimension(time=1),
    "K": Dimension(temperature=1),
    "rad": Dimension(),
}
PREFIXES = {
    "n": "1e-9",
    "u": "1e-6",
    "µ": "1e-6",  # the micro sign; below it, the Greek letter
    "μ": "1e-6",
    "m": "1e-3",
    "c": "1e-2",
    "d": "1e-1",
    "h": "1e2",
    "k": "1e3",
    "M": "1e6",
    "G": "1e9",
}
WITH_PREFIX = ("m", "g", "s", "K", "L", "Hz", "N", "Pa", "bar", "J", "W")
DERIVED = {
    "in": "0.0254 m",
    "ft": "12 in",
    "L": "1e-3 m^3",
    "ml": "1e-6 m^3",
    "g": "1e-3 kg",
    "t": "1e3 kg",
    "lb": "0.45359237 kg",
    "min": "60 s",
    "h": "60 min",
    "Hz": "1 s^-1",
    "g_n": "9.80665 m/s^2",
    "N": "1 kg m/s^2",
    "dyn": "1e-5 N",
    "kgf": "1 kg g_n",
    "lbf": "1 lb g_n",
    "Pa": "1 N/m^2",
    "bar": "1e5 Pa",
    "atm": "101325 Pa",
    "mmHg": "133.322387415 Pa",
    "cmH2O": "98.0665 Pa",
    "psi": "1 lbf/in^2",
    "J": "1 N m",
    "W": "1 J/s",
    "deg": "0.0174532925199432957692 rad",
    "°": "1 deg",
    "rpm": "6 deg/s",
    "%": "1e-2",
}
NAMES = {
    "": "a pure number",
    "m": "a length",
    "m^2": "an area",
    "m^3": "a volume",
    "s": "a time",
    "1/s": "a frequency",
    "m/s": "a velocity",
    "m/s^2": "an acceleration",
    "kg": "a mass",
    "kg/m^3": "a density",
    "N": "a force",
    "N/m": "a force per length",
    "N/m^3": "a force per volume",
    "N m": "an energy or moment",
    "Pa": "a stress",
    "Pa s": "a viscosity",
    "K": "a temperature difference",
    "1/K": "a thermal expansion coefficient",
}

_LONGEST = 400  # characters of a quantity
_READABLE = {
    "m": ((1e-9, "nm"), (1e-6, "µm"), (1e-3, "mm"), (1.0, "m"), (1e3, "km")),
    "m^3": ((1e-18, "µm^3"), (1e-9, "mm^3"), (1e-6, "ml"), (1e-3, "L"), (1.0, "m^3")),
    "kg": ((1e-12, "ng"), (1e-9, "µg"), (1e-6, "mg"), (1e-3, "g"), (1.0, "kg"), (1e3, "t")),
    "N": ((1e-9, "nN"), (1e-6, "µN"), (1e-3, "mN"), (1.0, "N"), (1e3, "kN"), (1e6, "MN")),
    "Pa": ((1e-3, "mPa"), (1.0, "Pa"), (1e3, "kPa"), (1e6, "MPa"), (1e9, "GPa")),
}
_FROM = {"mm^3": 1e-4}
"""least number in a unit, by default 1: µm^3 is nine powers of ten below mm^3"""
LENGTH_UNITS = ("m", "mm", "um", "nm", "cm", "dm", "km", "in", "ft", "µm")

NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,3})?"
_QUANTITY = re.compile(rf"\s*((?>{NUMBER}))\s*(.*?)\s*", re.DOTALL)
_FACTOR = re.compile(r"\s*([*/·])?\s*(cmH2O|[A-Za-zµμ_]+|[%°])(?:(?:\^|\*\*)?([+-]?\d\b|⁻?[¹²³]))?\s*")
_SUPERSCRIPTS = str.maketrans("⁻¹²³", "-123")


TEMPERATURES = {
    "°C": (Fraction(1), Fraction("273.15")),
    "℃": (Fraction(1), Fraction("273.15")),
    "degC": (Fraction(1), Fraction("273.15")),
    "°F": (Fraction(5, 9), Fraction("459.67") * Fraction(5, 9)),
    "degF": (Fraction(5, 9), Fraction("459.67") * Fraction(5, 9)),
    "K": (Fraction(1), Fraction(0)),
}
"""Units of temperatures: size of a degree and zero point, in K."""


def parse_temperature(text: str) -> float:
    """Absolute temperature in K from ``<number> <unit>``; ``ValueError`` with the reason if it is invalid."""
    match = _QUANTITY.fullmatch(text) if len(text) <= _LONGEST else None
    if match is None or match[2] not in TEMPERATURES:
        raise ValueError(f"must be a temperature, such as 400 °C or 673.15 K, not '{text[:60]}'")
    degree, zero = TEMPERATURES[match[2]]
    kelvins = Fraction(match[1]) * degree + zero
    if kelvins < 0:
        raise ValueError(f"'{text}' is below absolute zero")
    return as_float(kelvins)


def parse_quantity(text: str) -> tuple[float, Dimension]:
    """SI value and dimension of ``<number> <unit>``; ``ValueError`` with the reason if it is invalid."""
    value, dimension = _parse(text)
    return as_float(value), dimension


def as_float(number: Fraction | float) -> float:
    """The nearest float, or infinity beyond the largest float."""
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


@lru_cache(1024)  # sweeps read the same quantities repeatedly
def _parse(text: str) -> tuple[Fraction, Dimension]:
    if len(text) > _LONGEST:
        raise ValueError(f"'{text[:40]}...' is not a number, with or without a unit: it has {len(text):,} characters")
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise ValueError(f"'{text}' is not a number, with or without a unit")
    if match[2] in TEMPERATURES and TEMPERATURES[match[2]][1]:
        raise ValueError(
            f"'{text}' is an absolute temperature; write a difference in K (1 °C is 1 K), or 'temperature' and"
            " 'reference_temperature' of thermal-expansion"
        )
    factor, dimension = parse_unit(match[2])
    return Fraction(match[1]) * factor, dimension


@cache
def parse_unit(text: str) -> tuple[Fraction, Dimension]:
    """SI factor and dimension of a unit such as ``kg/m^3`` or ``N mm``; empty text is the dimensionless unit 1."""
    if len(text) > _LONGEST:
        raise ValueError(f"'{text[:40]}...' is not a unit; write one such as mm, kg/m^3 or m/s^2")
    total, exponents = Fraction(1), Dimension()
    rest = re.sub(r"^1\s*/", "/", text)
    while rest:
        match = _FACTOR.match(rest)
        if match is None:
            raise ValueError(f"'{text}' is not a unit; write one such as mm, kg/m^3 or m/s^2")
        power = int((match[3] or "1").translate(_SUPERSCRIPTS)) * (-1 if match[1] == "/" else 1)
        factor, dimension = _unit(match[2])
        total *= factor**power
        exponents = Dimension(*(a + power * b for a, b in zip(exponents, dimension, strict=True)))
        rest = rest[match.end() :]
    return total, exponents


def is_unit(text: str) -> bool:
    """Return whether a text is a unit; ``-`` and no text are the dimensionless one."""
    try:
        parse_unit("" if text == "-" else text)
    except ValueError:
        return False
    return True


def readable(value: float, unit: str, digits: int = 3) -> str:
    """A value (in m, m^3, kg, N or Pa) with a suitable prefix, such as ``182 mm``."""
    value = float(f"{value:.{digits}g}")
    size, name = prefixed_unit(value, unit)
    return f"{value / size:.{digits}g} {name}"


def is_prefixed(unit: str) -> bool:
    """Return whether values in an SI unit are shown with prefixes."""
    return unit in _READABLE


def prefixed_unit(value: float, unit: str) -> tuple[float, str]:
    """Return size and symbol of the unit with a prefix that suits a value; of another unit itself."""
    units = _READABLE.get(unit, ((1.0, unit),))
    if not value:
        return 1.0, unit
    return next(((size, name) for size, name in reversed(units) if abs(value) >= size * _FROM.get(name, 1.0)), units[0])


def length_symbol(unit: float) -> str:
    """Symbol of a length unit (m), such as ``mm``, or its size, such as ``0.3 m``, if it has no symbol."""
    return next((symbol for symbol in LENGTH_UNITS if parse_quantity(f"1 {symbol}")[0] == unit), f"{unit!r} m")


@cache
def _unit(symbol: str) -> tuple[Fraction, Dimension]:
    if symbol in BASE:
        return Fraction(1), BASE[symbol]
    if symbol in DERIVED:
        return _parse(DERIVED[symbol])
    if symbol in (prefixed := {p + s: (p, s) for p in PREFIXES for s in WITH_PREFIX}):
        prefix, plain = prefixed[symbol]
        factor, dimension = _unit(plain)
        return Fraction(PREFIXES[prefix]) * factor, dimension
    hint = did_you_mean(symbol, [*BASE, *DERIVED, *prefixed], list_all=False)
    raise ValueError(f"unknown unit '{symbol}'.{hint or ' Units are symbols such as mm, kg or kPa.'}")


@cache
def _usual_units() -> dict[Dimension, str]:
    return {parse_unit(unit)[1]: unit for unit in NAMES}
