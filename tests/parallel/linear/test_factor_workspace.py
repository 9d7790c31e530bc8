"""Factorizations that fail for lack of workspace or memory: repeated, or ended with the reason."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.output.progress import SilentProgress
from hpcinv.output.result import Result

LITTLE = {"mat_mumps_icntl_14": -70}  # MUMPS begins with 30 % of the workspace that it estimates
LIMIT = {"mat_mumps_icntl_23": 1}  # MB for each rank


def shelf(comm: MPI.Intracomm, progress: SilentProgress | None = None, **solver: Any) -> Result:
    given = job(
        mesh=box((3, 3, 3)),
        material={"law": "mooney-rivlin", "c1": 1000, "c2": 500, "d1": "incompressible"},
        effects=[{"effect": "gravity", "acceleration": [0, -1.0, 0], "density": 600}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        solver=solver,
    )
    return hpcinv.run(given, comm, progress=progress)


@pytest.mark.everyday("direct")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("linear", ["direct", "auto"])
def test_a_workspace_that_is_too_small_is_enlarged(linear: str, comm: MPI.Intracomm) -> None:
    right, little = shelf(comm), shelf(comm, linear=linear, petsc=LITTLE)
    used = little.solutions[0].linear
    assert used is not None
    assert used.configuration == "direct"
    assert used.fallback is None
    assert (
        right.solutions[0].factorizations < little.solutions[0].factorizations <= right.solutions[0].factorizations + 4
    )
    assert np.abs(little.shape - right.shape).max(initial=0.0) < 1e-10


def failed(comm: MPI.Intracomm, message: str, **solver: Any) -> list[dict[str, Any]]:
    """Solves of a shelf that ends with a message."""
    progress = SilentProgress(comm)
    with pytest.raises(SolveError, match=message):
        shelf(comm, progress, linear="direct", **solver)
    (solution,) = progress.statistics["solutions"]
    assert solution["linear"]["configuration"] == "direct"
    assert solution["linear"]["fallback"] is None
    solves: list[dict[str, Any]] = solution["solves"]
    return solves


@pytest.mark.parallel([1, 2])
def test_without_memory_a_named_direct_solver_ends_with_the_reason(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hpcinv.solver.linear.factorization.available", lambda comm: 1e5)
    (solve,) = failed(comm, "there is not enough memory for the factors", petsc=LITTLE)
    assert solve["outcome"] == "NO_MEMORY"


def test_a_limit_of_the_job_is_named(comm: MPI.Intracomm) -> None:
    (solve,) = failed(comm, "more memory than the PETSc options of the job allow", petsc=LIMIT)
    assert solve["outcome"] == "MEMORY_LIMIT"


def test_a_chosen_solver_falls_back_to_multigrid(comm: MPI.Intracomm) -> None:
    used = shelf(comm, petsc=LIMIT).solutions[0].linear
    assert used is not None
    assert used.configuration == "iterative"
    assert used.fallback == "the direct solver ran out of memory: iterative from there on"
