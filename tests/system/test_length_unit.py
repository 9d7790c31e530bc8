"""The recovered shape is written in the unit of the given mesh, states it, and is not read as if it were another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK, ROOT, hpcinv_here, write_job
from helpers.mesh_cases import spec, write_msh22
from mpi4py import MPI

from hpcinv.base.quantity.units import length_symbol
from hpcinv.errors import MeshError
from hpcinv.mesh import build_body, read_source, write_mesh
from hpcinv.mesh.io.gmsh_model import session

BOX: dict[str, Any] = {
    "file": str(ROOT / "meshes" / "box.py"),
    "parameters": dict.fromkeys(("nx", "ny", "nz"), 2) | dict.fromkeys(("lx", "ly", "lz"), "80 mm"),
    "unit": "mm",
    "geometry_degree": 2,
}
JOB = BLOCK | {"mesh": BOX, "quantities": [], "output": {"fields": False}}


@pytest.mark.release
def test_a_shape_goes_back_with_the_unit_of_the_job_and_with_no_other(tmp_path: Path) -> None:
    """A result in metres, for a job in mm."""
    there = hpcinv_here("run", write_job(tmp_path / "there.yaml", JOB), "--output", "there", cwd=tmp_path)
    assert there.returncode == 0, there.stderr
    for name in ("shape.msh", "shape.vtu"):
        path = tmp_path / "there" / name
        assert read_source(spec(path, unit="mm"), path).points.max() == pytest.approx(0.08, rel=0.1)
        assert read_source(spec(path), path).points.max() == pytest.approx(0.08, rel=0.1)
        for unit in ("cm", "m"):
            with pytest.raises(MeshError, match=rf"{name}: states that it is in mm") as caught:
                read_source(spec(path, unit=unit), path)
            assert "Write 'unit: mm'" in caught.value.advice
    mesh = {"file": str(tmp_path / "there" / "shape.vtu"), "unit": "cm"}
    job = write_job(tmp_path / "wrong.yaml", JOB, mesh=mesh, analysis="forward")
    wrong = hpcinv_here("run", job, "--output", "wrong", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "shape.vtu: states that it is in mm" in wrong.stderr
    assert "Write 'unit: mm'" in wrong.stderr
    assert not (tmp_path / "wrong").exists()
    mesh = {"file": str(tmp_path / "there" / "shape.msh"), "unit": "mm"}
    job = write_job(tmp_path / "back.yaml", JOB, mesh=mesh, analysis="forward")
    back = hpcinv_here("run", job, "--output", "back", cwd=tmp_path)
    assert back.returncode == 0, back.stderr
    again = read_source(spec(tmp_path / "back" / "shape.msh", unit="mm"), tmp_path / "back" / "shape.msh")
    given = read_source(spec(**BOX), Path(BOX["file"]))
    assert np.abs(again.points - given.points).max() < 1e-9 * 0.08


@pytest.mark.release
def test_an_expected_shape_in_another_unit_is_refused(tmp_path: Path) -> None:
    body = build_body(spec(**BOX), {}, MPI.COMM_SELF)
    write_mesh(tmp_path / "expected.vtu", body, body.mesh.geometry.x * body.length_scale)
    job = write_job(tmp_path / "job.yaml", JOB, expected_shape={"file": "expected.vtu", "unit": "cm"})
    assert "Write 'unit: mm'" in hpcinv_here("run", job, "--output", "run", cwd=tmp_path).stderr
    job = write_job(tmp_path / "job.yaml", JOB, expected_shape={"file": "expected.vtu"})
    assert hpcinv_here("run", job, "--output", "run", cwd=tmp_path).returncode == 0


def test_a_partitioned_mesh_is_in_metres_and_gathered_in_the_unit_it_came_from(tmp_path: Path) -> None:
    msh = write_msh22(tmp_path / "t.msh", [(0, 0, 0), (3, 0, 0), (0, 3, 0), (0, 0, 3)], [(4, 1, 1, [1, 2, 3, 4])])
    cut = hpcinv_here("mesh", "partition", msh, "t.bp", "--parts", "1", "--unit", "in", cwd=tmp_path)
    assert cut.returncode == 0, cut.stderr
    bp = tmp_path / "t.bp"
    source = read_source(spec(bp), bp)
    assert source.points.max() == pytest.approx(0.0762)
    digest = (bp / "mesh.json").read_text()
    assert '"unit": 0.0254' in digest
    for name in ("again.msh", "again.vtu"):
        gathered = hpcinv_here("mesh", "gather", "t.bp", name, cwd=tmp_path)
        assert gathered.stdout == f"{name}: 1 cells and 4 nodes, in in\n"
        again = read_source(spec(tmp_path / name, unit="in"), tmp_path / name)
        assert np.allclose(again.points, source.points, rtol=1e-15, atol=0)
    wrong = hpcinv_here("mesh", "partition", "again.msh", "u.bp", "--parts", "1", "--unit", "mm", cwd=tmp_path)
    assert (wrong.returncode, "Write 'unit: in'" in wrong.stderr) == (2, True)


def test_mesh_files_with_and_without_a_unit_line_are_read(meshes: Path, tmp_path: Path) -> None:
    body = build_body(spec(meshes / "box.py", unit="mm"), {}, MPI.COMM_SELF)
    path = tmp_path / "shape.msh"
    write_mesh(path, body, body.mesh.geometry.x * body.length_scale)
    with session("other") as gmsh:
        gmsh.merge(str(path))
        _, points, _ = gmsh.model.mesh.getNodes()
        assert points.max() == pytest.approx(1000.0)
    stated = path.read_bytes()
    section = b"$Comments\nhpcinv: coordinates in units of 0.001 m\n$EndComments\n"
    assert section in stated
    for number in (b"nan", b"-1", b"0", b"1e999", b"0.001.2", b"mm"):
        damaged = tmp_path / "damaged.msh"
        damaged.write_bytes(stated.replace(b"units of 0.001 m", b"units of " + number + b" m"))
        assert read_source(spec(damaged, unit="cm"), damaged).points.max() == pytest.approx(10.0)
    damaged.write_bytes(stated.replace(section, b""))
    assert read_source(spec(damaged), damaged).points.max() == pytest.approx(1000.0)
    assert read_source(spec(path), path).points.max() == pytest.approx(1.0)
    with pytest.raises(MeshError, match="states that it is in mm, but the unit given for it is m"):
        read_source(spec(path, unit="m"), path)


@pytest.mark.parametrize(
    ("unit", "symbol"), [(1.0, "m"), (1e-3, "mm"), (1e-6, "um"), (0.0254, "in"), (0.3, "0.3 m"), (1000.0, "km")]
)
def test_units_of_length_have_symbols(unit: float, symbol: str) -> None:
    assert length_symbol(unit) == symbol
