"""Columns of tables of tests: their names, as machines write them, their units, and the row that names them."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.csv_rows import Row
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension, as_float, is_unit, parse_unit

_PURE, _STRESS = Dimension(), parse_unit("Pa")[1]
IGNORE = "ignore"
"""Name of a column that the user does not need."""
_SEARCHED = 200
"""Rows ahead of the names of columns; raised, a wrong file takes longer to be refused."""


@dataclass(frozen=True)
class Column:
    """Kind of a column: its role, dimension, and the conversion of a value (SI) to the measure or stress."""

    role: str  # "strain", "stress", "deviation", "mode" or "ignored"
    dimension: Dimension = _PURE
    modes: tuple[str, ...] = ()
    needs: str = ""  # a statement of the file
    convert: Callable[[Floats, float], Floats] = lambda values, _: values
    is_cauchy: bool = False


_STRETCHING = ("uniaxial", "equibiaxial", "planar")
_PULLED = (*_STRETCHING, "simple-shear")
COLUMNS: dict[str, Column] = {
    "mode": Column("mode"),
    "stretch": Column("strain", modes=_STRETCHING),
    "engineering strain": Column("strain", modes=_PULLED),  # an amount of shear in simple shear
    "logarithmic strain": Column("strain", modes=_STRETCHING, convert=lambda e, _: np.exp(e)),
    "elongation": Column("strain", parse_unit("m")[1], _PULLED, "length", lambda u, length: u / length),
    "amount of shear": Column("strain", modes=("simple-shear",)),
    "shear angle": Column("strain", modes=("simple-shear",), convert=lambda a, _: np.tan(a)),
    "volume ratio": Column("strain", modes=("volumetric",)),
    "nominal stress": Column("stress", _STRESS, _PULLED),
    "cauchy stress": Column("stress", _STRESS, _PULLED, is_cauchy=True),
    "force": Column("stress", parse_unit("N")[1], _PULLED, "area", lambda force, area: force / area),
    "pressure": Column("stress", _STRESS, ("volumetric",)),
    "standard deviation": Column("deviation", _STRESS),
    IGNORE: Column("ignored"),
}
"""Columns by name."""
_ALIASES = {
    "strain": "engineering strain",
    "nominal strain": "engineering strain",
    "tensile strain": "engineering strain",
    "dehnung": "engineering strain",
    "true strain": "logarithmic strain",
    "displacement": "elongation",
    "extension": "elongation",
    "crosshead": "elongation",
    "traverse": "elongation",
    "traversenweg": "elongation",
    "crosshead displacement": "elongation",
    "verlängerung": "elongation",
    "standardweg": "elongation",
    "weg": "elongation",
    "shear": "amount of shear",
    "shear strain": "amount of shear",
    "engineering stress": "nominal stress",
    "first piola-kirchhoff stress": "nominal stress",
    "shear stress": "nominal stress",
    "true stress": "cauchy stress",
    "load": "force",
    "axial force": "force",
    "kraft": "force",
    "standardkraft": "force",
    "prüfkraft": "force",
    "sd": "standard deviation",
    **dict.fromkeys(("time", "total time", "elapsed time", "test time", "zeit", "prüfzeit", "temps"), IGNORE),
    **dict.fromkeys(("cycle", "cycles", "cycle count", "total cycles", "total cycle count", "zyklus"), IGNORE),
    **dict.fromkeys(("point", "index", "no", "nr", "temperature", "temperatur"), IGNORE),
}
_AMBIGUOUS = ("stress", "tensile stress", "compressive stress", "spannung")
_TITLE = re.compile(r"\s*(.*?)\s*(?:[\[(]\s*([^\[\]()]*?)\s*[\])])?\s*", re.DOTALL)


_REMARK = re.compile(r"\s*\([^()]*\)$")
"""A remark in round brackets at the end of a name, such as ``Tensile strain (Extension)``."""


def _plain(title: str) -> tuple[str, str]:
    """Return the name in a title, in a plain form, and the text of its unit."""
    match = _TITLE.fullmatch(title)
    assert match is not None
    if match[2] and title.rstrip().endswith(")") and not is_unit(match[2]):
        return _spaced(title), ""
    return _spaced(match[1]), match[2] or ""


def _spaced(name: str) -> str:
    return " ".join(name.lower().replace("_", " ").rstrip(".").split())


@dataclass(frozen=True)
class Names:
    """Names that a user gives to titles of a file, such as ``{"spannung": "nominal stress [MPa]"}``."""

    names: Mapping[str, str]

    @cached_property
    def _plain_names(self) -> dict[str, str]:
        whole = {_spaced(title): column for title, column in self.names.items()}
        return {_plain(title)[0]: column for title, column in self.names.items()} | whole

    def lookup(self, title: str) -> tuple[str, str]:
        """Return the name of the column with a title, which may be unknown, and the text of its unit."""
        name, unit = _plain(title)
        without_remark = _REMARK.sub("", name)
        given = next((n for n in (_spaced(title), name, without_remark) if n in self._plain_names), None)
        if given is not None:
            name, own = _plain(self._plain_names[given])
            unit = own or unit
        elif without_remark in {*COLUMNS, *_ALIASES, *_AMBIGUOUS}:
            name = without_remark
        return _ALIASES.get(name, name), unit

    def column(self, title: str, unit_below: str) -> tuple[str, float]:
        """Return name and SI factor of a column.

        Args:
            unit_below: unit in the row below the titles, if there is one.

        Raises:
            ValueError: the name is unknown, or the unit is missing or another.
        """
        name, unit = self.lookup(title)
        if COLUMNS.get(name, COLUMNS["mode"]).role == "ignored":
            return name, 1.0
        remedy = f"name it so with --column '{title}=nominal stress', or leave it out with --column '{title}={IGNORE}'"
        if name in _AMBIGUOUS:
            raise ValueError(f"column '{title}': is it a nominal stress or a Cauchy stress? Name it so ({remedy})")
        if name not in COLUMNS:
            hint = did_you_mean(name, [*COLUMNS, *_ALIASES])
            raise ValueError(f"unknown column '{title}'.{hint} Or leave it out with --column '{title}={IGNORE}'")
        unit = unit or _bare(unit_below)
        dimension = COLUMNS[name].dimension
        if not unit and dimension != _PURE:
            example = {"Pa": "MPa", "m": "mm"}.get(dimension.unit, dimension.unit)
            raise ValueError(f"column '{title}' needs a unit: '{name} [{example}]'")
        try:
            factor, unit_dimension = parse_unit("" if unit in ("-", "1") else unit)
        except ValueError as error:
            raise ValueError(f"column '{title}': {error}") from None
        if unit_dimension != dimension:
            raise ValueError(
                f"column '{title}': must be {dimension}, but {unit or 'a number without unit'} is {unit_dimension}"
            )
        return name, as_float(factor)

    def known(self, row: Row) -> int:
        """Return how many entries of a row name a column."""
        return sum(name in COLUMNS or name in _AMBIGUOUS for name, _ in map(self.lookup, row.entries))

    def score(self, row: Row) -> int:
        """Return how many entries of a row name a column, 0 if it names no strain or no stress."""
        roles = [
            "stress" if name in _AMBIGUOUS else COLUMNS[name].role
            for name, _ in map(self.lookup, row.entries)
            if name in COLUMNS or name in _AMBIGUOUS
        ]
        return len(roles) if {"strain", "stress"} <= set(roles) else 0


def _bare(unit: str) -> str:
    return unit.strip(" []()")


def header_of(rows: Sequence[Row], names: Names) -> tuple[int, int]:
    """Return the index of the row that names the columns, and its score.

    If no row names a strain and a stress, it is the one with the most known names, and at best no numbers.
    """
    searched = rows[:_SEARCHED]
    scores = [names.score(row) for row in searched]
    known = [names.known(row) for row in searched]
    best = max(range(len(scores)), key=lambda i: (scores[i], known[i], known[i] > 0 and not rows[i].has_numbers, -i))
    return best, scores[best]


def is_row_of_units(row: Row, titles: Row, names: Names) -> bool:
    """Return whether a row below the titles has units, such as ``(s), (mm), (N)``; of unused columns any text."""
    used = [
        _bare(unit)
        for title, unit in zip(titles.entries, row.entries, strict=False)
        if (name := names.lookup(title)[0]) != IGNORE and (name in COLUMNS or name in _AMBIGUOUS)
    ]
    return not row.has_numbers and any(used) and all(map(is_unit, used))
