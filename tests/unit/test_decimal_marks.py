"""Points and commas in the numbers of tables: decimal, or between thousands, as the other entries show."""

from pathlib import Path

import pytest

from hpcinv.base.quantity.csv_rows import Row, rows_of
from hpcinv.errors import JobError
from hpcinv.studies.batch.axis_table import axis_of
from hpcinv.studies.fitting.measurements import FileOptions, read_file


def numbers(text: str, *, decimal_comma: bool = False) -> list[list[float]]:
    rows = (row for row in rows_of(text, decimal_comma=decimal_comma) if isinstance(row, Row))
    return [[row.number(i) for i in range(len(row.entries))] for row in rows if row.has_numbers]


@pytest.mark.parametrize("between", ["\t", ";"])
@pytest.mark.parametrize(
    ("columns", "values"),
    [
        (["1,234 0.5", "2,500 0.75"], [[1234, 0.5], [2500, 0.75]]),  # another column has points
        (["1,234 1", "999.5 2"], [[1234, 1], [999.5, 2]]),  # another entry has a point
        (["1,234.5 1", "1,234,567 2"], [[1234.5, 1], [1234567, 2]]),
        (["1,234 1", "0,567 2"], [[1.234, 1], [0.567, 2]]),  # a 0 ahead of thousands is not written
        (["1,234 0,5", "2,345 0,7"], [[1.234, 0.5], [2.345, 0.7]]),  # another column has decimal commas
        (["1,234 1234", "2,345 5678"], None),  # whole numbers of another column do not decide
        (["1,234 1", "5678 2"], [[1.234, 1], [5678, 2]]),  # thousands are not marked in this column
        (["1.234,5 0,5", "1.234.567 0,7"], [[1234.5, 0.5], [1234567, 0.7]]),
        (["1.234 1", "0,5 2"], [[1234, 1], [0.5, 2]]),
        (["1.050 1", "1.100 2"], [[1.05, 1], [1.1, 2]]),
        (["-1,234 0.5", "+2,500 0.5"], [[-1234, 0.5], [2500, 0.5]]),
        (["1,2345 0.5", "1,5 1.5"], [[1.2345, 0.5], [1.5, 1.5]]),
    ],
)
def test_the_other_entries_decide(between: str, columns: list[str], values: list[list[float]] | None) -> None:
    text = "\n".join(line.replace(" ", between) for line in columns)
    if values is not None:
        assert numbers(text) == values
    elif between == ";":  # which American programs do not write
        assert numbers(text) == [[1.234, 1234], [2.345, 5678]]
    else:
        with pytest.raises(ValueError, match=r"'1,234' may be 1\.234 or 1234, and the other entries do not decide"):
            numbers(text)
        assert numbers(text, decimal_comma=True) == [[1.234, 1234], [2.345, 5678]]


@pytest.mark.parametrize(
    "lines",
    [
        ["1,234\t1", "0,5\t2", "0.5\t3"],  # both marks in one column
        ["1,234\t0,5", "2,345\t0.5"],
        ["1.050\t0,5", "1.100\t0,7"],  # points next to a column with decimal commas
        ["1,234\t1", "1.234\t2"],
    ],
)
def test_a_column_without_a_clear_decimal_mark_is_refused(lines: list[str]) -> None:
    with pytest.raises(ValueError, match=r"may be 1\.\d+ or 1\d{3}, and the other entries do not decide"):
        numbers("\n".join(lines))


def test_a_version_ahead_of_the_data_does_not_count() -> None:
    lines = ["0;2.1", *(f"{i};0,{i}" for i in range(1, 12)), "1;1,234"]
    assert numbers("\n".join(lines))[-1] == [1, 1.234]


def test_a_fit_says_what_it_has_understood(tmp_path: Path) -> None:
    path = tmp_path / "american.txt"
    path.write_text("# mode: uniaxial\nstretch [-]\tnominal stress [Pa]\n1.1\t1,234\n1.2\t2,500\n")
    file = read_file(path, FileOptions())
    assert file.tests[0].stress == pytest.approx([1234, 2500])
    assert "columns between tabs, commas between thousands" in file.notes[0]
    path.write_text("# mode: uniaxial\nstretch [-];nominal stress [Pa]\n1,1;1.234,5\n1,2;2.500\n")
    file = read_file(path, FileOptions())
    assert file.tests[0].stress == pytest.approx([1234.5, 2500])
    assert "columns between semicolons, decimal commas, points between thousands" in file.notes[0]
    path.write_text("# mode: uniaxial\nstretch [-]\tnominal stress [Pa]\n1\t1,234\n2\t2,500\n")
    with pytest.raises(JobError, match=r"line 3: column 'nominal stress': '1,234' may be 1\.234 or 1234"):
        read_file(path, FileOptions())


def test_an_axis_of_a_sweep_refuses_what_is_ambiguous(tmp_path: Path) -> None:
    path = tmp_path / "axis.txt"
    path.write_text("material.mu [Pa]\tmaterial.poisson\n1,234\t0.3\n2,500\t0.4\n")
    assert axis_of(path, "label", None) == {
        "zip": {"material.mu": ["1234 Pa", "2500 Pa"], "material.poisson": [0.3, 0.4]}
    }
    path.write_text("material.mu [Pa]\n1,234\t\n2,500\t\n")
    with pytest.raises(ValueError, match="line 2: '1,234' may be"):
        axis_of(path, "label", None)
