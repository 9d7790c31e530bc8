"""hpcinv from Python: jobs made of mappings, changed jobs, and what a result tells of itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.command_line import BLOCK, NO_CERTIFICATE, write_job

import hpcinv
from hpcinv.errors import JobError
from hpcinv.output.run_directory import RunDirectory
from hpcinv.parallel.runtime import MPI

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
    ("changes", "told"),
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
def test_a_change_that_cannot_be_is_told(changes: dict[str, Any], told: str, tmp_path: Path) -> None:
    job = hpcinv.load(write_job(tmp_path / "block.yaml", BLOCK))
    with pytest.raises(JobError, match=told):
        job.with_(changes)


def test_a_result_is_told_in_five_lines(comm: MPI.Intracomm) -> None:
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
