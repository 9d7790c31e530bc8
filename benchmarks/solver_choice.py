"""Does `auto` take the faster linear solver? Bodies of many shapes, each solved directly, iteratively and by `auto`.

Seconds are processor time of the whole solve, from the first assembly to the solution, analysis and set-up included. A
solver that takes more than `LIMIT` times as long as the direct one is stopped ("inf"). Every second body is
held out: constants of the cost model were fitted to the others at most. Reasons of `auto` are printed to stderr.
On several ranks, each phase counts the seconds of its slowest rank, which include busy waiting.

Where factors do not fit into the memory, the column of the direct solver is their size by MUMPS's analysis. Bodies
of 0.5 to 1 million unknowns are solved if they are named.

Command: mpirun -n RANKS python benchmarks/solver_choice.py [names …] [--jobs JOB …]
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from bench_runs import WITHOUT_CERTIFICATE, JobData
from bodies import beam, block, sphere

import hpcinv
import hpcinv.base.parallel.timings
from hpcinv.base.parallel.left_for_run import available
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import SOLVER, Timings
from hpcinv.errors import HpcinvError
from hpcinv.job.job import parse
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations
from hpcinv.solver.workspace import Workspace

ROOT = Path(__file__).parents[1]
LIMIT = 4.0  # more takes longer; less hides how wrong a choice would be
SHORT = 0.7  # s of a direct solve; shorter ones are measured three times, since differences are noise
_LIMIT_MEMORY = "mat_mumps_icntl_23"  # MB of a rank
SOFT, STIFF, CLOSE = 0.3, 0.45, 0.49  # Poisson's ratios


def body(mesh: str, load_case: JobData, poisson: float | str, degree: int = 2, **parameters: float | str) -> JobData:
    """Return a job on a mesh of `meshes` or of this directory; ``poisson`` may be "incompressible"."""
    folder = "benchmarks" if mesh == "voxel_body" else "meshes"
    law: JobData = {"law": "neo-hookean", "young": "10 kPa", "poisson": poisson}
    if poisson == "incompressible":
        law = {"law": "isochoric-neo-hookean", "mu": "3.33 kPa", "kappa": "incompressible"}
    return {
        "mesh": {"file": str(ROOT / folder / f"{mesh}.py"), "parameters": parameters},
        "material": law,
        "discretisation": {"displacement": degree},
        **load_case,
    }


def hanging(region: str, acceleration: float) -> JobData:
    """Weight along -z of a body that is fixed on a region of its boundary."""
    effect = {"effect": "gravity", "acceleration": [0, 0, -acceleration], "density": 1000}
    return {"effects": [effect], "supports": [{"region": region, "fix": ["x", "y", "z"]}]}


def inflated(pressure: str) -> JobData:
    """Inner pressure of an octant or a quarter of a hollow body."""
    supports = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    return {"effects": [{"effect": "pressure", "region": "inner", "pressure": pressure}], "supports": supports}


def bodies() -> dict[str, JobData]:
    """Return the jobs by name, without the direction."""
    floor, root = {"regions": {"floor": "z < 1e-9 m"}}, {"regions": {"root": "x < 1e-9 m"}}
    standing, branch = {**floor, **hanging("floor", 0.3)}, {**root, **hanging("root", 0.05)}
    egg = {"regions": {"low": "z < -0.02"}, **hanging("low", 2.0)}
    ventricle = {**hanging("base", 0.0), "effects": [{"effect": "pressure", "region": "endo", "pressure": "0.3 kPa"}]}
    wall: Any = {"inner": 0.5, "outer": 0.55}
    fibrous = {"law": "guccione", "c": "1 kPa", "b_f": 20, "b_t": 7, "b_fs": 14, "kappa": "incompressible"}
    around = ["-y/norm(x + 1 um, y)", "x/norm(x + 1 um, y)", 0.3]  # no direction would be left on the axis itself
    fibres = {"fibre": {"direction": around, "given_on": "current"}}
    return {
        "cube P1": body("box", hanging("z0", 0.3), SOFT, 1, nx=20, ny=20, nz=20),
        "cube P1 large": body("box", hanging("z0", 0.3), STIFF, 1, nx=30, ny=30, nz=30),
        "cube P2": body("box", hanging("z0", 0.3), SOFT, nx=9, ny=9, nz=9),
        "cube P2 mixed": block(40_000),
        "cube P2 incompressible": body("box", hanging("z0", 0.3), "incompressible", nx=12, ny=12, nz=12),
        "cube P3": body("box", hanging("z0", 0.3), SOFT, 3, nx=6, ny=6, nz=6),
        "cube P2 large": body("box", hanging("z0", 0.3), SOFT, nx=14, ny=14, nz=14),
        "bricks": body("box", hanging("z0", 0.3), STIFF, nx=10, ny=10, nz=10, hexahedra=True),
        "rod 5:1": body("box", hanging("x0", 2e-3), STIFF, lx=5, nx=30, ny=6, nz=6),
        "rod 10:1 incompressible": body("box", hanging("x0", 2e-4), "incompressible", lx=10, nx=40, ny=4, nz=4),
        "rod 10:1 P1": body("box", hanging("x0", 2e-4), SOFT, 1, lx=10, nx=100, ny=10, nz=10),
        "plate": body("box", hanging("x0", 2e-3), SOFT, lx=10, ly=10, nx=30, ny=30, nz=3),
        "thin plate P1": body("box", hanging("x0", 1e-4), SOFT, 1, lx=20, ly=20, nx=60, ny=60, nz=3),
        "slivers": body("sliver_layers", {**floor, **hanging("floor", 0.3)}, SOFT, layers=8, sides=8, aspect=1e3),
        "silicone beam": beam(12_000),
        "silicone beam fine": beam(40_000),
        "sphere": sphere(20_000),
        "thin sphere": body("thick_sphere", inflated("0.2 kPa"), CLOSE, along=12, radial=2, **wall),
        "thin sphere P1": body("thick_sphere", inflated("0.2 kPa"), SOFT, 1, along=24, radial=3, **wall),
        "tube": body("thick_cylinder", inflated("0.3 kPa"), CLOSE, radial=4, around=8, along=8),
        "thin tube": body("thick_cylinder", inflated("0.1 kPa"), STIFF, radial=2, around=16, along=16, inner=0.9),
        "organ": body("ellipsoid", egg, CLOSE, size="13 mm"),
        "organ P1": body("ellipsoid", egg, STIFF, 1, size="7 mm"),
        "breast": body("breast", hanging("wall", 2.0), CLOSE, size="9 mm"),
        "ventricle": body("ventricle", ventricle, CLOSE, size="6 mm"),
        "ventricle P1": body("ventricle", ventricle, SOFT, 1, size="4 mm"),
        "finger": body("finger", hanging("base", 1.0), CLOSE, size="3.5 mm"),
        "blade": body("blade", hanging("root", 0.5), SOFT, size="3 mm"),
        "refined corner": body("refined_corner", {**floor, **hanging("floor", 0.3)}, SOFT, size=0.2, ratio=100.0),
        "lattice": body("voxel_body", standing, SOFT, kind="lattice", cells=25),
        "lattice P2": body("voxel_body", standing, SOFT, kind="lattice", cells=13),
        "lattice incompressible": body("voxel_body", standing, "incompressible", kind="lattice", cells=13),
        "tree P1": body("voxel_body", branch, SOFT, 1, kind="tree", cells=40, seed=1),
        "tree P2": body("voxel_body", branch, STIFF, kind="tree", cells=24, seed=2),
        "sponge P1": body("voxel_body", standing, SOFT, 1, kind="sponge", cells=24, seed=3),
        "sponge P2": body("voxel_body", standing, SOFT, kind="sponge", cells=12, seed=4),
        "leaves P1": body("voxel_body", standing, SOFT, 1, kind="leaves", cells=32, seed=5),
        "heart wall": {**body("ventricle", ventricle, SOFT, size="8 mm"), "material": fibrous, "fibres": fibres},
        "lattice large": body("voxel_body", standing, SOFT, kind="lattice", cells=31),
        "rod 50:1 P1": body("box", hanging("x0", 1e-6), SOFT, 1, lx=50, nx=600, ny=12, nz=12),
    }


def large_bodies() -> dict[str, JobData]:
    """Return bodies of 0.5 to 1 million unknowns, which are solved if they are named."""
    return {
        "cube P2 huge": body("box", hanging("z0", 0.3), SOFT, nx=30, ny=30, nz=30),
        "rod 40:1": body("box", hanging("x0", 2e-6), SOFT, lx=40, nx=320, ny=8, nz=8),
        "rod 40:1 huge": body("box", hanging("x0", 2e-6), SOFT, lx=40, nx=400, ny=10, nz=10),
    }


def placed(data: JobData, path: Path) -> JobData:
    """Return the data of a job file with its mesh file as an absolute path."""
    return {**data, "mesh": {**data["mesh"], "file": str((path.parent / data["mesh"]["file"]).resolve())}}


class Stopwatch:
    """Asks a run to stop when it has taken a processor time (s)."""

    def __init__(self, limit: float) -> None:
        self.end = time.process_time() + limit

    def __call__(self) -> bool:
        return time.process_time() > self.end


def measured(data: JobData, linear: str, limit: float, workspace: Workspace) -> tuple[float, Any] | str:
    """Return seconds and statistics of a solve, or why there are none."""
    job = {**data, "solver": {"linear": linear, "rescue": []}, "certificate": WITHOUT_CERTIFICATE}
    job |= {"checkpoint": {"every": 0}, "output": {"fields": False, "mesh": []}}
    try:
        result = hpcinv.run(
            parse(job, ROOT / "benchmarks" / "job.yaml"),
            MPI.COMM_WORLD,
            progress=False,
            workspace=workspace,
            stop_asked=Stopwatch(limit),
        )
    except HpcinvError as error:
        return f"{type(error).__name__}: {str(error).splitlines()[0]}"
    phases = result.statistics["timings"]["phases"]
    return sum(float(phases[name]["max"]) for name in {*SOLVER, "set-up"} if name in phases), result.statistics


def missing_memory(data: JobData) -> float | None:
    """Return the bytes of the factors by MUMPS's analysis if there is no memory for them; collective."""
    solver = {"linear": "direct", "petsc": {_LIMIT_MEMORY: 1}}  # the factorization stops after its analysis
    job = parse({**data, "solver": solver, "certificate": WITHOUT_CERTIFICATE}, ROOT / "benchmarks" / "job.yaml")
    comm = MPI.COMM_WORLD
    model = Equations(job, build_body(job.mesh, job.regions, comm, resolve=job.resolve), Timings())
    if model.chooser.can_factorize:
        return None
    equilibrium = model.equilibrium(model.weak_form(data["analysis"]))
    equilibrium.system.linearise(1.0)
    equilibrium.linear.factorize()
    size = 1e6 * float(equilibrium.linear.ksp.pc.getFactorMatrix().getMumpsInfog(17))
    equilibrium.destroy()
    return size if size > available(comm) else None


def row(name: str, data: JobData, least_rounds: int) -> float | None:
    """Print the line of one body, the least times of all rounds; return the time of `auto` by the better one's."""
    times: dict[str, list[float]] = {"direct": [], "iterative": [], "auto": []}
    used: dict[str, Any] = dict.fromkeys(times)
    missing = missing_memory(data)
    solvers = ["iterative", "auto"] if missing else ["direct", "iterative", "auto"]
    limit, rounds = math.inf, least_rounds
    with Workspace(MPI.COMM_WORLD) as workspace:
        while len(times["auto"]) < rounds:
            for linear in solvers:
                outcome = measured(data, linear, limit, workspace)
                times[linear].append(math.inf if isinstance(outcome, str) else outcome[0])
                used[linear] = None if isinstance(outcome, str) else outcome[1]
                if linear == "direct":
                    if isinstance(outcome, str):
                        say(f"{name:34} {outcome}")
                        return None
                    limit = LIMIT * (times["direct"][0] + 1.0)
                    rounds = least_rounds if times["direct"][0] > SHORT else max(least_rounds, 3)
    best = {linear: min(values, default=math.inf) for linear, values in times.items()}
    better = min(best["direct"], best["iterative"])
    if used["auto"] is None:
        say(f"{name:34} auto found no solution")
        return None
    unknowns, (solution,) = used["auto"]["mesh"]["unknowns"], used["auto"]["solutions"]
    krylov = used["iterative"]["solutions"][0]["linear"]["iterations"] if used["iterative"] else 0
    linear = solution["linear"]
    ratio = best["auto"] / better
    direct = f"{missing / 1e9:.0f} GB" if missing else f"{best['direct']:.2f}"
    say(
        f"{name:34}{unknowns:9}{direct:>9}{best['iterative']:9.2f}{best['auto']:9.2f}{ratio:7.2f}"
        f"{krylov:8}  {linear['configuration']}{' after a change' if linear['fallback'] else ''}"
    )
    if MPI.COMM_WORLD.rank == 0:
        memory = {solver: [round(n / 1e6) for n in run["peak_memory"]["ranks"]] for solver, run in used.items() if run}
        print(f"{name}: {linear['why']}; peaks so far (MB by rank) {memory}", file=sys.stderr, flush=True)
    return ratio


def say(line: str) -> None:
    if MPI.COMM_WORLD.rank == 0:
        print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="bodies; all without names")
    parser.add_argument("--jobs", nargs="*", type=Path, default=[], help="further jobs, with their direction")
    parser.add_argument("--rounds", type=int, default=1, help="least number of rounds; times are their least (1)")
    options = parser.parse_args()
    vars(hpcinv.base.parallel.timings)["time"] = SimpleNamespace(perf_counter=time.process_time)
    say(f"{'body':34}{'unknowns':>9}{'direct':>9}{'iterat.':>9}{'auto':>9}{'ratio':>7}{'Krylov':>8}  auto's choice")
    ratios: dict[str, list[float]] = {"fitted": [], "held out": []}
    scenes = {path.stem: placed(read_yaml(path), path) for path in options.jobs}
    large = {name: data for name, data in large_bodies().items() if name in options.names}
    for number, (name, data) in enumerate({**bodies(), **scenes, **large}.items()):
        if options.names and name not in options.names and name not in scenes:
            continue
        analysis = data.get("analysis", ("inverse", "forward")[number // 2 % 2])
        ratio = row(f"{name}, {analysis}", {**data, "analysis": analysis}, options.rounds)
        if ratio is not None:
            ratios[("fitted", "held out")[number % 2]].append(ratio)
    for kind, values in ratios.items():
        if values:
            worst, median = max(values), statistics.median(values)
            say(
                f"{kind}: {len(values)} bodies, auto by the better one: {median:.2f} in the median, {worst:.2f} at most"
            )


if __name__ == "__main__":
    main()
