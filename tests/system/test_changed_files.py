"""Results are not taken from another time when a file has changed that a generator or a plugin reads."""

from __future__ import annotations

import py_compile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.command_line import NO_CERTIFICATE

from hpcinv.__main__ import main
from hpcinv.base.files.inputs import changed_inputs
from hpcinv.base.parallel.runtime import MPI
from hpcinv.driver import run
from hpcinv.errors import CheckpointError, JobError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import load
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.body import read_source
from hpcinv.output.run_directory import RunDirectory
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.sweep.sweep_interface import sweep

BLOCK = """
{head}
def build(gmsh):
    {read}
    gmsh.model.addPhysicalGroup(3, [t for _, t in gmsh.model.getEntities(3)], name="part")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 10.0)
    gmsh.model.mesh.generate(3)
"""
BOX = "gmsh.model.occ.addBox(0, 0, 0, length, 10, 10); gmsh.model.occ.synchronize()"
GEO = 'SetFactory("OpenCASCADE");\nInclude "part.pro";\nBox(1) = {0, 0, 0, L, 10, 10};\nMesh.MeshSizeMax = 10;\n'


def _step(directory: Path, length: float) -> None:
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addBox(0, 0, 0, length, 10, 10)
    gmsh.model.occ.synchronize()
    gmsh.write(str(directory / "part.step"))
    gmsh.finalize()


def _text(name: str, form: str) -> Callable[[Path, float], None]:
    def write(directory: Path, length: float) -> None:
        (directory / name).write_text(form.format(length))

    return write


def _module(directory: Path, length: float) -> None:
    """Write a module and its byte code: Python then does not open the module to import it."""
    (directory / "part_size.py").write_text(f"length = {length}")
    py_compile.compile(str(directory / "part_size.py"), doraise=True)


IMPORT = 'gmsh.model.occ.importShapes("part.step"); gmsh.model.occ.synchronize()'
KINDS: dict[str, tuple[str, str, str, Callable[[Path, float], None]]] = {
    "CAD model": ("part.py", BLOCK.format(head="", read=IMPORT), "part.step", _step),
    "table": (
        "part.py",
        BLOCK.format(head="", read=f'length = float(open("part.txt").read()); {BOX}'),
        "part.txt",
        _text("part.txt", "{}"),
    ),
    "module": (
        "part.py",
        BLOCK.format(head="from part_size import length", read=BOX),
        "part_size.py",
        _module,
    ),
    "script": ("part.geo", GEO, "part.pro", _text("part.pro", "L = {};\n")),
}


def length_of(directory: Path, name: str) -> tuple[float, dict[str, str]]:
    source = read_source(MeshSpec.model_construct(file=name), directory / name)
    return float(source.points[:, 0].max()), dict(source.inputs)


@pytest.mark.parametrize("kind", KINDS)
def test_a_mesh_knows_the_files_of_which_it_is_made(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From another working directory: relative paths in a generator start from its own."""
    name, text, file, write = KINDS[kind]
    (tmp_path / "meshes").mkdir()
    home = tmp_path / "meshes"
    (home / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    write(home, 30)
    length, inputs = length_of(Path("meshes"), name)
    assert length == pytest.approx(30)
    assert list(inputs) == [file]
    assert changed_inputs(inputs, home) == []
    write(home, 60)
    assert changed_inputs(inputs, home) == [file]
    assert length_of(Path("meshes"), name)[0] == pytest.approx(60)
    assert Path.cwd() == tmp_path


def part(directory: Path) -> Path:
    """A job on a block whose length is in a file."""
    (directory / "part.py").write_text(KINDS["table"][1])
    (directory / "part.txt").write_text("30")
    job = {
        "mesh": {"file": "part.py", "unit": "mm"},
        "regions": {"foot": "x < 0.01 mm"},
        "material": {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.4},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        "supports": [{"region": "foot", "fix": ["x", "y", "z"]}],
        "quantities": [{"name": "volume", "of": "1", "on": "part", "reduce": "integral", "over": "current"}],
        "certificate": NO_CERTIFICATE,
    }
    path = directory / "part.yaml"
    path.write_text(yaml.safe_dump(job, sort_keys=False))
    return path


def test_a_sweep_solves_its_cases_again(tmp_path: Path, comm: MPI.Intracomm) -> None:
    part(tmp_path)
    file = tmp_path / "sweep.yaml"
    file.write_text("job: part.yaml\nstore: store\naxes: [{grid: {material.young: [1 MPa, 2 MPa]}}]\n")
    assert sweep(file, comm)["volume"] == pytest.approx(2 * [3e-6], rel=1e-12)
    (tmp_path / "part.txt").write_text("60")
    assert sweep(file, comm)["volume"] == pytest.approx(2 * [6e-6], rel=1e-12)
    done: list[str] = []
    assert sweep(file, comm, note=done.append)["volume"] == pytest.approx(2 * [6e-6], rel=1e-12)
    assert done == []  # nothing is solved a third time


@pytest.mark.release
def test_a_study_executes_its_runs_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    part(tmp_path)
    study: dict[str, Any] = {
        "job": "part.yaml",
        "series": [{"name": "degree", "vary": {"discretisation.displacement": [1]}}],
        "measure": ["volume"],
        "reference": {"volume": 3e-6},
        "repeat": 1,
    }
    (tmp_path / "st.yaml").write_text(yaml.safe_dump(study))
    monkeypatch.chdir(tmp_path)
    volumes = []
    for length in ("30", "60"):
        (tmp_path / "part.txt").write_text(length)
        assert main(["study", "run", "st.yaml"]) == 0
        header, row = (tmp_path / "results" / "st" / "table.csv").read_text().splitlines()[:2]
        volumes.append(float(row.split(",")[header.split(",").index("volume")]))
    capsys.readouterr()
    assert volumes == pytest.approx([3e-6, 6e-6], rel=1e-12)


@pytest.mark.release
def test_a_finished_run_is_not_taken_for_one_on_another_mesh(tmp_path: Path, comm: MPI.Intracomm) -> None:
    job = load(part(tmp_path))
    with Workspace(comm) as workspace:
        run(job, comm, directory=tmp_path / "out", workspace=workspace)
        directory = RunDirectory(tmp_path / "out")
        directory.check_same_problem(job)
        (tmp_path / "part.txt").write_text("60")
        with pytest.raises(CheckpointError, match=r"inputs\.part\.txt"):
            directory.check_same_problem(job)
        with pytest.raises(CheckpointError, match=r"inputs\.part\.txt"):  # of its checkpoints
            run(job, comm, directory=tmp_path / "out", resume=True)
        assert run(job, comm, workspace=workspace).quantities["volume"] == pytest.approx(6e-6, rel=1e-12)


@pytest.mark.release
def test_other_nodes_of_the_same_cells_are_another_problem(tmp_path: Path, comm: MPI.Intracomm) -> None:
    """What a generator depends on may be no file, such as a variable of the environment."""
    path = part(tmp_path)
    job = load(path)
    run(job, comm, directory=tmp_path / "out")
    text = (tmp_path / "part.txt").read_text()
    for file in (tmp_path / "out" / "checkpoints").glob("*/state.json"):
        assert '"nodes"' in file.read_text()
    (tmp_path / "part.txt").write_text(text)  # the same content at another time is the same file
    assert run(job, comm, directory=tmp_path / "out", resume=True).quantities["volume"] == pytest.approx(3e-6)


def test_files_of_plugins_and_named_files_count(tmp_path: Path) -> None:
    path = part(tmp_path)
    (tmp_path / "table.csv").write_text("1")
    (tmp_path / "plugin.py").write_text('rows = open("table.csv").read()\n')
    job = yaml.safe_load(path.read_text())

    def key(**more: Any) -> str:
        path.write_text(yaml.safe_dump(job | more))
        return content_key(load(path))

    before = key(), key(files=["table.csv"]), key(plugins=["plugin.py"])
    (tmp_path / "table.csv").write_text("2")
    assert key() == before[0]
    assert key(files=["table.csv"]) != before[1]
    with pytest.raises(JobError, match=r"table\.csv' has changed since this process imported it; start Python again"):
        key(plugins=["plugin.py"])
    with pytest.raises(JobError, match=r"files\[0\]: there is no file"):
        key(files=["missing.csv"])
