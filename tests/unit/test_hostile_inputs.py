"""Small files that would take hours, where a process without limits of time reads them: counted, or read once."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from hpcinv.base.mesh_formats import FORMATS
from hpcinv.base.reading import bdf_files
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.included_files import Inclusions, lines_of
from hpcinv.errors import MeshError
from hpcinv.job.resolved_job import file_digest
from hpcinv.mesh.io.isolated import read_isolated

COUNT = 20_000
INCLUDES: dict[str, tuple[str, Callable[[Path], object]]] = {
    ".inp": ("*INCLUDE, INPUT={}\n", lambda path: list(lines_of(path))),
    ".bdf": ("INCLUDE '{}'\n", lambda path: list(bdf_files.lines_of(path, Inclusions(path.parent), ()))),
}


def chain(directory: Path, suffix: str, levels: int, times: int, last: str) -> Path:
    """Write files each of which includes the next one some times."""
    text, _ = INCLUDES[suffix]
    for level in range(levels):
        (directory / f"{level}{suffix}").write_text(text.format(f"{level + 1}{suffix}") * times)
    (directory / f"{levels}{suffix}").write_text(last)
    return directory / f"0{suffix}"


@pytest.mark.everyday(".inp")
@pytest.mark.parametrize("suffix", INCLUDES)
def test_included_files_are_counted_by_how_often_they_are_read(suffix: str, tmp_path: Path) -> None:
    path = chain(tmp_path, suffix, 4, 10, "$ nothing\n")
    with pytest.raises(Fault, match="includes more than 1,000 files") as refused:
        INCLUDES[suffix][1](path)
    assert refused.value.advice == "Include each file once."
    assert FORMATS[suffix].data_files(path) == [f"{level}{suffix}" for level in range(1, 5)]
    assert FORMATS[".inp"].groups(path) is None or suffix == ".bdf"


@pytest.mark.parametrize("suffix", INCLUDES)
def test_bytes_of_repeated_files_are_counted(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hpcinv.base.reading.included_files._REPEATED", 500)
    for times, is_refused in ((4, False), (8, True)):
        path = chain(tmp_path, suffix, 1, times, "$" * 100 + "\n")
        if is_refused:
            with pytest.raises(Fault, match="bytes again"):
                INCLUDES[suffix][1](path)
        else:
            INCLUDES[suffix][1](path)


def test_a_file_that_includes_many_others_once_is_read(tmp_path: Path) -> None:
    names = [f"part-{number}.inp" for number in range(300)]
    for name in names:
        (tmp_path / name).write_text("*NODE\n1, 0, 0, 0\n")
    (tmp_path / "body.inp").write_text("".join(f"*INCLUDE, INPUT={name}\n" for name in names))
    assert len(list(lines_of(tmp_path / "body.inp"))) == 600


LONG = "123456789012345678901"
NUMBERED = {
    "node.inp": f"*NODE\n{LONG}, 0, 0, 0\n*ELEMENT, TYPE=C3D4\n1, {LONG}, 2, 3, 4\n",
    "element.inp": f"*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n*ELEMENT, TYPE=C3D4\n{LONG}, 1, 2, 3, 4\n",
    "set.inp": (
        "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n*ELEMENT, TYPE=C3D4, ELSET=a\n1, 1, 2, 3, 4\n"
        f"*NSET, NSET=b\n{LONG}\n"
    ),
    "element.bdf": f"BEGIN BULK\nGRID,1,,0.,0.,0.\nCTETRA,{LONG},1,1,2,3,4\nENDDATA\n",
    "node.unv": f"    -1\n  2411\n{LONG} 1 1 1\n 0. 0. 0.\n    -1\n",
    "element.feb": (
        '<?xml version="1.0"?><febio_spec version="4.0"><Mesh><Nodes><node id="1">0,0,0</node><node id="2">1,0,0</node>'
        '<node id="3">0,1,0</node><node id="4">0,0,1</node></Nodes><Elements type="tet4" name="a">'
        f'<elem id="{LONG}">1,2,3,4</elem></Elements></Mesh></febio_spec>'
    ),
}


@pytest.mark.everyday("node.inp", "element.inp", "set.inp", "element.bdf")
@pytest.mark.parametrize("name", NUMBERED)
def test_numbers_beyond_64_bits_get_a_message(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(NUMBERED[name])
    with pytest.raises(MeshError) as refused:
        read_isolated(path.suffix[1:], path, "cannot be read", "")
    assert any(text in refused.value.message for text in ("beyond", "is not defined", "whole number"))
    assert "C long" not in refused.value.message
    assert "Error" not in refused.value.message


HOSTILE = {
    "sections without an end.msh": b"$MeshFormat\n$Elements\n" + b"$PhysicalNames\n" * COUNT,
    "empty lines.msh": b"$MeshFormat\n$Elements\n$PhysicalNames\n" + b"\n" * COUNT + b"$EndPhysicalNames\n",
    "elements without an end.feb": b"<Nodes " * COUNT,
    "names without an end.feb": b'<Nodes name="' * COUNT,
    "keywords.inp": b"*NODE" + b", NSET" * COUNT,
    "continued keyword.inp": b"*NODE," + b",\n" * COUNT,
    "name without an end.bdf": b"INCLUDE 'a\n" + b"x\n" * COUNT,
    "elements without an end.vtu": b"<VTKFile>" + b"<DataArray Name='a'>" * COUNT,
    "elements without an end.xdmf": b"<Xdmf><Domain>" + b"<Grid><Topology/>" * COUNT,
    "empty lines.mhd": b"\n" * COUNT,
    "list of one file.mhd": b"ElementDataFile = LIST\n" + b"list of one file.mhd\n" * COUNT,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_headers_are_searched_in_linear_time(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(HOSTILE[name])
    kind = FORMATS.get(path.suffix)
    began = time.process_time()
    for search in (kind.groups, kind.data_files, kind.fault_inside) if kind else (file_digest,):
        with suppress(ValueError, Fault):  # of XML without an end
            search(path)
    assert time.process_time() - began < 2  # some of them took minutes
