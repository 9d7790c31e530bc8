"""Names that no file can have, readers that go away, and plugins that raise anything: one message and no traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import CUBE, ROOT, environment, write_job

import hpcinv
from hpcinv.errors import HpcinvError, JobError, OutputError
from hpcinv.output.run_directory import RunDirectory, choose

JOB = """
analysis: forward
mesh: {file: m.msh}
material: {law: neo-hookean, mu: 1 Pa, lam: 1 Pa}
supports: [{region: a, fix: [x, y, z]}]
"""
NAMES = ("x" * 300 + ".msh", "a/" * 3000 + "b.msh", "nul\\0.msh", "no\\nfile.msh")


@pytest.fixture
def job(tmp_path: Path) -> Path:
    (tmp_path / "m.msh").write_text("$MeshFormat\n")
    path = tmp_path / "job.yaml"
    path.write_text(JOB)
    return path


def refused(path: Path, text: str) -> str:
    path.write_text(text)
    with pytest.raises(JobError) as caught:
        hpcinv.load(path)
    return str(caught.value)


@pytest.mark.parametrize(
    "name", ["x" * 300 + ".msh", "a/" * 3000 + "b.msh", "nul\\0.msh", "no\\nfile.msh"], ids=range(4)
)
@pytest.mark.parametrize("key", ["mesh", "expected_shape", "plugins"])
def test_a_file_that_cannot_be_is_not_there(job: Path, name: str, key: str) -> None:
    if key == "plugins":
        text = JOB + f'plugins: ["{name}"]'
    elif key == "mesh":
        text = JOB.replace("m.msh", f'"{name}"')
    else:
        text = JOB + f'expected_shape: {{file: "{name}"}}'
    assert f"{job}: {key}" in (message := refused(job, text))
    assert "there is no file" in message


def test_a_unit_of_nothing_is_refused(job: Path) -> None:
    for unit in ("0", "-1", "0 mm"):
        assert "mesh.unit: must be above 0" in refused(job, JOB.replace("m.msh", f"m.msh, unit: {unit}"))


@pytest.mark.parametrize("name", ["x" * 300, "\udcff", "nul\0"])
def test_an_output_directory_that_cannot_be_is_refused(
    job: Path, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    loaded = hpcinv.load(job)
    with pytest.raises(OutputError, match=r"cannot be used|not UTF-8"):
        RunDirectory(tmp_path / name).check_free(overwrite=False)
    if name.isalpha():
        with pytest.raises(OutputError, match="cannot be used"):
            choose(None, loaded.model_copy(update={"job": name}))


@pytest.mark.parametrize(
    "code",
    ["raise KeyboardInterrupt", "raise GeneratorExit('away')", "raise SystemExit(0)", "raise BaseException", "1/0"],
)
def test_exceptions_of_a_plugin_are_reported_with_their_line(job: Path, code: str) -> None:
    (job.parent / "plugin.py").write_text(f"import sys\n{code}\n")
    message = refused(job, JOB + "plugins: [plugin.py]")
    assert f"{job}: plugins[0]: '{job.parent / 'plugin.py'}' cannot be imported: " in message
    assert "(line 2)" in message


def test_exceptions_in_the_check_of_a_plugin_law_are_reported_with_their_line(job: Path) -> None:
    (job.parent / "plugin.py").write_text(
        "from typing import ClassVar, Literal\n"
        "from hpcinv.physics.effects.effect import Effect\n"
        "class Wrong(Effect):\n"
        "    example: ClassVar = {'effect': 'raises-key-error'}\n"
        "    effect: Literal['raises-key-error'] = 'raises-key-error'\n"
        "    def model_post_init(self, context):\n"
        "        raise KeyError('missing')\n"
    )
    job.write_text(JOB + "plugins: [plugin.py]\neffects: [{effect: raises-key-error}]")
    command = [sys.executable, "-m", "hpcinv", "validate", str(job)]  # here the effect would be known to later tests
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 2
    text = f"{job}: plugins: a law or effect failed where it was checked: {job.parent / 'plugin.py'}, line 7"
    assert text in done.stderr


def start(*arguments: str | bytes | Path, **options: Any) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "hpcinv", *arguments]
    return subprocess.Popen(command, env=environment(), stderr=subprocess.PIPE, cwd=ROOT, **options)


@pytest.mark.everyday("schema", "formulas")
@pytest.mark.parametrize("command", ["schema", "laws", "formulas"])
def test_a_reader_that_goes_away_ends_the_command_quietly(command: str) -> None:
    read, write = os.pipe()
    os.close(read)
    with start(command, stdout=write) as process:
        os.close(write)
        _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (141, b"")


@pytest.mark.everyday("arguments1")
@pytest.mark.parametrize("arguments", [("schema",), ("--help",), ("explain", "JOB")])
def test_output_to_a_full_disk_causes_no_traceback(arguments: tuple[str, ...], tmp_path: Path) -> None:
    job = write_job(tmp_path / "job.yaml", CUBE)
    words = [str(job) if word == "JOB" else word for word in arguments]
    with Path("/dev/full").open("wb") as full, start(*words, stdout=full) as process:
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    assert errors.endswith(b"standard output: cannot be written: No space left on device\n")
    assert b"Traceback" not in errors


def test_a_run_goes_on_without_its_output(tmp_path: Path) -> None:
    job = write_job(tmp_path / "job.yaml", CUBE, discretisation={"displacement": 1})
    with Path("/dev/full").open("wb") as full, start("run", job, "--output", tmp_path / "out", stdout=full) as process:
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 0
    assert b"standard output: cannot be written: No space left on device; the run goes on" in errors
    assert b"Traceback" not in errors
    assert (tmp_path / "out" / "summary.json").is_file()


def test_closed_output_causes_no_traceback() -> None:
    with start("schema", preexec_fn=lambda: os.close(1)) as process:
        _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, b"")


def test_names_that_are_not_text_are_reported(tmp_path: Path) -> None:
    name = os.fsencode(tmp_path) + b"/\xff.yaml"
    with open(name, "w") as file:  # noqa: PTH123
        file.write(JOB)
    with start("validate", name, "/dev/zero", stdout=subprocess.PIPE) as process:
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert b"\\udcff.yaml: the name of the file is not UTF-8; rename it" in errors
    assert b"/dev/zero: cannot be read: it is a device or a pipe" in errors
    assert b"Traceback" not in errors


def test_an_argument_that_is_not_text_is_refused_before_libraries_fail(tmp_path: Path) -> None:
    with start("compare", b"\xff.stl", "x.stl", stdout=subprocess.PIPE) as process:
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert errors == b"\\udcff.stl: the name of the file is not UTF-8; rename it\n"


def energy(formula: str) -> dict[str, Any]:
    parameters = {"mu": "10 kPa"}
    return {"law": "formula", "energy": formula, "parameters": parameters, "kappa": "1 MPa"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"material": energy("mu*(I1_bar - 3)**1e308")},
            "raises a strain to the power 1e+308, and the largest is 1000",
        ),
        ({"material": energy("mu*(I1_bar - 3)**-1e308")}, "raises a strain to the power -1e+308"),
        ({"material": energy("mu*(I1_bar - 3)**(2**1000)")}, "and the largest is 1000"),
        ({"material": energy("(I1_bar - 3)*mu*2**2**2**2**2**2")}, "no finite value near F = I"),
        ({"regions": {"r": "-" * 900 + "x < 1"}}, "has more than 200 nested operations"),
        ({"regions": {"r": "not " * 240 + "x < 1"}}, "has more than 200 nested operations"),
        ({"regions": {"r": "x < " + "(" * 300 + "1" + ")" * 300}}, "is not a formula"),
        ({"regions": {"r": "x < 1" + "0" * 900}}, "holds a number that is too large"),
        ({"material": {"law": "neo-hookean", "mu": "9" * 5000, "lam": 1}}, "is not a number, with or without a unit"),
        ({"material": {"law": "neo-hookean", "mu": 10**399, "lam": 1}}, "must be finite"),
        ({"solver": {"tolerance": 10**399}}, "must be a number"),
    ],
    ids=lambda text: text if isinstance(text, str) else "",
)
def test_formulas_and_numbers_beyond_all_bounds_are_reported(job: Path, changes: dict[str, Any], message: str) -> None:
    contents = {
        "mesh": {"file": "m.msh"},
        "material": {"law": "neo-hookean", "mu": 1, "lam": 1},
        "supports": [{"region": "a", "fix": ["x", "y", "z"]}],
    }
    with pytest.raises(HpcinvError) as caught:
        hpcinv.job.job.parse(contents | changes, job)
    assert message in str(caught.value)
    assert len(str(caught.value)) < 1200
