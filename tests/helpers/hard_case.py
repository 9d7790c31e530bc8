"""What the hard cases share: their jobs with sections replaced, run to the end, every number of the summary finite."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import hpcinv
from helpers.command_line import NO_CERTIFICATE
from helpers.silicone_beam import SIZE
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import HpcinvError
from hpcinv.job.job import Job, parse
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.output.result import Result

JOBS = Path(__file__).parents[2] / "jobs" / "hard"
FINE: dict[str, Any] = {
    "mesh": {"file": "../../meshes/pdms_beam.py", "parameters": {"size": "4 mm"}, "geometry_degree": 2}
}
"""The cells of the beams in these jobs."""


def job(name: str, **changes: Any) -> Job:
    """A job of ``jobs/hard`` with larger cells and some sections replaced, and without a costly certificate."""
    path = JOBS / f"{name}.yaml"
    data = dict(read_yaml(path))
    if data["mesh"] == FINE["mesh"]:
        data["mesh"] = data["mesh"] | {"parameters": {"size": SIZE}}
    return parse({**data, "certificate": NO_CERTIFICATE} | changes, path)


def solve(name: str, comm: MPI.Intracomm, **changes: Any) -> Result:
    """Run a job that must succeed."""
    result = hpcinv.run(job(name, **changes), comm)
    assert result.statistics["status"] == "converged"
    require_finite(result.statistics)
    return result


def fail(name: str, comm: MPI.Intracomm, directory: Path, **changes: Any) -> tuple[int, str]:
    """Run a job that must not; its exit code and its last words. Its summary, if it has one, must be finite too."""
    code, text = 0, ""
    try:
        hpcinv.run(job(name, **changes), comm, directory=directory / "results")
    except HpcinvError as error:
        code, text = error.exit_code, str(error)
    summary = directory / "results" / "summary.json"
    if summary.exists():
        require_finite(json.loads(summary.read_text(), parse_constant=_refuse))
    return code, text


def effort(result: Result) -> list[tuple[int, int]]:
    """Newton iterations and factorizations of each solution."""
    return [(solution["newton_iterations"], solution["factorizations"]) for solution in result.statistics["solutions"]]


def require_finite(statistics: Mapping[str, Any]) -> None:
    """What was not finite is ``None`` in a summary: there must be none where a number belongs."""
    for part in ("solutions", "quantities", "errors", "mesh", "timings", "peak_memory"):
        assert not _missing(statistics[part], part)
    for line in statistics.get("certificate", {}).get("lines", []):
        assert line["value"] is not None or line["verdict"] != "pass", line


# Without a meaning for some methods and formulations.
_OPTIONAL = ("position_residual", "bifurcation", "pressure", "fallback")


def _missing(value: Any, where: str) -> list[str]:
    if isinstance(value, Mapping):
        return [m for key, v in value.items() if key not in _OPTIONAL for m in _missing(v, f"{where}.{key}")]
    if isinstance(value, list):
        return [m for i, v in enumerate(value) for m in _missing(v, f"{where}[{i}]")]
    return [where] if value is None else []


def _refuse(constant: str) -> None:
    raise AssertionError(f"{constant} in a summary")
