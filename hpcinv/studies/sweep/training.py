"""Training of a reduced basis with the solutions that the cases of a sweep have kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError
from hpcinv.output.checkpoint import Checkpoints, Restart
from hpcinv.output.run_store import problem_fingerprint
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.method import Guess, sign_of
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.sweep.cases import Case
from hpcinv.studies.sweep.reduced_basis import ReducedBasis, TrainingCase
from hpcinv.studies.sweep.results import results
from hpcinv.studies.sweep.shape_spread import kept_file
from hpcinv.studies.sweep.sweep_plan import SweepPlan

_FEWEST = 3
"""Fewest cases of a basis: with fewer no case can be predicted from two others."""


@dataclass(frozen=True)
class Training:
    """Report of a training: number of cases and of modes, and relative errors of cases predicted from all others."""

    cases: int
    modes: int
    errors: Sequence[float]

    def lines(self) -> Iterator[str]:
        """Yield lines for the screen."""
        yield f"{self.cases} cases, {self.modes} modes of the displacement"
        typical, largest = float(np.median(self.errors)), max(self.errors)
        yield f"displacement of a case predicted from all others: error {typical:.2g} (median), {largest:.2g} (largest)"


def train(plan: SweepPlan, path: Path, comm: MPI.Intracomm) -> Training:
    """Write the reduced basis of the converged cases of a sweep; collective.

    Raises:
        JobError: on all ranks, if cases have kept no solution, differ in more than numbers, or are too few.
    """
    kept = on_root(comm, lambda: _kept(plan))
    first = on_root(comm, partial(plan.job, kept[0][0]))
    with Workspace(comm) as workspace:
        body = workspace.body(first)
        equations = workspace.equations(first, body, Timings())
        cases: list[TrainingCase] = []
        for case, directory in kept:
            job = on_root(comm, partial(plan.job, case))
            restart = Checkpoints(directory, comm, problem_fingerprint(job, body), keep=1).latest()
            if restart is None or restart.position.load != 1.0 or len(restart.position.solves) != len(job.plan):
                raise JobError(f"{plan.path}: case {case.number} has kept no whole solution; open it again, and run it")
            cases.append(TrainingCase(case.numbers, list(_solutions(restart, equations))))
        basis = ReducedBasis.from_cases(first, equations, cases)
        basis.write(path, equations, comm)
        return Training(len(cases), basis.mode_count, basis.errors().tolist())


def _solutions(restart: Restart, equations: Sequence[Equations]) -> Iterator[Guess]:
    """Yield the solution of each solve in a checkpoint; collective."""
    for number, step_equations in enumerate(equations):
        start = restart.start(number, step_equations)
        assert start is not None  # all solves have ended
        assert start.solution is not None
        u, p = start.solution
        yield Guess(u.x.array.copy(), None if p is None else p.x.array.copy(), sign_of(start.solves))


def _kept(plan: SweepPlan) -> list[tuple[Case, Path]]:
    """Return the converged cases with the directories of their checkpoints; on rank 0."""
    ledger = plan.ledger
    records = results(plan, ledger)
    groups = {case.reuse_group for case in plan.cases}
    if len(groups) > 1:
        raise JobError(
            f"{plan.path}: its cases differ in mesh, law or structure, not in numbers alone: teach each by a sweep of"
            " its own"
        )
    distinct = {case.key: case for case in plan.cases}
    converged = [case for key, case in distinct.items() if key in records and records[key].converged]
    files = [(case, kept_file(ledger.directory(case.key), "checkpoints")) for case in converged]
    kept = [(case, file) for case, file in files if file is not None]
    if len(kept) < len(files):
        raise JobError(
            f"{plan.path}: {len(files) - len(kept)} of {len(files)} converged cases have kept no solution: add"
            " 'keep_solutions: true' and another 'store', and run the sweep"
        )
    if len(kept) < _FEWEST:
        raise JobError(f"{plan.path}: {len(kept)} cases have converged, and {_FEWEST} or more are needed")
    return kept
