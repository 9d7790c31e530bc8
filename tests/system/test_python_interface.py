"""hpcinv from Python: jobs made of mappings, changed jobs, and what a result shows of itself."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.command_line import BLOCK, NO_CERTIFICATE, write_job

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.files.atomic import replace
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.output.run_directory import RunDirectory
from hpcinv.output.surfaces.picture import Picture

DENSITY = "effects[0].density"


def test_a_mapping_is_a_job_as_its_file_is(tmp_path: Path) -> None:
    from_file = hpcinv.load(write_job(tmp_path / "block.yaml", BLOCK))
    made = hpcinv.load({"job": "block", **BLOCK})
    assert made.model_dump() == from_file.model_dump()
    assert made.data["effects"] == BLOCK["effects"]


def test_relative_paths_of_a_mapping_begin_in_a_directory(tmp_path: Path) -> None:
    (tmp_path / "box.py").write_text(Path(BLOCK["mesh"]["file"]).read_text())
    mesh = BLOCK["mesh"] | {"file": "box.py"}
    job = hpcinv.load(BLOCK | {"mesh": mesh}, directory=tmp_path)
    assert job.resolve(job.mesh.file) == tmp_path / "box.py"
    with pytest.raises(JobError, match=r"\(mapping\): mesh\.file: there is no file"):
        hpcinv.load(BLOCK | {"mesh": mesh})


def test_a_changed_job_is_a_new_one(tmp_path: Path) -> None:
    job = hpcinv.load(write_job(tmp_path / "block.yaml", BLOCK))
    heavier = job.with_(
        {DENSITY: "250 kg/m^3", "solver.tolerance": 1e-8, "material": {**BLOCK["material"], "mu": "20 kPa"}}
    )
    assert (job.effects[0].density, heavier.effects[0].density) == (200.0, 250.0)  # type: ignore[attr-defined]
    assert heavier.solver.tolerance == 1e-8
    assert heavier.path == job.path
    back = heavier.with_({DENSITY: 200, "solver": {}, "material": BLOCK["material"]})
    assert back.model_dump() == job.model_dump()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"effects[3].density": 1},
            r"block\.yaml: cannot set effects\[3\]\.density: \[3\] is not an entry of a list of 1",
        ),
        ({"effects[].density": 1}, r"block\.yaml: "),
        ({DENSITY: "1 m"}, r"block\.yaml: effects\[0\]\.density: must be a density"),
        ({"x y": 1}, r"block\.yaml: .*is not a key"),
    ],
)
def test_a_change_that_cannot_be_is_reported(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    job = hpcinv.load(write_job(tmp_path / "block.yaml", BLOCK))
    with pytest.raises(JobError, match=message):
        job.with_(changes)


def test_a_result_is_reported_in_five_lines(comm: MPI.Intracomm) -> None:
    job = hpcinv.load({"job": "block", **BLOCK, "certificate": NO_CERTIFICATE})
    result = hpcinv.run(job, comm)
    lines = repr(result).splitlines()
    assert len(lines) == 5
    assert lines[0] == "Result of 'block': inverse analysis, converged"
    assert "48 cells, 375 unknowns; largest displacement " in lines[1]
    assert lines[2] == "  certificate: pass"
    assert lines[3].startswith("  quantities: top = -0.0")
    assert lines[4] == "  directory: none, nothing was written"


def test_a_result_is_plain_data(comm: MPI.Intracomm) -> None:
    result = hpcinv.run(hpcinv.load(BLOCK), comm)
    data = result.to_dict()
    assert json.loads(json.dumps(data)) == data
    assert data["quantities"] == result.quantities
    assert data["solutions"][0]["largest_displacement"] == pytest.approx(result.solutions[0].largest_displacement)
    data["quantities"].clear()
    assert result.to_dict()["quantities"] == result.quantities


@pytest.mark.release
@pytest.mark.parametrize("changed", [False, True])
def test_the_directory_of_a_run_has_the_job_that_was_run(
    changed: bool, run_directory: Path, comm: MPI.Intracomm
) -> None:
    """Not the file that it was read from before it was changed."""
    job = hpcinv.load(BLOCK)
    if changed:
        job = hpcinv.load(write_job(run_directory / "block.yaml", BLOCK)).with_({DENSITY: np.float64(100)})
    hpcinv.run(job, comm, directory=run_directory / "out")
    kept = yaml.safe_load((run_directory / "out" / "job.yaml").read_text())
    assert RunDirectory(run_directory / "out").job(None).model_dump() == job.model_dump()
    assert kept["effects"][0]["density"] == (100 if changed else 200)


def test_a_job_may_be_given_by_its_file_and_a_directory_as_text(
    tmp_path: Path, comm: MPI.Intracomm, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_job(tmp_path / "block.yaml", BLOCK)
    result = hpcinv.run(str(file), comm, directory=str(tmp_path / "out"))
    assert (tmp_path / "out" / "summary.json").is_file()
    assert "certificate" in capsys.readouterr().out
    again = hpcinv.run(BLOCK, comm, progress=False)
    assert capsys.readouterr().out == ""
    assert again.quantities == pytest.approx(result.quantities)
    for given in (5, None, ["a.yaml"]):
        with pytest.raises(JobError, match="a job is a path of a file or a mapping with the content of one, not"):
            hpcinv.load(given)  # type: ignore[arg-type]
        with pytest.raises(JobError, match="a job is a path of a file or a mapping with the content of one, not"):
            hpcinv.run(given, comm)  # type: ignore[arg-type]
    with pytest.raises(JobError, match="directory: must be a path, not 5"):
        hpcinv.run(BLOCK, comm, directory=5)  # type: ignore[arg-type]


def test_quantities_have_units_and_pictures_are_reported_in_one_line(comm: MPI.Intracomm) -> None:
    quantities = [
        {"name": "top", "of": "uz", "at": [0.5, 0.5, 1]},
        {"name": "force", "of": "reaction", "region": "z0"},
        {"name": "volume", "of": "1", "on": "block", "reduce": "integral", "over": "current"},
        {"name": "area", "of": "1", "on": "z1", "reduce": "integral", "over": "current"},
        {"name": "ratio", "of": "J", "on": "block", "reduce": "mean"},
    ]
    result = hpcinv.run(BLOCK | {"quantities": quantities}, comm, progress=False)
    values: Any = result.quantities
    assert values.units == {"top": "m", "force": "N", "volume": "m^3", "area": "m^2"}
    assert values.shown("volume") == "1 m^3"
    assert values.shown("area") == "1 m^2"
    assert "'volume': 1 m^3" in repr(values)
    assert "top = -0.0" in repr(result)
    assert " m, force = [" in repr(result)
    assert len(repr(Picture(bytes(100_000)))) < 100


@pytest.mark.parametrize("key", [True, "true", "True"])
def test_a_key_that_yaml_1_1_has_made_of_on_is_reported(key: Any) -> None:
    quantity = {"name": "area", "of": "1", "reduce": "integral", "over": "current"}
    given = BLOCK | {"quantities": [quantity | {key: "z1"}]}
    with pytest.raises(JobError, match=r"quantities\[0\]\.[Tt]rue: is what programs for YAML 1.1 make of the key 'on'"):
        hpcinv.load(given)
    with pytest.raises(JobError, match=r"region: is the same key as 'on'"):
        hpcinv.load(BLOCK | {"quantities": [quantity | {"on": "z1", "region": "z1"}]})


@pytest.mark.parametrize(
    ("stem", "name"), [("a job", "a-job"), ("Käse & Brot", "Kase-Brot"), (".hidden", "hidden"), ("日本", "job")]
)
def test_the_name_of_results_follows_from_any_name_of_a_file(stem: str, name: str, tmp_path: Path) -> None:
    assert hpcinv.load(write_job(tmp_path / f"{stem}.yaml", BLOCK)).job == name
    with pytest.raises(JobError, match="job: 'a job' is not allowed"):
        hpcinv.load(BLOCK | {"job": "a job"})


def test_a_pipe_is_written_to_and_stays_one(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with os.fdopen(os.open(pipe, os.O_RDWR), "rb", buffering=0) as reader:
        replace(pipe, b"figures")
        assert reader.read(7) == b"figures"
    assert pipe.is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


def test_a_mould_does_not_replace_its_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--to", str(tmp_path / "part.stl"), "--mould", str(tmp_path / "." / "part.stl")]
    assert main(["export", str(tmp_path), *words]) == 2
    assert "is the file of the part (--to)" in capsys.readouterr().err
