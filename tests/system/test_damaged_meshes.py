"""Meshes that are cut, contradict themselves or claim to be huge end in one message, and in nothing else."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import environment, hpcinv, hpcinv_here
from helpers.mesh_cases import TETRAHEDRON, spec, write_msh22

from hpcinv.base.parallel import code_cache
from hpcinv.errors import MeshError
from hpcinv.job.resolved_job import file_digest
from hpcinv.mesh.body import read_source
from hpcinv.mesh.checks import check
from hpcinv.mesh.io import isolated
from hpcinv.mesh.io.isolated import run_isolated
from hpcinv.mesh.mesh_files import save

pytestmark = pytest.mark.usefixtures("warm_reader")

VTU = """<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<UnstructuredGrid><Piece NumberOfPoints="{points}" NumberOfCells="{cells}">
<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">{at}</DataArray></Points>
<Cells><DataArray type="Int64" Name="connectivity" format="ascii">{nodes}</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">{offsets}</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">{types}</DataArray></Cells>
<CellData>{data}</CellData></Piece></UnstructuredGrid></VTKFile>"""
XDMF = """<?xml version="1.0"?><Xdmf Version="3.0"><Domain><Grid Name="m"><Topology TopologyType="Tetrahedron">
<DataItem Dimensions="{cells}" NumberType="Int" Format="{format}">{nodes}</DataItem></Topology><Geometry>
<DataItem Dimensions="{points}" Format="XML">{at}</DataItem></Geometry>{data}</Grid></Domain></Xdmf>"""
AT = "0 0 0 1 0 0 0 1 0 0 0 1"
IN_VTU = {"points": 4, "cells": 1, "at": AT, "nodes": "0 1 2 3", "offsets": "4", "types": "10", "data": ""}
IN_XDMF = {"points": "4 3", "cells": "1 4", "at": AT, "nodes": "0 1 2 3", "format": "XML", "data": ""}


def array(kind: str, name: str, values: str, components: int = 1) -> str:
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="ascii">{values}</DataArray>'
    )


def refused(path: Path, content: str | bytes) -> str:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(MeshError) as caught:
        check(read_source(spec(path), path))
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_the_meshes_that_are_damaged_here_are_right_otherwise(tmp_path: Path) -> None:
    for name, text in (("a.vtu", VTU.format(**IN_VTU)), ("a.xdmf", XDMF.format(**IN_XDMF))):
        (tmp_path / name).write_text(text)
        check(read_source(spec(tmp_path / name), tmp_path / name))


@pytest.mark.everyday("nodes-0", "points-1", "offsets", "types", "data-1", "data-2", "at-1")
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nodes": "0 1 2 9"}, r"1 cells have nodes that do not exist \(cell 1\); the mesh has 4 nodes"),
        ({"nodes": "0 1 2 -1"}, "1 cells have nodes that do not exist"),
        ({"nodes": "0 1"}, 'VTK cannot read it: .*the "connectivity" array is not long enough'),
        ({"at": "0 0 0"}, "VTK cannot read it: .*The data array in the element may be too short"),
        ({"points": 4_000_000_000}, "NumberOfPoints is 4000000000 in a file of ... bytes"),
        ({"cells": 4_000_000_000}, "NumberOfCells is 4000000000"),
        ({"points": -4}, "NumberOfPoints is -4"),
        ({"points": "many"}, "NumberOfPoints is many"),
        ({"data": array("Float64", "a", "1", 4_000_000_000)}, "NumberOfComponents is 4000000000"),
        ({"offsets": "4000000000000000000"}, "VTK cannot read it"),
        ({"types": "99"}, "cells are of the type 99"),
        (
            {"cells": 2, "nodes": "0 1 2 3 3 2 1 0", "offsets": "4 8", "types": "10 10"},
            r"2 cells have the same vertices as another \(cells 1, 2\)",
        ),
        ({"data": array("Float64", "region:a", "1 2 3", 3)}, "'region:a' is not one number for each entity"),
        ({"data": array("Float64", "region:a", "1.5")}, "'region:a' has values that are not integers"),
        ({"data": array("Float64", "cell_tag", "1 2 3", 3)}, "'cell_tag' is not one number for each entity"),
        ({"at": AT.replace("1", "1e300")}, r"coordinates are beyond 1e\+60 m"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_a_damaged_vtu_file_is_reported(
    tmp_path: Path, changes: dict[str, str], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    faults = refused(tmp_path / "a.vtu", VTU.format(**IN_VTU | changes))
    assert len(faults.splitlines()) <= 3
    assert re.search(message, faults), faults
    assert capfd.readouterr() == ("", "")  # nothing of VTK's own


def test_sizes_in_other_encodings_are_seen(tmp_path: Path) -> None:
    text = VTU.format(**IN_VTU | {"points": 4_000_000_000}).replace("?>", ' encoding="UTF-16"?>')
    assert "NumberOfPoints is 4000000000" in refused(tmp_path / "a.vtu", text.encode("utf-16"))


@pytest.mark.release
def test_a_header_that_ends_in_blanks_is_refused_at_once(tmp_path: Path) -> None:
    """Patterns with a cubic number of matches took minutes."""
    text = VTU.format(**IN_VTU).partition('"4"')[0] + '"' + 20_000 * " "
    assert "VTK cannot read it" in refused(tmp_path / "a.vtu", text)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nodes": "0 1 2 9"}, "1 cells have nodes that do not exist"),
        ({"nodes": "0 1"}, "a DataItem has 2 numbers, but its Dimensions are '1 4'"),
        ({"cells": "4000000000 4"}, "a DataItem has 4 numbers, but its Dimensions are '4000000000 4'"),
        ({"cells": "-1 4"}, "its Dimensions are '-1 4'"),
        ({"cells": "1 4 1"}, "the topology is not an integer table"),
        ({"cells": "one"}, "has values that are not integers"),
        ({"nodes": "a b c d"}, "has values that are not integers"),
        ({"nodes": "0 1 2 99999999999999999999"}, "has values that are not integers"),
        ({"at": "0 0 0"}, "a DataItem has 3 numbers, but its Dimensions are '4 3'"),
        ({"format": "HDF", "nodes": "gone.h5:/a"}, "there is no file '.*gone.h5'"),
        ({"format": "HDF", "nodes": "/dev/zero:/a"}, "there is no file '/dev/zero'"),
        ({"format": "HDF", "nodes": "no.h5:/a"}, "no.h5:/a cannot be read"),
        ({"format": "HDF", "nodes": "text.h5:/name"}, "text.h5:/name is not an array of numbers"),
        ({"format": "HDF", "nodes": "text.h5:/huge"}, "text.h5:/huge has a shape that is too large for the file"),
        ({"cells": "2 4", "nodes": "0 1 2 3 3 2 1 0"}, "2 cells have the same vertices"),
        (
            {"data": '<Attribute Center="Cell"><DataItem Dimensions="1">x</DataItem></Attribute>'},
            "has values that are not numbers",
        ),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_a_damaged_xdmf_file_is_reported(
    tmp_path: Path, changes: dict[str, str], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    import h5py

    (tmp_path / "no.h5").write_text("no HDF5")
    with h5py.File(tmp_path / "text.h5", "w") as file:
        file["name"] = "text"
        file.create_dataset("huge", (10**12, 4), dtype=np.int64, chunks=(1000, 4))
    faults = refused(tmp_path / "a.xdmf", XDMF.format(**IN_XDMF | changes))
    assert re.search(message, faults), faults
    assert capfd.readouterr() == ("", "")  # nothing of HDF5's own


def test_a_fingerprint_of_an_xdmf_mesh_without_its_numbers_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.xdmf"
    path.write_text(XDMF.format(**IN_XDMF | {"format": "HDF", "nodes": "gone.h5:/a"}))
    with pytest.raises(MeshError, match=r"a.xdmf: .*gone.h5 cannot be read: No such file"):
        file_digest(path)


def test_crashes_of_gmsh_are_reported(tmp_path: Path, meshes: Path, capfd: pytest.CaptureFixture[str]) -> None:
    mesh = read_source(spec(meshes / "box.py"), meshes / "box.py")
    path = tmp_path / "a.msh"
    save(path, mesh, mesh.points)
    message = refused(path, re.sub(rb"\n2 1 ", b"\n-1 1 ", path.read_bytes()))  # a group of dimension -1
    assert "gmsh cannot read it: it crashed (SIGSEGV)" in message
    assert capfd.readouterr() == ("", "")


@pytest.mark.release
def test_a_file_that_gmsh_has_read_is_not_tried_again(
    tmp_path: Path, meshes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = read_source(spec(meshes / "box.py"), meshes / "box.py")
    path = tmp_path / "a.msh"
    save(path, mesh, mesh.points)
    tried = list[str]()
    monkeypatch.setattr(code_cache, "_places", (tmp_path / "records",))

    def counted(action: str, file: Path) -> subprocess.CompletedProcess[bytes]:
        tried.append(action)
        return run_isolated(action, file)

    monkeypatch.setattr(isolated, "run_isolated", counted)
    first, second = (read_source(spec(path), path) for _ in range(2))
    assert tried == ["msh"]
    assert np.array_equal(first.points, second.points)
    save(path, mesh, 2 * first.points)  # another content under the same name
    read_source(spec(path), path)
    assert len(tried) == 2


def test_a_mesh_is_read_where_the_directory_of_kernels_is_refused(tmp_path: Path, meshes: Path) -> None:
    kernels = tmp_path / "kernels"
    kernels.mkdir()
    kernels.chmod(0o777)
    mesh = meshes / "pdms-beam-sagging.msh"
    done = hpcinv(1, "mesh", "partition", mesh, "a.bp", "--parts", 2, cwd=tmp_path, HPCINV_KERNELS=str(kernels))
    assert done.returncode == 0, done.stderr
    assert not list(kernels.iterdir())


def test_an_msh_file_cut_anywhere_is_reported_or_whole(tmp_path: Path) -> None:
    path = write_msh22(tmp_path / "a.msh", TETRAHEDRON, [(4, 1, 1, (1, 2, 3, 4))], [(3, 1, "body")])
    lines = path.read_text().splitlines()
    for kept in range(3, len(lines) - 2, 3):
        refused(path, "\n".join(lines[:kept]))


def test_a_changed_byte_of_a_partitioned_mesh_is_reported_before_adios2_meets_it(tmp_path: Path, meshes: Path) -> None:
    """In a process of its own, since ADIOS2 does not survive it where it is not seen."""
    code = "import sys; from hpcinv.__main__ import main; sys.exit(main(sys.argv[1:]))"
    whole = tmp_path / "a.bp"

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", code, *map(str, arguments)]
        return subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=120, check=False)

    made = hpcinv_here("mesh", "partition", meshes / "box.py", whole, "--parts", 2, "--parameter", "nx=2", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    for name, place, gather in (("md.idx", -8, run), ("md.0", 40, partial(hpcinv_here, cwd=tmp_path))):
        content = bytearray((whole / name).read_bytes())
        content[place] ^= 0x10
        original = (whole / name).read_bytes()
        (whole / name).write_bytes(content)
        done = gather("mesh", "gather", whole, tmp_path / "b.vtu")
        (whole / name).write_bytes(original)
        assert done.returncode == 2
        assert done.stderr.startswith(f"{whole}: {name} in it is damaged")
    header = json.loads((whole / "mesh.json").read_text())
    (whole / "mesh.json").write_text(json.dumps(header | {"nodes": header["nodes"] + 1}))
    done = hpcinv_here("mesh", "gather", whole, tmp_path / "b.vtu", cwd=tmp_path)
    assert done.stderr.startswith(f"{whole}: mesh.json in it is damaged")
