"""What each thing that the cases of a sweep share saves by itself, in one process on one rank.

Some cases of a sweep are solved one after the other in five ways, which take turns case by case:
nothing shared; the mesh and the compiled equations; these and the symbolic factorization; nothing but the guess from
the neighbours' solutions; everything. Kernels are in DOLFINx's cache, and the start of the process is not counted.

Command: python benchmarks/sweep_shares.py [--sweep FILE] [--cases 48]
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

from hpcinv.base.parallel.runtime import MPI
from hpcinv.driver import run
from hpcinv.job.job import Job
from hpcinv.mesh.body import Body
from hpcinv.mesh.cell_count import no_report
from hpcinv.output.result import Result
from hpcinv.solver.methods.method import Guess
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.sweep.cases import Case
from hpcinv.studies.sweep.neighbours import Neighbour, Neighbours, ParameterSpace
from hpcinv.studies.sweep.sweep_plan import load_sweep

ROOT = Path(__file__).parents[1]
COMM = MPI.COMM_WORLD


class WithoutFactors(Workspace):
    """Forgets the symbolic factorization between runs."""

    def body(self, job: Job, report: Callable[[str], None] = no_report) -> Body:
        for model in self._equations.values():
            for equilibrium in model._idle.values():
                equilibrium.linear.forget_factors()
        return super().body(job, report)


class Shared:
    """One way to run case after case."""

    def __init__(self, workspace: Workspace | None, *, guesses: bool) -> None:
        self.workspace, self.guesses = workspace, guesses
        self.seconds, self.factorizations, self.iterations = 0.0, 0, 0
        self._neighbours = Neighbours()

    def begin_reuse_group(self) -> None:
        self._neighbours = Neighbours()

    def run(self, job: Job, case: Case, space: ParameterSpace) -> Result:
        begun = time.perf_counter()
        point = space.point(case.numbers)
        neighbour_guess = self._neighbours.guess(point) if self.guesses else None
        result = run(job, COMM, workspace=self.workspace, guesses=[neighbour_guess[0]] if neighbour_guess else [])
        solution = result.solutions[0]
        if self.guesses:
            pressure = None if solution.pressure is None else solution.pressure.x.array.copy()
            guess = Guess(solution.displacement.x.array.copy(), pressure, solution.solves[-1].signs[-1])
            neighbour = Neighbour(case.key, point, guess)
            self._neighbours.add(neighbour, neighbour.bytes)
        self.seconds += time.perf_counter() - begun
        self.factorizations += solution.factorizations
        self.iterations += sum(len(solve.iterations) for solve in solution.solves)
        return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sweep", type=Path, default=ROOT / "jobs" / "sweep-beam-laws.yaml")
    parser.add_argument("--cases", type=int, default=48, help="cases, as many of each reuse group")
    options = parser.parse_args()
    plan = load_sweep(options.sweep)
    grouped: defaultdict[str, list[Case]] = defaultdict(list)
    for case in plan.cases:
        grouped[case.reuse_group].append(case)

    ways: dict[str, Callable[[], Shared]] = {
        "nothing shared": lambda: Shared(None, guesses=False),
        "mesh and equations": lambda: Shared(WithoutFactors(COMM), guesses=False),
        "and symbolic factorization": lambda: Shared(Workspace(COMM), guesses=False),
        "guesses alone": lambda: Shared(None, guesses=True),
        "everything": lambda: Shared(Workspace(COMM), guesses=True),
    }
    shared = {name: make() for name, make in ways.items()}
    count = 0
    for cases in grouped.values():
        space = ParameterSpace([case.numbers for case in cases])
        run(plan.job(cases[0]), COMM)  # compiles
        for way in shared.values():
            way.begin_reuse_group()
        for case in cases[: options.cases // len(grouped)]:
            job, count = plan.job(case), count + 1
            for way in shared.values():
                way.run(job, case, space)

    for way in shared.values():
        if way.workspace is not None:
            way.workspace.clear()
    print(f"{count} cases of {plan.path.name} on 1 rank; per case")
    print(f"  {'':28} seconds  share saved  factorizations  iterations")
    base = shared["nothing shared"].seconds
    for name, way in shared.items():
        print(
            f"  {name:28} {way.seconds / count:7.3f}  {100 * (1 - way.seconds / base):9.0f} %"
            f"  {way.factorizations / count:14.1f}  {way.iterations / count:10.1f}"
        )


if __name__ == "__main__":
    main()
