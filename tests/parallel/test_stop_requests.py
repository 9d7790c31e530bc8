"""Requests to stop at any place where a run asks for them: what is solved is saved, and a resumed run ends alike."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import Interrupted
from hpcinv.job.job import Job
from hpcinv.output.result import Result
from hpcinv.solver.methods import nested_iteration
from hpcinv.trust.discretisation import two_level
from hpcinv.trust.stability.forward_factors import ForwardFactors


class StopAt:
    """Asks to stop from a certain call on, on one rank; counts the calls."""

    def __init__(self, comm: MPI.Intracomm, at: int) -> None:
        self.calls, self._at, self._here = 0, at, comm.rank == comm.size - 1

    def __call__(self) -> bool:
        self.calls += 1
        return self._here and self.calls >= self._at


def standing(**changes: Any) -> Job:
    return job(
        mesh=box((2, 2, 2)) | {"geometry_degree": 2},
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 500}],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
        checkpoint={"every": 100},
        certificate={},
        **changes,
    )


def lines(result: Result) -> list[tuple[str, str]]:
    return [(line.name, line.verdict.value) for line in result.certificate.lines]


def efforts(result: Result) -> list[tuple[int, int]]:
    return [(len(solve.iterations), solve.factorizations) for solve in result.solutions[0].solves]


@pytest.mark.everyday("with factors")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("factors", [True, False], ids=["with factors", "without factors"])
def test_a_run_stops_wherever_it_asks_and_goes_on_from_there(
    factors: bool, comm: MPI.Intracomm, run_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each check is one of a large body: iterations instead of factorizations."""
    monkeypatch.setattr(two_level, "MANY", 0.0)
    if not factors:
        monkeypatch.setattr(ForwardFactors, "affordable", False)
    never = StopAt(comm, 10**9)
    whole = hpcinv.run(standing(), comm, directory=run_directory / "whole", stop_asked=never)
    solves = sum(len(solve.iterations) for solve in whole.solutions[0].solves)
    print(f"{never.calls} requests, {solves} Newton iterations")
    assert never.calls > solves + len(whole.certificate.lines) + 10  # within checks, too
    for at in range(1, never.calls + 1, 37):
        path = run_directory / f"at-{at}"
        with pytest.raises(Interrupted) as stopped:
            hpcinv.run(standing(), comm, directory=path, stop_asked=StopAt(comm, at))
        if "in the certificate" not in stopped.value.message:
            continue
        assert json.loads((path / "summary.json").read_text())["status"] == "stopped by a signal"
        after = StopAt(comm, 10**9)
        resumed = hpcinv.run(standing(), comm, directory=path, resume=True, stop_asked=after)
        assert after.calls < never.calls - solves
        assert efforts(resumed) == efforts(whole)
        assert lines(resumed) == lines(whole)


@pytest.mark.parallel(2)
def test_a_run_stops_before_it_solves(
    comm: MPI.Intracomm, run_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After reading, after making the model, and before the solve or a mesh of coarser cells for it."""

    def solve(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(nested_iteration, "solve_direction", solve)
    texts = []
    for at in range(1, 4):
        with pytest.raises(Interrupted) as stopped:
            hpcinv.run(standing(), comm, directory=run_directory / f"{at}", stop_asked=StopAt(comm, at))
        texts.append(stopped.value.message)
    nothing = "stopped by a signal before there was anything to save"
    early = "stopped by a signal in the inverse solve at load factor 0; there was no state to save yet"
    assert texts == [nothing, nothing, early]


@pytest.mark.release
@pytest.mark.parallel(2)
def test_a_run_that_cannot_be_resumed_finishes_its_certificate(comm: MPI.Intracomm) -> None:
    never = StopAt(comm, 10**9)
    whole = hpcinv.run(standing(), comm, stop_asked=never)
    late = StopAt(comm, never.calls)  # after the last solve
    assert lines(hpcinv.run(standing(), comm, stop_asked=late)) == lines(whole)
