"""``hpcinv identify`` as it is typed: its report, a kill and the same command again, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.command_line import NO_CERTIFICATE, ROOT, Started, hpcinv_here, write_job

UP, DOWN = ({"effect": "gravity", "acceleration": [0, 0, g], "density": 150} for g in (9.81, -9.81))
JOB: dict[str, Any] = {
    "mesh": {
        "file": str(ROOT / "meshes" / "box.py"),
        "parameters": {"nx": 1, "ny": 1, "nz": 1},
        "geometry_degree": 2,
    },
    "material": {"law": "neo-hookean", "mu": "20 kPa", "lam": "40 kPa"},
    "discretisation": {"displacement": 2, "formulation": "displacement"},
    "certificate": NO_CERTIFICATE,
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "states": [
        {"name": "standing", "given": True, "effects": [DOWN]},
        {"name": "hanging", "effects": [UP]},
    ],
    "quantities": [{"name": "top", "of": "uz", "at": [0.5, 0.5, 1]}],
    "identify": {
        "parameters": {"material.mu": {"bounds": ["1 kPa", None]}},
        "observations": [{"name": "height", "quantity": "top-hanging", "value": "30 mm", "sd": "0.5 mm"}],
    },
}


@pytest.fixture
def job(tmp_path: Path) -> Path:
    return write_job(tmp_path / "job.yaml", JOB)


def test_a_killed_identification_goes_on_when_it_is_started_again(job: Path, tmp_path: Path) -> None:
    with Started(1, "identify", job, cwd=tmp_path) as run:
        run.wait_for("evaluation 2: ")
        run.kill()
    out = tmp_path / "results" / "job-identified"
    evaluated = sorted((out / "evaluations").glob("*.npz"))
    assert len(evaluated) >= 2
    assert not (out / "identification.json").exists()
    evaluated[0].write_bytes(evaluated[0].read_bytes()[:100])  # as a full disk might leave it

    ended = hpcinv_here("identify", job, cwd=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.count("(kept): material.mu") == len(evaluated) - 1
    assert "  determined: material.mu to " in ended.stdout
    assert "1 numbers, root mean square" in ended.stdout
    figures = json.loads((out / "identification.json").read_text())
    (mu,) = figures["parameters"]
    assert figures["chi_squared"] < 1e-6
    assert figures["cost"]["kept"] == len(evaluated) - 1
    sections = yaml.safe_load((out / "sections.yaml").read_text())
    assert sections["material"]["law"] == "neo-hookean"
    assert float(sections["sensitivities"]["material.mu"].split()[0]) == pytest.approx(
        mu["standard_deviation"] / 1e3, rel=1e-3
    )
    summary = json.loads((out / "run" / "summary.json").read_text())
    assert summary["quantities"]["top-hanging"] == pytest.approx(0.03, abs=1e-8)
    assert (out / "run" / "shape-rest.msh").exists()

    again = hpcinv_here("identify", job, "-q", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert again.stdout.startswith("estimate:\n  material.mu = ")
    assert f"({figures['cost']['evaluations']} of them made before)" in again.stdout

    other = write_job(tmp_path / "job.yaml", JOB, material=JOB["material"] | {"lam": "41 kPa"})
    refused = hpcinv_here("identify", other, cwd=tmp_path)
    assert refused.returncode == 2
    assert "holds the identification of another job, or of this one before it was changed" in refused.stderr


def test_a_job_without_the_section_is_refused(tmp_path: Path) -> None:
    plain = write_job(tmp_path / "plain.yaml", {key: value for key, value in JOB.items() if key != "identify"})
    ended = hpcinv_here("identify", plain, cwd=tmp_path)
    assert ended.returncode == 2
    assert ended.stderr == f"{plain}: has no section 'identify', which names parameters and observations\n"
    assert not (tmp_path / "results").exists()
