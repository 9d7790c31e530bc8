"""Material tests in CSV files: columns named with their units, such as ``stretch [-], nominal stress [MPa]``.

Lines ``# mode: planar``, ``# area: 25 mm^2`` and ``# length: 20 mm`` ahead of the columns state what holds for the
whole file; other lines that begin with ``#`` are comments.
"""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from hpcinv.errors import JobError
from hpcinv.fitting.homogeneous import MODES, Mode
from hpcinv.quantity.arrays import Floats
from hpcinv.quantity.csv_rows import Row, rows_of, text_of
from hpcinv.quantity.quantity import Quantity
from hpcinv.quantity.schema import shown
from hpcinv.quantity.suggestions import did_you_mean
from hpcinv.quantity.units import Dimension, as_float, parse_quantity, parse_unit

_PURE, _STRESS = Dimension(), parse_unit("Pa")[1]
_LARGEST_FILE = 50_000_000  # bytes
_MOST_PROBLEMS = 20
_SYNONYMS = {"pure shear": "planar", "biaxial": "equibiaxial", "shear": "simple-shear", "simple shear": "simple-shear"}
_STATEMENTS = {"mode": None, "area": Quantity("m^2", above=0.0), "length": Quantity("m", above=0.0)}


@dataclass(frozen=True)
class _Column:
    """Kind of a column: its role, dimension, and the conversion of a value (SI) to the measure or stress."""

    role: str  # "strain", "stress", "deviation" or "mode"
    dimension: Dimension = _PURE
    modes: tuple[str, ...] = ()
    needs: str = ""  # a statement of the file
    convert: Callable[[Floats, float], Floats] = lambda values, _: values
    is_cauchy: bool = False


_STRETCHING = ("uniaxial", "equibiaxial", "planar")
_PULLED = (*_STRETCHING, "simple-shear")
COLUMNS: dict[str, _Column] = {
    "mode": _Column("mode"),
    "stretch": _Column("strain", modes=_STRETCHING),
    "engineering strain": _Column("strain", modes=_PULLED),  # an amount of shear in simple shear
    "logarithmic strain": _Column("strain", modes=_STRETCHING, convert=lambda e, _: np.exp(e)),
    "elongation": _Column("strain", parse_unit("m")[1], _PULLED, "length", lambda u, length: u / length),
    "amount of shear": _Column("strain", modes=("simple-shear",)),
    "shear angle": _Column("strain", modes=("simple-shear",), convert=lambda a, _: np.tan(a)),
    "volume ratio": _Column("strain", modes=("volumetric",)),
    "nominal stress": _Column("stress", _STRESS, _PULLED),
    "cauchy stress": _Column("stress", _STRESS, _PULLED, is_cauchy=True),
    "force": _Column("stress", parse_unit("N")[1], _PULLED, "area", lambda force, area: force / area),
    "pressure": _Column("stress", _STRESS, ("volumetric",)),
    "standard deviation": _Column("deviation", _STRESS),
}
"""Columns by name."""
_ALIASES = {
    "strain": "engineering strain",
    "nominal strain": "engineering strain",
    "true strain": "logarithmic strain",
    "displacement": "elongation",
    "shear": "amount of shear",
    "shear strain": "amount of shear",
    "engineering stress": "nominal stress",
    "first piola-kirchhoff stress": "nominal stress",
    "shear stress": "nominal stress",
    "true stress": "cauchy stress",
    "sd": "standard deviation",
}
_RELATIVE = {"engineering strain", "elongation"}  # of which a stretch is 1 more


@dataclass(frozen=True)
class Test:
    """One kind of test from one file.

    Attributes:
        measure: stretch, amount of shear or volume ratio, (n,).
        stress: in Pa, (n,); the pressure of a volumetric test.
        deviation: standard deviations of the stress in Pa (n,), or ``None``.
        rest_count: number of points left out because they are not deformed, where every law gives 0.
    """

    name: str
    mode: Mode
    measure: Floats
    stress: Floats
    deviation: Floats | None = None
    is_cauchy: bool = False
    rest_count: int = 0

    def __len__(self) -> int:
        return len(self.measure)

    @property
    def largest_stretch(self) -> Floats:
        """The largest principal stretch of each point (n,), of an incompressible material."""
        return np.asarray(self.mode.stretches(self.measure).max(axis=1))

    def up_to(self, largest: float) -> Self:
        """Return the points whose largest principal stretch is not above a limit."""
        return self._select(self.largest_stretch <= largest, self.rest_count)

    def deformed(self) -> Self:
        """Return the points that are deformed."""
        moved = self.measure != self.mode.rest_measure
        return self._select(moved, int((~moved).sum()))

    def _select(self, kept: np.ndarray, rest_count: int) -> Self:
        deviation = None if self.deviation is None else self.deviation[kept]
        measure, stress = self.measure[kept], self.stress[kept]
        return replace(self, measure=measure, stress=stress, deviation=deviation, rest_count=rest_count)


def read_tests(path: Path, mode: str | None = None) -> list[Test]:
    """Read a file; its rows are sorted by mode, if it has a column for that.

    Args:
        mode: of files that do not state it.

    Raises:
        JobError: with file, line, column and remedy of each fault.
    """
    return _Reader(path, mode).tests()


def mode_named(text: str) -> Mode:
    """Return a mode by its name or a synonym; ``ValueError`` if there is none."""
    name = " ".join(text.lower().split())
    name = _SYNONYMS.get(name, name.replace(" ", "-"))
    if name not in MODES:
        raise ValueError(f"unknown mode {shown(text)}.{did_you_mean(name, MODES)}")
    return MODES[name]


_TITLES = "the first line must name the columns, such as: stretch [-], nominal stress [MPa]"


def _is_number(row: Row, i: int) -> bool:
    try:
        row.number(i)
    except ValueError:
        return False
    return True


class _Reader:
    def __init__(self, path: Path, mode: str | None) -> None:
        self._path, self._default = path, mode
        self._statements: dict[str, float | Mode] = {}
        self._problems: list[str] = []

    def tests(self) -> list[Test]:
        rows = list(self._rows())
        if not rows:
            self._fail(f"has no columns; {_TITLES}")
        columns = self._columns(rows[0])
        if not rows[1:]:
            self._fail("has no data below the names of its columns")
        sorted_rows = self._sorted_rows(columns, rows[1:])
        self._end()
        several = len(sorted_rows) > 1
        return [self._test(mode, columns, mode_rows, several) for mode, mode_rows in sorted_rows.items()]

    def _fail(self, text: str, line: int | None = None) -> None:
        self._problem(text, line)
        self._end()

    def _problem(self, text: str, line: int | None = None) -> None:
        place = "" if line is None else f" line {line}:"
        self._problems.append(f"{self._path}:{place} {text}")

    def _end(self) -> None:
        if more := len(self._problems) - _MOST_PROBLEMS:
            self._problems[_MOST_PROBLEMS:] = [f"{self._path}: and {more} more problems like these"] if more > 0 else []
        if self._problems:
            raise JobError(*self._problems)

    def _rows(self) -> Iterator[Row]:
        """Yield each row that is not empty; statements are kept."""
        try:
            for row in rows_of(text_of(self._path, _LARGEST_FILE)):
                if isinstance(row, Row):
                    yield row
                else:
                    self._statement(row[1], row[0])
        except ValueError as error:
            self._fail(str(error))

    def _statement(self, text: str, line: int) -> None:
        key, colon, value = (part.strip() for part in text.partition(":"))
        if not colon or key.lower() not in _STATEMENTS:
            return
        try:
            quantity = _STATEMENTS[key.lower()]
            self._statements[key.lower()] = quantity.parse(value) if quantity else mode_named(value)
        except ValueError as error:
            self._problem(f"{key}: {error}", line)

    def _columns(self, titles: Row) -> dict[int, tuple[str, float]]:
        """Return name and SI factor of each column by its index."""
        columns: dict[int, tuple[str, float]] = {}
        line = titles.line
        if all(_is_number(titles, i) for i in range(len(titles.entries))):
            self._fail(f"has numbers; {_TITLES}", line)
        for i, title in enumerate(titles.entries):
            try:
                name, factor = _column(title)
                if name in [other for other, _ in columns.values()]:
                    raise ValueError(f"the column '{name}' occurs twice")
                columns[i] = name, factor
            except ValueError as error:
                self._problem(str(error), line)
        self._end()
        for role, examples in (("strain", "stretch [-]"), ("stress", "nominal stress [MPa]")):
            names = [name for name, _ in columns.values() if COLUMNS[name].role == role]
            if len(names) != 1:
                fault = f"more than one column of {role}: {', '.join(names)}" if names else f"no column of {role}"
                possible = ", ".join(name for name, column in COLUMNS.items() if column.role == role)
                self._problem(f"has {fault}; it needs one of {possible}, with its unit, such as '{examples}'", line)
        for name, _ in columns.values():
            need = COLUMNS[name].needs
            if need and need not in self._statements:
                example = {"area": "25 mm^2", "length": "20 mm"}[need]
                self._problem(f"the column '{name}' needs a line '# {need}: {example}' ahead of the columns", line)
        self._end()
        return columns

    def _sorted_rows(
        self, columns: dict[int, tuple[str, float]], rows: list[Row]
    ) -> dict[Mode, list[dict[str, float]]]:
        """Return the values (SI) of all rows by column, sorted by mode."""
        mode_rows: dict[Mode, list[dict[str, float]]] = {}
        for row in rows:
            line, entries = row.line, row.entries
            if len(entries) != len(columns):
                self._problem(f"has {len(entries)} entries, but there are {len(columns)} columns", line)
                continue
            values: dict[str, float] = {}
            mode: Mode | None = None
            for i, (name, factor) in columns.items():
                try:
                    if COLUMNS[name].role == "mode":
                        mode = mode_named(entries[i])
                    else:
                        values[name] = factor * _finite(row.number(i), entries[i])
                except ValueError as error:
                    self._problem(f"column '{name}': {error}", line)
            try:
                mode = mode or self._mode()
                if len(values) == len([1 for n, _ in columns.values() if COLUMNS[n].role != "mode"]):
                    self._check(mode, values, line)
                    mode_rows.setdefault(mode, []).append(values)
            except ValueError as error:
                self._fail(str(error))
        return mode_rows

    def _mode(self) -> Mode:
        stated = self._statements.get("mode")
        if isinstance(stated, Mode):
            return stated
        if self._default is None:
            raise ValueError(
                f"does not say which test it is: give --mode, or add a line '# mode: uniaxial' or a column 'mode'; "
                f"modes are {', '.join(MODES)}"
            )
        return mode_named(self._default)

    def _check(self, mode: Mode, values: dict[str, float], line: int) -> None:
        for name, value in values.items():
            column = COLUMNS[name]
            if column.modes and mode.name not in column.modes:
                possible = [n for n, c in COLUMNS.items() if c.role == column.role and mode.name in c.modes]
                self._fail(f"column '{name}' does not fit a {mode.name} test, which has {' or '.join(possible)}", line)
            if column.role == "deviation" and value <= 0:
                self._problem(f"column '{name}': must be above 0, not {value:g}", line)
            if column.role == "strain" and not mode.is_shear:
                measure = self._converted(name, mode, np.array([value]))[0]
                if not (measure > 0 and math.isfinite(measure)):
                    self._problem(
                        f"column '{name}': gives a {mode.measure} of {measure:g}, which must be above 0", line
                    )

    def _converted(self, name: str, mode: Mode, values: Floats) -> Floats:
        column = COLUMNS[name]
        stated = self._statements.get(column.needs, 1.0)
        assert isinstance(stated, float)
        converted = column.convert(values, stated)
        return converted + 1.0 if name in _RELATIVE and not mode.is_shear else converted

    def _test(
        self, mode: Mode, columns: dict[int, tuple[str, float]], rows: list[dict[str, float]], several: bool
    ) -> Test:
        role_names = {COLUMNS[name].role: name for name, _ in columns.values()}
        arrays = {
            role: self._converted(name, mode, np.array([row[name] for row in rows]))
            for role, name in role_names.items()
            if role != "mode"
        }
        stem = self._path.stem
        name = f"{stem}, {mode.name}" if several or mode.name not in stem else stem
        is_cauchy = COLUMNS[role_names["stress"]].is_cauchy
        return Test(name, mode, arrays["strain"], arrays["stress"], arrays.get("deviation"), is_cauchy)


_TITLE = re.compile(r"\s*(.*?)\s*(?:[\[(]\s*(.*?)\s*[\])])?\s*")


def _column(title: str) -> tuple[str, float]:
    """Return name and SI factor of a column from its title, such as ``nominal stress [MPa]``."""
    match = _TITLE.fullmatch(title)
    assert match is not None
    name, unit = " ".join(match[1].lower().replace("_", " ").split()), match[2]
    name = _ALIASES.get(name, name)
    if name == "stress":
        raise ValueError(f"column '{title}': is it a nominal stress or a Cauchy stress? Name it so")
    if name not in COLUMNS:
        raise ValueError(f"unknown column '{title}'.{did_you_mean(name, [*COLUMNS, *_ALIASES])}")
    dimension = COLUMNS[name].dimension
    if not unit and dimension != _PURE:
        example = {"Pa": "MPa", "m": "mm"}.get(dimension.unit, dimension.unit)
        raise ValueError(f"column '{title}' needs a unit: '{name} [{example}]'")
    try:
        factor, unit_dimension = parse_unit("" if unit in (None, "-", "1") else unit)
    except ValueError as error:
        raise ValueError(f"column '{title}': {error}") from None
    if unit_dimension != dimension:
        raise ValueError(f"column '{title}': must be {dimension}, but {unit} is {unit_dimension}")
    return name, as_float(factor)


def _finite(number: float, text: str) -> float:
    if not math.isfinite(number):
        raise ValueError(f"{shown(text)} is too large")
    return number


def set_deviations(tests: list[Test], given: list[str]) -> list[Test]:
    """Return tests with standard deviations of their stress: those of their files, or the given ones.

    Args:
        given: a stress, a part of the measured stress such as ``3 %``, or both, whose squares are added.

    Raises:
        JobError: a given one is neither, or some tests have none although others have.
    """
    absolute, relative = 0.0, 0.0
    for text in given:
        try:
            value, dimension = parse_quantity(text)
            if dimension not in (_PURE, _STRESS) or not value > 0:
                raise ValueError(f"must be a stress or a part of the stress above 0, not '{text}'")
        except ValueError as error:
            raise JobError(f"--sd: {error}") from None
        absolute, relative = (absolute, value) if dimension == _PURE else (value, relative)
    if not given:
        missing = [test.name for test in tests if test.deviation is None]
        if missing and len(missing) < len(tests):
            raise JobError(f"{missing[0]}: has no column 'standard deviation', as other tests have; give one with --sd")
        return tests
    weighted = []
    for test in tests:
        deviation = np.hypot(absolute, relative * test.stress) if test.deviation is None else test.deviation
        if not (deviation > 0).all():
            raise JobError(f"{test.name}: {relative:.3g} of a stress of 0 is no standard deviation; add --sd '1 kPa'")
        weighted.append(replace(test, deviation=deviation))
    return weighted
