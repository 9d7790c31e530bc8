"""Continuation by load steps, by power series and by default, on bodies from publications.

Jobs are solved by ``solver: {continuation: steps}``, ``series`` and ``auto``, with factors and without nested iteration
and certificate. Of each the table has factorizations, failed solves in brackets, and processor seconds of set-up and
solution in a warm process, on this rank. Where the full load is not reached, the load factor stands first; "refused"
is a job that the program does not solve in this way. The last two columns are the seconds of ``auto`` over the seconds
of ``steps``, and the largest difference of their displacements, relative to the largest. Scenes of SANM are solved if
``HPCINV_SCENES`` names their folder (`benchmarks/published/sanm`).

Command: mpirun -n 1 python benchmarks/continuation.py [jobs …]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from bodies import beam, block, sphere

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import HpcinvError
from hpcinv.job.job import Job, parse
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import DirectMethod
from hpcinv.solver.newton import Solve

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "published"
PUBLISHED = (
    *("cook/cook", "cook/cook-incompressible", "land/problem-1", "land/problem-2", "land/problem-3"),
    *("elastica/elastica", "bisshopp/cantilever", "balloon/balloon", "calculix/beamnld", "code-aster/ssnv122"),
    *("sze/roof", "sze/shear"),
)
EULER = "euler/column.yaml"
CLAMPED = [{"region": "x0", "fix": ["x"]}, {"region": "x1", "fix": ["x", "y", "z"]}, {"region": "y0", "fix": ["y"]}]
SELF_WEIGHT = {"effect": "gravity", "acceleration": [0, 0, "0.3 m/s^2"], "density": "1000 kg/m^3"}
ARCH = {
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "30 kPa"},
    "effects": [SELF_WEIGHT],
    "mesh.parameters": {"radius": "1 m", "angle": 0.45, "width": "4 cm", "ny": 1},
    "mesh.shell": {"thickness": "2 cm"},
    "supports": CLAMPED,
    "regions": {},
    "let": {},
    "quantities": [{"name": "crown", "of": "uz", "at": [0, 0, 0]}],
}
ROOF = {"mesh.shell": {"thickness": "6.35 mm"}, "let.force": "3 kN*share/4/(6.35 mm*2.54 m*cell)"}
ARC_LENGTH = {"solver": {"strategy": "arc-length", "limit_points": 2}}
CHANGED: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("shallow arch", "sze/roof.yaml", ARCH),
    ("roof, full load", "sze/roof.yaml", {"let.share": 1.0}),
    ("roof of 6.35 mm", "sze/roof.yaml", ROOF),
    ("the same by arc length", "sze/roof.yaml", ROOF | ARC_LENGTH),
    ("slit ring, 2 × 24 cells", "sze/slit.yaml", {"mesh.parameters": {"across": 2, "around": 24}}),
    ("balloon, 1.34 × its largest pressure", "balloon/balloon.yaml", {"effects[0].pressure": "12 kPa"}),
    ("balloon, volume beyond that", "balloon/filled-beyond.yaml", {}),
    ("column, 1.2 × Euler", EULER, {"let.multiple": 1.2}),
    ("column, 300 × Euler", EULER, {"let.multiple": 300}),
)
"""Jobs with changes: name, file, and what is changed."""
SAGGING = [{"effect": "gravity", "acceleration": [-200, 0, -100], "density": 963}]
COMPRESSIBLE = {"law": "neo-hookean", "mu": "250 kPa", "lam": "1 MPa"}
LARGER: dict[str, Mapping[str, Any]] = {
    "block": block(15_000, effects=SAGGING),
    "compressible block": block(15_000, effects=SAGGING, material=COMPRESSIBLE),
    "sphere": sphere(15_000),
    "compressible beam": beam(15_000, material=COMPRESSIBLE),
}
"""Bodies of more than 10,000 unknowns that set no threshold of ``auto``."""
SETTINGS = {"linear": "direct", "nested_iteration": "off"}
REFUSED = "Outcome    exit code 2"
"""In the heads of jobs that are wrong by intention."""
STRATEGY = ("strategy", "limit_points")
"""Settings of jobs that ask for another continuation."""
CONTINUATIONS = ("steps", "series", "auto")


@dataclass(frozen=True)
class TimedSolves:
    """Solves of a job, the displacement at their end on this rank, and the processor seconds that they took there."""

    solves: Sequence[Solve]
    displacement: npt.NDArray[np.float64]
    seconds: float

    @property
    def load(self) -> float:
        return max((solve.load for solve in self.solves if solve.outcome.accepted), default=0.0)

    def __str__(self) -> str:
        factorizations = sum(solve.factorizations for solve in self.solves)
        failed = sum(not solve.outcome.accepted for solve in self.solves)
        end = "" if self.load == 1.0 else f"load {self.load:.6g}: "
        return f"{end}{factorizations} ({failed}), {self.seconds:.2f} s"


def jobs() -> Iterator[tuple[str, Job]]:
    """Jobs with their names in the table."""
    scenes = os.environ.get("HPCINV_SCENES")
    for path in sorted(Path(scenes).glob("*.yaml")) if scenes else ():
        yield path.stem, hpcinv.load(path)
    for name in ("pdms-beam-forward", "pdms-beam"):
        beam = hpcinv.load(ROOT / "jobs" / f"{name}.yaml")
        gravity = [f"{4 * float(str(g).split()[0])} m/s^2" for g in beam.data["effects"][0]["acceleration"]]
        yield name, beam
        yield f"{name}, weight ×4", beam.with_({"effects[0].acceleration": gravity})
    for name in PUBLISHED:
        yield Path(name).stem, by_load(hpcinv.load(RESULTS / f"{name}.yaml"))
    for name, file, changes in CHANGED:
        yield name, hpcinv.load(RESULTS / file).with_(changes)
    for name, data in LARGER.items():
        for analysis in ("forward", "inverse"):
            yield f"{name}, {analysis}", parse({**data, "analysis": analysis}, ROOT / "benchmarks" / "bodies.yaml")
    for path in sorted((ROOT / "jobs" / "hard").glob("*.yaml")):
        if REFUSED not in path.read_text(encoding="utf-8"):
            yield path.stem, by_load(hpcinv.load(path))


def by_load(job: Job) -> Job:
    """Return the job without the settings that ask for another continuation."""
    solver = job.data.get("solver", {})
    return job.with_({"solver": {key: value for key, value in solver.items() if key not in STRATEGY}})


def attempted(job: Job, continuation: str, comm: MPI.Intracomm) -> TimedSolves | None:
    """Return the run, ``None`` where the program refuses the job."""
    try:
        return solved(job, continuation, comm)
    except HpcinvError:
        return None


def solved(job: Job, continuation: str, comm: MPI.Intracomm) -> TimedSolves:
    solver = job.data.get("solver", {}) | SETTINGS
    if continuation != "steps" or "strategy" not in solver:
        solver["continuation"] = continuation
    job = job.with_({"solver": solver})
    begin = time.process_time()
    equations = Equations(job, build_body(job.mesh, job.regions, comm, resolve=job.resolve), Timings())
    method = DirectMethod(equations, job.directions[0])
    solves = list(method.solves())
    method.equilibrium.destroy()
    return TimedSolves(solves, equations.unknowns.displacement().x.array.copy(), time.process_time() - begin)


def ratio(steps: TimedSolves | None, other: TimedSolves | None) -> str:
    return "" if steps is None or other is None else f"{other.seconds / steps.seconds:.2f}"


def difference(steps: TimedSolves | None, other: TimedSolves | None) -> str:
    if steps is None or other is None or not steps.load == other.load == 1.0:
        return ""
    u, v = steps.displacement, other.displacement
    return f"{np.abs(u - v).max() / (np.abs(u).max() or 1.0):.0e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="names in the table, or files of jobs; left out, all")
    names = parser.parse_args().names
    files = [(Path(name).stem, by_load(hpcinv.load(Path(name)))) for name in names if name.endswith(".yaml")]
    chosen = files or [entry for entry in jobs() if not names or entry[0] in names]
    comm = MPI.COMM_WORLD
    say(comm, "| job | load steps | power series | auto | auto ÷ steps | difference |")
    say(comm, "|---|---|---|---|---|---|")
    for name, job in chosen:
        attempted(job, "auto", comm)  # loads kernels
        runs = steps, _, auto = [attempted(job, continuation, comm) for continuation in CONTINUATIONS]
        columns = " | ".join("refused" if run is None else str(run) for run in runs)
        say(comm, f"| {name} | {columns} | {ratio(steps, auto)} | {difference(steps, auto)} |")


def say(comm: MPI.Intracomm, line: str) -> None:
    if comm.rank == 0:
        print(line, flush=True)


if __name__ == "__main__":
    main()
