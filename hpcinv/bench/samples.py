"""What a solve of the block takes on so many ranks, from the run's summary and PETSc's log of it.

Counts hold on any machine, also where ranks share cores; seconds are only taken from runs on one rank.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hpcinv.bench.bodies import WITHOUT_CERTIFICATE, block

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hpcinv.bench.bench import Bench
    from hpcinv.bench.bodies import JobData
    from hpcinv.bench.runs import Run

_REDUCTIONS = ("VecDot", "VecMDot", "VecNorm", "VecTDot", "VecReduceComm")  # each is one, which PETSc does not count
_OF_KRYLOV = 2  # reductions in an iteration of FGMRES: all inner products at once, and a norm


@dataclass(frozen=True)
class Sample:
    """Means over the ranks of one run; of an ``iteration`` of the linear solver, of a ``setup`` of its preconditioner.

    Attributes:
        newton, iterations, setups: iterations of Newton's method and of the linear solver, and preconditioners.
        seconds: by phase, of the rank that took longest.
        memory: bytes of the fullest rank.
    """

    unknowns: int
    ranks: int
    newton: int
    iterations: int
    setups: int
    messages_per_iteration: float
    bytes_per_iteration: float
    messages_per_setup: float
    bytes_per_setup: float
    reductions_per_setup: float
    seconds: Mapping[str, float]
    memory: float

    reductions_per_iteration = _OF_KRYLOV

    @property
    def unknowns_per_rank(self) -> float:
        return self.unknowns / self.ranks


def job(size: int, preset: str) -> JobData:
    """The block's inverse analysis without what it does not need."""
    return block(size, certificate=WITHOUT_CERTIFICATE, solver={"linear": preset})


def take(bench: Bench, size: int, ranks: int, preset: str = "iterative") -> Sample:
    """Run and count."""
    name = f"block, about {size} unknowns, {preset}, {ranks} rank{'s' if ranks > 1 else ''}"
    return sample(bench.must_run(name, job(size, preset), ranks, log=True), ranks)


def sample(run: Run, ranks: int) -> Sample:
    """What a run's log has."""
    iterations, setups = run.krylov_iterations, run.factorizations
    reductions = sum(_mean(run.events.get(event, ()), "count") for event in _REDUCTIONS)
    solve, setup = run.events.get("KSPSolve", ()), run.events.get("PCSetUp", ())
    return Sample(
        unknowns=run.unknowns,
        ranks=ranks,
        newton=run.newton_iterations,
        iterations=iterations,
        setups=setups,
        messages_per_iteration=_mean(solve, "messages") / max(iterations, 1),
        bytes_per_iteration=_mean(solve, "bytes") / max(iterations, 1),
        messages_per_setup=_mean(setup, "messages") / setups,
        bytes_per_setup=_mean(setup, "bytes") / setups,
        reductions_per_setup=(_mean(setup, "reductions") + reductions - _OF_KRYLOV * iterations) / setups,
        seconds=run.phases,
        memory=run.fullest_rank,
    )


def _mean(ranks: Sequence[Mapping[str, float]], figure: str) -> float:
    return sum(rank[figure] for rank in ranks) / len(ranks) if ranks else 0.0
