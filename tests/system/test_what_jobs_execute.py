"""What a job file can make a run execute: nothing that is called a mesh, and with --untrusted nothing at all."""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import CUBE, ROOT, hpcinv, hpcinv_here, write_job
from helpers.mesh_cases import spec

from hpcinv.__main__ import main
from hpcinv.base.files.untrusted import option_fault
from hpcinv.base.quantity.keys import assigned
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import load
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.mesh import read_source
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.readers import FILES
from hpcinv.studies.study.study_plan import load_study
from hpcinv.studies.sweep.sweep_plan import load_sweep


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
        with pytest.raises(JobError, match=rf"{key}.file: '.*mesh.msh' is not in the MSH format, whose first line"):
            load(job)
    with pytest.raises(MeshError, match="is not in the MSH format"):  # where the file has changed meanwhile
        FILES[".msh"](mesh)
    assert not marker.exists()


def test_the_command_line_executes_no_mesh(marker: Path, tmp_path: Path) -> None:
    (tmp_path / "mesh.msh").write_bytes(scripts(marker)["script"])
    job = write_job(tmp_path / "job.yaml", CUBE, mesh={"file": "mesh.msh"})
    for arguments in (("run", job), ("mesh", "partition", "mesh.msh", "parts.bp", "--parts", 1)):
        done = hpcinv_here(*arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert "is not in the MSH format" in done.stderr
    assert not marker.exists()


def test_options_that_lie_next_to_a_mesh_are_not_executed(mesh: Path, marker: Path) -> None:
    """gmsh reads NAME.msh.opt, a script, after NAME.msh."""
    mesh.with_name("box.msh.opt").write_bytes(scripts(marker)["script"])
    assert len(FILES[".msh"](mesh).cells) == 6
    assert not marker.exists()


@pytest.mark.release
def test_a_comment_may_come_first(mesh: Path) -> None:
    content = mesh.read_bytes()
    mesh.write_bytes(b"$Comments\nof a box\n$EndComments\n" + content)
    assert len(FILES[".msh"](mesh).cells) == 6


@pytest.mark.release
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
    series = [{"name": "a", "vary": {"discretisation.displacement": [1, 2]}}]
    study = write_job(tmp_path / "study.yaml", {"job": plain.name, "series": series, "measure": ["a"]}, study=name)
    assert_refused(load_study, study, "study")


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


GENERATOR = """
from pathlib import Path
Path({marker!r}).touch()
def build(gmsh, *, size=0.5):
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [1], name="block")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(3)
"""
GEO = 'SystemCall "touch {marker}";\nSetFactory("OpenCASCADE");\nBox(1) = {{0, 0, 0, 1, 1, 1}};\n'
OF_PETSC = """
from pathlib import Path
Path({marker!r}).touch()
class Preconditioner: pass
"""

DOORS: dict[str, tuple[dict[str, Any], str, str]] = {
    "plugin": ({"plugins": ["plugin.py"]}, "plugins[0]", "'plugin.py' is a Python file that a run executes"),
    "generator": ({"mesh": {"file": "generator.py"}}, "mesh.file", "'generator.py' is a program that a run executes"),
    "gmsh script": ({"mesh": {"file": "script.geo"}}, "mesh.file", "'script.geo' is a program that a run executes"),
    "expected shape": (
        {"expected_shape": {"file": "generator.py"}},
        "expected_shape.file",
        "'generator.py' is a program that a run executes",
    ),
    "Python in PETSc": (
        {"solver": {"petsc": {"pc_type": "python", "pc_python_type": "of_petsc.Preconditioner"}}},
        "solver.petsc.pc_type",
        "cannot be 'python'",
    ),
    "viewer": (
        {"solver": {"petsc": {"snes_view": "ascii:{marker}"}}},
        "solver.petsc.snes_view",
        "is refused with --untrusted, as all PETSc options that are not known to be harmless",
    ),
}
"""What a job can execute or write: sections, where they are refused, and as what."""


@pytest.fixture
def elsewhere(tmp_path: Path, marker: Path, mesh: Path) -> Path:
    """A directory that came from elsewhere, with programs that make the marker, and a mesh."""
    directory = tmp_path / "download"
    directory.mkdir()
    for name, text in (("plugin.py", OF_PETSC), ("generator.py", GENERATOR), ("script.geo", GEO)):
        (directory / name).write_text(text.format(marker=str(marker)))
    (directory / "of_petsc.py").write_text(OF_PETSC.format(marker=str(marker)))
    mesh.rename(directory / "box.msh")
    return directory


def job_with(directory: Path, marker: Path, changes: dict[str, Any]) -> Path:
    text = json.dumps(changes).replace("{marker}", str(marker))
    small = {"discretisation": {"displacement": 1}, "output": {"fields": False, "mesh": []}}
    return write_job(directory / "job.yaml", CUBE, **{"mesh": {"file": "box.msh"}, **small, **json.loads(text)})


@pytest.mark.everyday("generator")
@pytest.mark.parametrize("door", ["plugin", "generator", "gmsh script", "viewer"])
def test_doors_are_doors(door: str, elsewhere: Path, marker: Path, tmp_path: Path) -> None:
    """Without --untrusted each of them executes or writes something; else the tests below could not fail."""
    done = hpcinv_here("run", job_with(elsewhere, marker, DOORS[door][0]), "--output", "results", cwd=tmp_path)
    assert marker.exists(), done.stderr


def test_python_in_petsc_is_a_door(elsewhere: Path, marker: Path, tmp_path: Path) -> None:
    """In a process of its own: PETSc keeps the class."""
    job = job_with(elsewhere, marker, DOORS["Python in PETSc"][0])
    done = hpcinv(1, "run", job, "--output", "results", cwd=tmp_path, PYTHONPATH=f"{ROOT}:{elsewhere}")
    assert marker.exists(), done.stderr


@pytest.mark.parametrize("door", DOORS)
def test_untrusted_jobs_execute_nothing(door: str, elsewhere: Path, marker: Path) -> None:
    changes, key, text = DOORS[door]
    job = job_with(elsewhere, marker, changes)
    with pytest.raises(JobError) as refused:
        load(job, untrusted=True)
    assert any(p.startswith(f"{job}: {key}: {text}") for p in refused.value.problems), refused.value
    assert "--untrusted" in str(refused.value)
    assert not marker.exists()


def test_all_that_is_refused_is_reported_at_once(elsewhere: Path, marker: Path, tmp_path: Path) -> None:
    changes: dict[str, Any] = {}
    for sections, _, _ in DOORS.values():
        changes |= sections
    job = job_with(elsewhere, marker, changes)
    done = hpcinv_here("run", "--untrusted", job, "--output", "results", cwd=tmp_path)
    assert done.returncode == 2
    for key in ("plugins[0]", "mesh.file", "expected_shape.file", "solver.petsc.snes_view"):
        assert done.stderr.count(f"{job}: {key}: ") == 1, done.stderr
    assert not marker.exists()
    assert not (tmp_path / "results").exists()


def test_an_untrusted_run_ends_as_any_other_and_stays_untrusted(elsewhere: Path, marker: Path, tmp_path: Path) -> None:
    job = job_with(elsewhere, marker, {"solver": {"petsc": {"snes_linesearch_type": "l2", "mat_mumps_icntl_14": 60}}})
    done = hpcinv_here("run", "--untrusted", job, "--output", "results", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "results" / "origin.json").read_text())["untrusted"] is True
    job_with(elsewhere, marker, {"plugins": ["plugin.py"]})
    assert_fails("plugins[0]", "resume", str(tmp_path / "results"), "--job", str(job))
    shutil.copy(job, tmp_path / "results" / "job.yaml")
    assert_fails("plugins[0]", "resume", str(tmp_path / "results"))
    assert not marker.exists()


def assert_fails(text: str, *arguments: str) -> None:
    done = hpcinv_here(*arguments, cwd=ROOT)
    assert done.returncode == 2, done.stderr
    assert text in done.stderr
    assert "Traceback" not in done.stderr


def test_checkpoints_from_elsewhere_are_not_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["resume", "--untrusted", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "checkpoints that came from elsewhere are not read" in error
    assert f"run --untrusted {tmp_path / 'job.yaml'}" in error


@pytest.mark.parametrize("command", ["validate", "explain", "mesh partition", "sweep plan", "study"])
def test_every_command_that_reads_a_job_takes_untrusted(command: str, elsewhere: Path, marker: Path) -> None:
    job = job_with(elsewhere, marker, {"plugins": ["plugin.py"]})
    file, more = job, list[str]()
    if command == "sweep plan":
        file = elsewhere / "sweep.yaml"
        write_job(file, {"job": job.name, "axes": [{"grid": {"material.young": ["1 MPa", "2 MPa"]}}]})
    elif command == "study":
        series = [{"name": "a", "vary": {"discretisation.displacement": [1, 2]}}]
        write_job(elsewhere / "study.yaml", {"job": job.name, "series": series, "measure": ["errors.round_trip.max"]})
        file = elsewhere / "study.yaml"
    elif command == "mesh partition":
        more = [str(elsewhere / "parts.bp"), "--parts", "1"]
    assert_fails("plugins[0]: 'plugin.py' is a Python file", *command.split(), "--untrusted", str(file), *more)
    assert not marker.exists()


def test_a_mesh_from_elsewhere_can_be_cut_into_parts(elsewhere: Path, tmp_path: Path) -> None:
    arguments = ("mesh", "partition", "--untrusted")
    done = hpcinv_here(*arguments, elsewhere / "box.msh", tmp_path / "parts.bp", "--parts", 1, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert_fails("is a program", *arguments, str(elsewhere / "generator.py"), str(tmp_path / "b.bp"), "--parts", "1")
    gathered = ("mesh", "gather", "--untrusted", str(tmp_path / "parts.bp"), str(tmp_path / "box.msh"))
    assert_fails("can make ADIOS2 load libraries", *gathered)


def test_paths_stay_in_the_directory_of_an_untrusted_file(elsewhere: Path, marker: Path, tmp_path: Path) -> None:
    shutil.copy(elsewhere / "box.msh", tmp_path / "private.msh")
    (elsewhere / "link.msh").symlink_to(tmp_path / "private.msh")
    for path in ("../private.msh", str(tmp_path / "private.msh"), "link.msh"):
        job = job_with(elsewhere, marker, {"mesh": {"file": path}})
        load(job)
        with pytest.raises(JobError, match=r"mesh.file: '.* leads out of the directory of the file"):
            load(job, untrusted=True)
    item = '<DataItem Format="HDF">../private.h5:/mesh</DataItem>'
    (elsewhere / "mesh.xdmf").write_text(f"<Xdmf><Domain><Grid><Geometry>{item}</Geometry></Grid></Domain></Xdmf>")
    job = job_with(elsewhere, marker, {"mesh": {"file": "mesh.xdmf"}})
    with pytest.raises(JobError, match=r"'mesh.xdmf' has data in '../private.h5', which leads out of the directory"):
        load(job, untrusted=True)

    job.rename(tmp_path / "job.yaml")
    axes = [{"grid": {"material.young": ["1 MPa"]}}]
    sweep = write_job(elsewhere / "sweep.yaml", {"job": "../job.yaml", "axes": axes, "store": "store"})
    with pytest.raises(JobError) as refused:
        load_sweep(sweep, untrusted=True)
    assert "job: '../job.yaml' leads out of the directory of the file" in str(refused.value)
    assert "store: names a directory of results" in str(refused.value)


def test_axes_of_an_untrusted_sweep_open_no_door(elsewhere: Path, marker: Path) -> None:
    job_with(elsewhere, marker, {})
    axes = [{"grid": {"mesh.file": ["box.msh", "generator.py"]}}, {"grid": {"plugins": [[], ["plugin.py"]]}}]
    sweep = write_job(elsewhere / "sweep.yaml", {"job": "job.yaml", "axes": axes})
    with pytest.raises(JobError) as refused:
        load_sweep(sweep, untrusted=True)
    assert "mesh.file: 'generator.py' is a program" in str(refused.value)
    assert "plugins[0]: 'plugin.py' is a Python file" in str(refused.value)
    assert not marker.exists()


@pytest.mark.parametrize("name", ["petscrc", ".petscrc", "ucx.conf", "dolfinx_jit_options.json", "ffcx_options.json"])
def test_files_that_libraries_read_in_the_working_directory_are_refused(
    name: str, elsewhere: Path, marker: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job = job_with(elsewhere, marker, {})
    (elsewhere / name).touch()
    monkeypatch.chdir(elsewhere)
    assert main(["validate", str(job)]) == 0
    assert main(["validate", "--untrusted", str(job)]) == 2
    assert f"{elsewhere / name}: refused with --untrusted" in capsys.readouterr().err
    monkeypatch.setenv("PMI_RANK", "1")
    assert main(["validate", "--untrusted", str(job)]) == 2
    assert not capsys.readouterr().err


def test_python_modules_next_to_an_untrusted_file_are_not_found(
    elsewhere: Path, marker: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job = job_with(elsewhere, marker, {})
    monkeypatch.chdir(elsewhere)
    monkeypatch.syspath_prepend(str(elsewhere))  # as 'python -m' does
    assert main(["validate", "--untrusted", str(job)]) == 2
    assert "Python imports modules from the working directory" in capsys.readouterr().err


def test_the_environment_can_ask_for_it(elsewhere: Path, marker: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = job_with(elsewhere, marker, {"plugins": ["plugin.py"]})
    monkeypatch.setenv("HPCINV_UNTRUSTED", "1")
    with pytest.raises(JobError, match="is a Python file that a run executes"):
        load(job)
    monkeypatch.setenv("HPCINV_UNTRUSTED", "perhaps")
    with pytest.raises(JobError, match="HPCINV_UNTRUSTED=perhaps: must be 1"):
        load(job)
    assert not marker.exists()


def test_jobs_made_of_mappings_and_changed_jobs_are_untrusted_too(elsewhere: Path, marker: Path) -> None:
    data = read_yaml(job_with(elsewhere, marker, {}))
    job = load(data, directory=elsewhere, untrusted=True)
    assert job.is_untrusted
    for changes in ({"plugins": ["plugin.py"]}, {"mesh.file": "generator.py"}):
        with pytest.raises(JobError, match="refused with --untrusted"):
            job.with_(changes)
        with pytest.raises(JobError, match="refused with --untrusted"):
            load(assigned(data, changes), directory=elsewhere, untrusted=True)
    assert not marker.exists()


ALLOWED = [
    ("ksp_type", "cg"),
    ("fieldsplit_u_pc_type", "gamg"),
    ("mg_levels_2_ksp_max_it", 3),
    ("fieldsplit_u_mg_levels_ksp_chebyshev_esteig", "0,0.1,0,1.05"),
    ("mat_mumps_icntl_14", 60),
    ("mat_mumps_icntl_23", "1000"),
    ("pc_gamg_threshold", 0.01),
    ("ksp_initial_guess_nonzero", None),
    ("snes_divergence_tolerance", "unlimited"),
]
FORBIDDEN = [
    ("pc_type", "python"),
    ("pc_type", "shell"),
    ("snes_type", "python"),
    ("fieldsplit_u_pc_type", "python"),
    ("fieldsplit_u_pc_python_type", "a.B"),
    ("ksp_view", None),
    ("ksp_monitor", "ascii:/tmp/x"),
    ("ksp_max_it", "ascii:/tmp/x"),
    ("ksp_rtol", "1e-3 -log_view :x"),
    ("mat_mumps_icntl_1", 9),
    ("mat_mumps_icntl_22", 1),
    ("mat_mumps_ooc_tmpdir", "/tmp"),
    ("options_file", "x"),
    ("dll_append", "/tmp/x.so"),
    ("prefix_push", "x"),
    ("ksp_type\nlog_view", "cg"),
    ("ksp_type", "cg\n"),
    ("ksp_rtol", "1\n"),
    ("malloc_dump", None),
    ("ksp_rtol ", 1),
    ("", 1),
]


@pytest.mark.parametrize(("name", "value"), ALLOWED)
def test_options_of_petsc_that_do_no_harm_are_allowed(name: str, value: object) -> None:
    assert not option_fault(name, value)


@pytest.mark.parametrize(("name", "value"), FORBIDDEN)
def test_all_other_options_of_petsc_are_refused(name: str, value: object) -> None:
    assert "refused with --untrusted" in option_fault(name, value)


def test_a_submitted_sweep_is_untrusted_where_it_runs(
    elsewhere: Path, marker: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job_with(elsewhere, marker, {})
    sweep = write_job(elsewhere / "sweep.yaml", {"job": "job.yaml", "axes": [{"grid": {"material.young": ["1 MPa"]}}]})
    monkeypatch.chdir(tmp_path)
    script = tmp_path / "results" / "sweep" / "slurm" / "run.sbatch"
    for option, lines in (("--untrusted", 1), ("--dry-run", 0)):
        assert main(["sweep", "submit", str(sweep), "--ntasks", "1", "--dry-run", option]) == 0
        assert script.read_text().splitlines().count("export HPCINV_UNTRUSTED=1") == lines
