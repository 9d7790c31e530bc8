"""Tables of points, as spreadsheets write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcinv.errors import MeshError
from hpcinv.geometry.vessels.centrelines import read_centrelines
from hpcinv.studies.batch.axis_table import axis_of
from hpcinv.studies.identification.observations import read_table

ROWS = ["0.1,0.2,0.3", "0.4,0.5,0.6", "0.7,0.8,0.9"]
POINTS = np.arange(1, 10).reshape(3, 3) / 10


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(ROWS),
        "\ufeff" + "\n".join(ROWS),
        "\ufeffx,y,z\n" + "\n".join(ROWS),
        "# from a scan\nx [m];y [m];z [m]\n" + "\n".join(ROWS).replace(",", ";").replace(".", ","),
        "\n".join(ROWS).replace(",", "\t"),
        "Scan 7\nlandmark;x;y;z\n"
        + "\n".join(f"apex {row}" for row in ROWS).replace(",", ";").replace("apex ", "apex;"),
        "\r\n".join(ROWS).replace(",", " ; ") + "\r\n\r\n",
    ],
)
def test_all_points_of_a_table_are_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text, newline="")
    np.testing.assert_array_equal(read_table(path, 3), POINTS)


@pytest.mark.parametrize(
    ("text", "report"),
    [
        ("0.1 mm,0.2 mm,0.3 mm\n0.4,0.5,0.6", "line 1: '0.1 mm' is not a number"),
        ("0.1,0.2,z\n0.4,0.5,0.6", "line 1: 'z' is not a number"),
        ("0,1;0,2", "line 1: has 2 entries, not 3"),
        ("0,1,0,2,0,3", "line 1: has 6 entries, not 3"),
        ("x,y,z\n1.23,5;0,2;0,3", "line 2: '1.23,5' is not a number"),
        ("x;y;z\n1.23,5;0,2;0,3", "line 2: '1.23,5' is not a number"),
        ("x,y,z", "has no points"),
        ("0.1,0.2,nan", "line 1: 'nan' is not a number"),
        ("0.1,0.2,1e999", "line 1: has a number that is too large"),
        ("0.1,0.2," + "3" * 200_000, "line 1: cannot be read: field larger than field limit"),
    ],
)
def test_ambiguous_tables_are_refused(text: str, report: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(MeshError) as refused:
        read_table(path, 3)
    assert refused.value.message == f"{path}: {report}" or refused.value.message.startswith(f"{path}: {report}")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "latin-1"])
def test_other_encodings_are_read(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("x,y,größe\n" + "\n".join(ROWS), encoding=encoding)
    plain = tmp_path / "plain.csv"
    plain.write_text("\n".join(ROWS))
    assert (read_table(path, 3) == read_table(plain, 3)).all()


@pytest.mark.parametrize("content", [b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b"1,2,3\n\x01", b"\0" * 9, b"\xff\xfe\0"])
def test_binary_files_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(content)
    with pytest.raises(MeshError, match="is not a text file"):
        read_table(path, 3)


def test_numbers_ahead_of_the_titles_are_not_rows(tmp_path: Path) -> None:
    """Of landmarks, and of centrelines; a faulty first row is not taken for a title."""
    rows = "\n".join(",".join(map(str, point)) for point in POINTS.tolist())
    path = tmp_path / "points.csv"
    path.write_text(f"Version,4.2\nCount,{len(POINTS)},points\nx,y,z\n(mm),(mm),(mm)\n{rows}\n")
    np.testing.assert_array_equal(read_table(path, 3), POINTS)
    path.write_text(f"1,2\nx,y,z\n{rows}\n".replace("x,y,z\n", ""))
    with pytest.raises(MeshError, match="line 1: has 2 entries, not 3"):
        read_table(path, 3)
    path.write_text("Program,5\nx,y,z,radius\n0,0,0,1\n0,0,9,1\n")
    np.testing.assert_array_equal(read_centrelines(path, 1.0)[0], [[0, 0, 0, 1], [0, 0, 9, 1]])


def test_titles_of_batches_may_have_remarks_in_brackets(tmp_path: Path) -> None:
    path = tmp_path / "batches.csv"
    path.write_text("Modulus (machine 2);Density (g/cm^3)\n(kPa);\n3;1\n4;2\n")
    columns = {"material.mu": "Modulus (machine 2)", "density": "Density"}
    axis = axis_of(path, "batch", columns)
    assert axis == {"zip": {"material.mu": ["3 kPa", "4 kPa"], "density": ["1 g/cm^3", "2 g/cm^3"]}}
