"""Material tests in tables: columns named with their units, such as ``stretch [-], nominal stress [MPa]``.

Lines ``# mode: planar``, ``# area: 25 mm^2`` and ``# length: 20 mm`` ahead of the columns state what holds for the
whole file; other lines that begin with ``#`` are comments.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn, Self

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.csv_rows import Row
from hpcinv.base.quantity.quantity import Quantity
from hpcinv.base.quantity.schema import shown
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.table_files import readings_of
from hpcinv.base.quantity.units import Dimension, parse_quantity, parse_unit, readable
from hpcinv.errors import JobError
from hpcinv.studies.fitting.columns import COLUMNS, IGNORE, Names, header_of, is_row_of_units
from hpcinv.studies.fitting.cycles import loading_branches
from hpcinv.studies.fitting.homogeneous import MODES, Mode

_PURE, _STRESS = Dimension(), parse_unit("Pa")[1]
_LARGEST_FILE = 50_000_000  # bytes
_MOST_PROBLEMS = 20
_SYNONYMS = {"pure shear": "planar", "biaxial": "equibiaxial", "shear": "simple-shear", "simple shear": "simple-shear"}
_STATEMENTS = {"mode": None, "area": Quantity("m^2", above=0.0), "length": Quantity("m", above=0.0)}


_LINE = "line"  # of a row, besides its values
_RELATIVE = {"engineering strain", "elongation"}  # a stretch is 1 more


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
        return self.select(self.largest_stretch <= largest, self.rest_count)

    def deformed(self) -> Self:
        """Return the points that are deformed."""
        moved = self.measure != self.mode.rest_measure
        return self.select(moved, int((~moved).sum()))

    def select(self, kept: np.ndarray, rest_count: int = 0) -> Self:
        """Return the points that are kept; ``rest_count`` is the number of those left out as not deformed."""
        deviation = None if self.deviation is None else self.deviation[kept]
        measure, stress = self.measure[kept], self.stress[kept]
        return replace(self, measure=measure, stress=stress, deviation=deviation, rest_count=rest_count)


@dataclass(frozen=True)
class FileOptions:
    """Options of a user on files of tests.

    Attributes:
        mode: of files that do not state it.
        area, length: of the undeformed specimen (m², m); they go before statements of a file.
        columns: names of columns by titles of a file; names of the user go first.
        cycle: the branch of loading that is taken, from 1; left out, all points.
        sheet: of workbooks; left out, the first.
        decimal_comma: whether commas in entries between quotation marks are decimal ones.
    """

    mode: str | None = None
    area: float | None = None
    length: float | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    cycle: int | None = None
    sheet: str | None = None
    decimal_comma: bool = False


@dataclass(frozen=True)
class TestFile:
    """Tests of a file, one for each mode, and lines that say what was understood."""

    tests: list[Test]
    notes: tuple[str, ...]


def read_file(path: Path, options: FileOptions) -> TestFile:
    """Read a file; its rows are sorted by mode, if it has a column for that.

    Raises:
        JobError: with file, line, column and remedy of each fault.
    """
    return _TableReader(path, options).file()


def mode_named(text: str) -> Mode:
    """Return a mode by its name or a synonym; ``ValueError`` if there is none."""
    name = " ".join(text.lower().split())
    name = _SYNONYMS.get(name, name.replace(" ", "-"))
    if name not in MODES:
        raise ValueError(f"unknown mode {shown(text)}.{did_you_mean(name, MODES)}")
    return MODES[name]


_TITLES = "a line must name the columns, such as: stretch [-], nominal stress [MPa]"


class _TableReader:
    """Reader of one file by the options of a user."""

    def __init__(self, path: Path, options: FileOptions) -> None:
        self._path, self._options = path, options
        self._names = Names(options.columns)
        self._statements: dict[str, float | Mode] = {}
        self._problems: list[str] = []
        self._notes: list[str] = []

    def file(self) -> TestFile:
        rows = self._rows()
        if not rows:
            self._fail(f"has no columns; {_TITLES}")
        head, score = header_of(rows, self._names)
        titles, data = rows[head], rows[head + 1 :]
        has_units = bool(data) and is_row_of_units(data[0], titles, self._names)
        columns = self._columns(titles, data[0].entries if has_units else (), understood=bool(score))
        self._describe(titles, columns, titled=head, units=data[0].line if has_units else None)
        data = data[has_units:]
        if not data:
            self._fail("has no data below the names of its columns")
        sorted_rows = self._sorted_rows(columns, data)
        self._end()
        several = len(sorted_rows) > 1
        tests = [self._test(mode, columns, mode_rows, several) for mode, mode_rows in sorted_rows.items()]
        return TestFile(tests, tuple(self._notes))

    def _fail(self, text: str, line: int | None = None) -> NoReturn:
        self._problem(text, line)
        self._end()
        raise AssertionError

    def _problem(self, text: str, line: int | None = None) -> None:
        place = "" if line is None else f" line {line}:"
        self._problems.append(f"{self._path}:{place} {text}")

    def _end(self) -> None:
        if more := len(self._problems) - _MOST_PROBLEMS:
            self._problems[_MOST_PROBLEMS:] = [f"{self._path}: and {more} more problems like these"] if more > 0 else []
        if self._problems:
            raise JobError(*self._problems)

    def _rows(self) -> list[Row]:
        """Return the rows of the file, read in the way that names most columns; statements are kept."""
        options = self._options
        try:
            ways = list(
                readings_of(self._path, _LARGEST_FILE, sheet=options.sheet, decimal_comma=options.decimal_comma)
            )
        except ValueError as error:
            self._fail(str(error))
        rows_by_way = [[row for row in way.rows if isinstance(row, Row)] for way in ways]
        scores = [header_of(rows, self._names)[1] if rows else 0 for rows in rows_by_way]
        best = scores.index(max(scores))
        self._notes.append(f"{self._path}: {ways[best].description}")
        for comment in ways[best].rows:
            if not isinstance(comment, Row):
                self._statement(comment[1], comment[0])
        for key, value in (("area", options.area), ("length", options.length)):
            if value is not None:
                self._statements[key] = value
        return rows_by_way[best]

    def _statement(self, text: str, line: int) -> None:
        key, colon, value = (part.strip() for part in text.partition(":"))
        if not colon or key.lower() not in _STATEMENTS:
            return
        try:
            quantity = _STATEMENTS[key.lower()]
            self._statements[key.lower()] = quantity.parse(value) if quantity else mode_named(value)
        except ValueError as error:
            self._problem(f"{key}: {error}", line)

    def _columns(self, titles: Row, units: Sequence[str], *, understood: bool) -> dict[int, tuple[str, float]]:
        """Return name and SI factor of each column by its index."""
        columns: dict[int, tuple[str, float]] = {}
        line = titles.line
        if not understood and titles.has_only_numbers:
            self._fail(f"has numbers; {_TITLES}", line)
        for i, title in enumerate(titles.entries):
            if not title and i >= len(titles.entries) - 1 > 0:  # a delimiter at the end of each line
                continue
            try:
                name, factor = self._names.column(title, units[i] if i < len(units) else "")
                if name != IGNORE and name in [other for other, _ in columns.values()]:
                    raise ValueError(f"the column '{name}' occurs twice")
                columns[i] = name, factor
            except ValueError as error:
                self._problem(str(error), line)
        self._end()
        self._check_columns([name for name, _ in columns.values()], line)
        self._end()
        return columns

    def _check_columns(self, columns: Sequence[str], line: int) -> None:
        """Note a problem unless there are a strain, a stress and what both need."""
        for role, examples in (("strain", "stretch [-]"), ("stress", "nominal stress [MPa]")):
            names = [name for name in columns if COLUMNS[name].role == role]
            if len(names) != 1:
                fault = f"more than one column of {role}: {', '.join(names)}" if names else f"no column of {role}"
                remedy = f"leave one out with --column 'TITLE={IGNORE}'" if names else ""
                possible = ", ".join(name for name, column in COLUMNS.items() if column.role == role)
                needed = remedy or f"it needs one of {possible}, with its unit, such as '{examples}'"
                self._problem(f"has {fault}; {needed}", line)
        for name in columns:
            need = COLUMNS[name].needs
            if need and need not in self._statements:
                example = {"area": "25 mm^2", "length": "20 mm"}[need]
                remedy = f"--{need} '{example}', or a line '# {need}: {example}' ahead of the columns"
                self._problem(f"the column '{name}' needs {remedy}", line)

    def _describe(
        self, titles: Row, columns: Mapping[int, tuple[str, float]], *, titled: int, units: int | None
    ) -> None:
        """Note what was understood of the columns."""
        ahead = f" after {titled} lines of titles" if titled > 1 else " after a line of titles" if titled else ""
        below = f", their units in line {units}" if units is not None else ""
        self._notes.append(f"  names of columns in line {titles.line}{ahead}{below}")
        ignored = [titles.entries[i] for i, (name, _) in columns.items() if name == IGNORE]
        for i, (name, factor) in columns.items():
            if name != IGNORE:
                need = COLUMNS[name].needs
                over = f", over {need} {_stated(need, self._statements[need])}" if need else ""
                self._notes.append(f"  '{titles.entries[i]}': {name}{_size_of(name, factor)}{over}")
        if ignored:
            self._notes.append(f"  not used: {', '.join(ignored)}")

    def _sorted_rows(
        self, columns: dict[int, tuple[str, float]], rows: list[Row]
    ) -> dict[Mode, list[dict[str, float]]]:
        """Return the values (SI) of all rows by column, sorted by mode."""
        mode_rows: dict[Mode, list[dict[str, float]]] = {}
        for row in rows:
            line, entries = row.line, row.entries
            if len(entries) <= max(columns) or any(entries[max(columns) + 1 :]):
                self._problem(f"has {len(entries)} entries, but there are {len(columns)} columns", line)
                continue
            values: dict[str, float] = {}
            mode: Mode | None = None
            for i, (name, factor) in columns.items():
                try:
                    if COLUMNS[name].role == "ignored":
                        continue
                    if COLUMNS[name].role == "mode":
                        mode = mode_named(entries[i])
                    else:
                        values[name] = factor * _finite(row.number(i), entries[i])
                except ValueError as error:
                    self._problem(f"column '{name}': {error}", line)
            try:
                mode = mode or self._mode()
                if len(values) == len([1 for n, _ in columns.values() if COLUMNS[n].role not in ("mode", "ignored")]):
                    self._check(mode, values, line)
                    mode_rows.setdefault(mode, []).append({**values, _LINE: line})
            except ValueError as error:
                self._fail(str(error))
        return mode_rows

    def _mode(self) -> Mode:
        stated = self._statements.get("mode")
        if isinstance(stated, Mode):
            return stated
        if self._options.mode is None:
            raise ValueError(
                f"does not say which test it is; give --mode, a line '# mode: uniaxial' or a column 'mode': "
                f"{', '.join(MODES)}"
            )
        return mode_named(self._options.mode)

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
            if role not in ("mode", "ignored")
        }
        lines = [int(row[_LINE]) for row in rows]
        stem = self._path.stem
        name = f"{stem}, {mode.name}" if several or mode.name not in stem else stem
        is_cauchy = COLUMNS[role_names["stress"]].is_cauchy
        test = Test(name, mode, arrays["strain"], arrays["stress"], arrays.get("deviation"), is_cauchy)
        return self._branch(test, lines)

    def _branch(self, test: Test, lines: Sequence[int]) -> Test:
        """Return the branch of loading that the user asks for, and note what the test has."""
        mode, cycle = test.mode, self._options.cycle
        branches = loading_branches(test.measure, mode.rest_measure)
        several = f", {len(branches)} cycles" if len(branches) > 1 else ""
        self._notes.append(f"  {mode.name} test of {len(test)} points{several}: {_ranges(test)}")
        if cycle is None:
            if several:
                self._notes.append("  all points are taken; --cycle N takes the loading branch of cycle N")
            return test
        if cycle > len(branches):
            self._fail(f"has {len(branches)} cycles of loading, not {cycle}")
        first, last = branches[cycle - 1]
        kept = np.zeros(len(test), dtype=bool)
        kept[first : last + 1] = True
        branch = test.select(kept)
        place = f"lines {lines[first]} to {lines[last]}"
        self._notes.append(f"  loading of cycle {cycle}: {len(branch)} points, {place}: {_ranges(branch)}")
        return branch


def _ranges(test: Test) -> str:
    stress = "pressure" if test.mode.is_volumetric else "Cauchy stress" if test.is_cauchy else "nominal stress"
    low, high = (readable(float(value), "Pa") for value in (test.stress.min(), test.stress.max()))
    return f"{test.mode.measure} {test.measure.min():.4g} to {test.measure.max():.4g}, {stress} {low} to {high}"


def _stated(need: str, value: float | Mode) -> str:
    assert isinstance(value, float)
    return f"{value * 1e6:.6g} mm^2" if need == "area" else f"{value * 1e3:.6g} mm"


def _finite(number: float, text: str) -> float:
    if not math.isfinite(number):
        raise ValueError(f"{shown(text)} is too large")
    return number


def _size_of(name: str, factor: float) -> str:
    """Return the unit of a column as text for a note."""
    unit = COLUMNS[name].dimension.unit
    if not unit and factor == 1:
        return ""
    whole = readable(factor, unit) if unit else ""
    plain = f"{factor:.6g} {unit}".rstrip() if factor != 1 else unit
    return f" in {whole[2:] if whole.startswith('1 ') else plain}"


def _deviation(text: str) -> tuple[float, Dimension]:
    """Return value and dimension of a standard deviation that a user gives."""
    try:
        value, dimension = parse_quantity(text)
        if dimension not in (_PURE, _STRESS) or not value > 0:
            raise ValueError(f"must be a stress or a part of the stress above 0, not '{text}'")
    except ValueError as error:
        raise JobError(f"--sd: {error}") from None
    return value, dimension


def set_deviations(tests: list[Test], given: list[str]) -> list[Test]:
    """Return tests with standard deviations of their stress: from their files, or the given ones.

    Args:
        given: a stress, a part of the measured stress such as ``3 %``, or both, whose squares are added.

    Raises:
        JobError: a given one is neither, or some tests have none although others have.
    """
    absolute, relative = 0.0, 0.0
    for value, dimension in map(_deviation, given):
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
            raise JobError(
                f"{test.name}: {relative:.3g} of a stress of 0 is not a standard deviation; add --sd '1 kPa'"
            )
        weighted.append(replace(test, deviation=deviation))
    return weighted
