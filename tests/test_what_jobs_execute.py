"""What a job file can make a run execute: nothing that is called a mesh, and with --untrusted nothing at all."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import pytest
from command_line import CUBE, hpcinv, write_job
from mesh_cases import spec

from hpcinv.errors import JobError, MeshError
from hpcinv.job import load
from hpcinv.mesh import read_source
from hpcinv.mesh.gmsh_model import save_msh
from hpcinv.mesh.readers import FILES
from hpcinv.study.plan import load_plan
from hpcinv.sweep.plan import load_sweep


@pytest.fixture
def marker(tmp_path: Path) -> Path:
    """What a script in here makes if it is executed."""
    return tmp_path / "executed"


@pytest.fixture
def mesh(tmp_path: Path, meshes: Path) -> Path:
    path = tmp_path / "box.msh"
    source = read_source(spec(meshes / "box.py", parameters={"nx": 1, "ny": 1, "nz": 1}), meshes / "box.py")
    save_msh(path, source, source.points)
    return path


def scripts(marker: Path) -> dict[str, bytes]:
    call = f'SystemCall "touch {marker}";\n'.encode()
    return {
        "script": call,
        "after an empty line": b"\n" + call,
        "after a comment": b"// $MeshFormat\n" + call,
        "after white space": b" $MeshFormat\n4.1 0 8\n$EndMeshFormat\n" + call,
        "after a byte order mark": b"\xef\xbb\xbf$MeshFormat\n" + call,
        "after an unknown section": b"$Nonsense\n$EndNonsense\n" + call,
        "post-processing": b"$PostFormat\n1.4 0 8\n$EndPostFormat\n" + call,
        "compressed": gzip.compress(call),
        "empty": b"",
    }


@pytest.mark.parametrize("name", scripts(Path()))
def test_a_script_called_a_mesh_is_refused_before_gmsh_sees_it(name: str, marker: Path, tmp_path: Path) -> None:
    mesh = tmp_path / "mesh.msh"
    mesh.write_bytes(scripts(marker)[name])
    for section in ({"mesh": {"file": "mesh.msh"}}, {"expected_shape": {"file": "mesh.msh"}}):
        job = write_job(tmp_path / "job.yaml", CUBE, **section)
        (key,) = section
        with pytest.raises(JobError, match=rf"{key}.file: '.*mesh.msh' is no mesh in the MSH format, whose first line"):
            load(job)
    with pytest.raises(MeshError, match="is no mesh in the MSH format"):  # where the file has changed meanwhile
        FILES[".msh"](mesh)
    assert not marker.exists()


def test_the_command_line_executes_no_mesh(marker: Path, tmp_path: Path) -> None:
    (tmp_path / "mesh.msh").write_bytes(scripts(marker)["script"])
    job = write_job(tmp_path / "job.yaml", CUBE, mesh={"file": "mesh.msh"})
    for arguments in (("run", job), ("mesh", "partition", "mesh.msh", "parts.bp", "--parts", 1)):
        done = hpcinv(1, *arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert "is no mesh in the MSH format" in done.stderr
    assert not marker.exists()


def test_options_that_lie_beside_a_mesh_are_not_executed(mesh: Path, marker: Path) -> None:
    """gmsh reads NAME.msh.opt, a script, after NAME.msh."""
    mesh.with_name("box.msh.opt").write_bytes(scripts(marker)["script"])
    assert len(FILES[".msh"](mesh).cells) == 6
    assert not marker.exists()


def test_a_comment_may_come_first(mesh: Path) -> None:
    content = mesh.read_bytes()
    mesh.write_bytes(b"$Comments\nof a box\n$EndComments\n" + content)
    assert len(FILES[".msh"](mesh).cells) == 6


def test_errors_name_the_mesh_and_not_where_gmsh_has_read_it(mesh: Path) -> None:
    mesh.write_bytes(b"$MeshFormat\n4.1 0 8\nnonsense\n")
    with pytest.raises(MeshError) as refused:
        FILES[".msh"](mesh)
    assert str(refused.value).count(str(mesh)) >= 1
    assert "hpcinv-mesh-" not in str(refused.value)


@pytest.mark.parametrize(
    "name",
    [".", "..", "...", ".hidden", "-rf", "../up", "a/b", "a\\b", "/tmp/a", "a\nb", "a\0b", "a\x1b[2Jb", "", "a" * 101],
)
def test_names_of_results_stay_in_the_directory_of_results(name: str, tmp_path: Path) -> None:
    job = write_job(tmp_path / "job.yaml", CUBE, job=name)
    assert_refused(load, job, "job")
    plain = write_job(tmp_path / "plain.yaml", CUBE)
    axes = [{"grid": {"material.young": ["1 MPa"]}}]
    sweep = write_job(tmp_path / "sweep.yaml", {"job": plain.name, "axes": axes}, sweep=name)
    assert_refused(load_sweep, sweep, "sweep")
    ladders = [{"name": "a", "vary": {"discretisation.displacement": [1, 2]}}]
    study = write_job(tmp_path / "study.yaml", {"job": plain.name, "ladders": ladders, "measure": ["a"]}, study=name)
    assert_refused(load_plan, study, "study")


def assert_refused(reader: Any, path: Path, key: str) -> None:
    with pytest.raises(JobError) as refused:
        reader(path)
    (problem,) = (p for p in refused.value.problems if p.startswith(f"{path}: {key}: "))
    assert "is not allowed: up to 100 letters, digits, dots, _, -" in problem
    assert problem.isprintable()
    assert len(problem) < len(str(path)) + 200


def test_names_as_they_were_are_names_still(tmp_path: Path) -> None:
    for name in ("a", "_a", "a.b-c_d", "2026-11", "a" * 100):
        assert load(write_job(tmp_path / "job.yaml", CUBE, job=name)).job == name
