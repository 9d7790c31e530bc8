"""Bodies with a cavity by a given pressure and by the volume that it makes: the same answer, and the price.

The volume that the pressure makes is given to a second run, which finds the pressure. Both runs are of one process,
which has mesh, kernels and equations from a first pair of runs, which is not counted. The last columns are relative
differences of pressures and shapes.

Command: mpirun -n 1 python benchmarks/cavities.py [bodies …] [--repeat 3]
"""

from __future__ import annotations

import argparse
import io
import statistics
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
from bench_runs import Findings

import hpcinv
from hpcinv.job.job import Job, load, parse
from hpcinv.output.result import Result
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.workspace import Workspace

ROOT = Path(__file__).parents[1]
LAND = ROOT / "benchmarks" / "published" / "land"
FLAT = {"apex": [0, 0, 0.005]}  # on the axis, in the plane of the base
NAME = "lv"
VOLUMES = [{"name": over, "of": "volume", "cavity": NAME, "over": over} for over in ("reference", "current")]


def bodies() -> dict[str, Job]:
    """Jobs with a pressure on ``endo`` as the first effect."""
    land = {"cavities": {NAME: {"surface": "endo", "lid": FLAT}}, "quantities": VOLUMES, "certificate": "off"}
    coarse = {"across": 1, "around": 8, "along": 6}
    filled = load(LAND / "problem-2.yaml").with_(
        {**land, "mesh.parameters": coarse, "discretisation.displacement": 2, "solver": {}}
    )
    contracted = load(LAND / "problem-3.yaml").with_(
        {**land, "mesh.parameters": {**coarse, "apex": 1.0, "quarter": False}, "discretisation.displacement": 2}
    )
    ventricle = load(ROOT / "jobs" / "ventricle.yaml")
    pressure = ventricle.data["states"][0]["effects"]
    data = {key: ventricle.data[key] for key in ("job", "mesh", "let", "fibres", "material", "supports")}
    unloaded = {
        "analysis": "inverse",
        "effects": pressure,
        "cavities": {NAME: {"surface": "endo"}},
        "quantities": VOLUMES,
    }
    return {
        "Land's problem 2": filled,
        "Land's problem 3": contracted.with_({"solver": {}}),
        "ventricle, inverse": parse({**data, **unloaded, "certificate": "off"}, ROOT / "jobs" / "ventricle.yaml"),
    }


def by_volume(job: Job, volume: float) -> Job:
    """Return the job with a volume instead of its pressure."""
    key = "unloaded_volume" if job.analysis == "inverse" else "volume"
    return job.with_({"effects": job.data["effects"][1:], f"cavities.{NAME}.{key}": volume})


def measure(job: Job, workspace: Workspace) -> tuple[Result, float]:
    """Return the result, and processor seconds of the run."""
    begun = time.process_time()
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        result = hpcinv.run(job, MPI.COMM_WORLD, workspace=workspace, progress=False)
    return result, time.process_time() - begun


def compared(name: str, job: Job, repeat: int) -> list[str]:
    """Return the figures of a body, from the median of the runs."""
    key = "reference" if job.analysis == "inverse" else "current"
    seconds: dict[str, list[float]] = {"pressure": [], "volume": []}
    with Workspace(MPI.COMM_WORLD) as workspace:
        for _ in range(repeat + 1):
            pressed, taken = measure(job, workspace)
            seconds["pressure"].append(taken)
            filled, taken = measure(by_volume(job, pressed.quantities[key]), workspace)
            seconds["volume"].append(taken)
        pressures = job.effects[0].quantities()["pressure"][0], filled.solutions[0].cavities[0].pressure
        shapes = [result.solutions[0].u for result in (pressed, filled)]
        by_pressure, by_volume_seconds = (statistics.median(values[1:]) for values in seconds.values())
        return [
            name,
            f"{pressed.solutions[0].displacement.function_space.dofmap.index_map.size_global * 3:,}",
            *(str(result.solutions[0].factorizations) for result in (pressed, filled)),
            f"{by_pressure:.2f}",
            f"{by_volume_seconds:.2f}",
            f"{by_volume_seconds / by_pressure:.2f}",
            f"{abs(pressures[1] / pressures[0] - 1):.1e}",
            f"{np.abs(shapes[1] - shapes[0]).max() / np.abs(shapes[0]).max():.1e}",
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = bodies()
    parser.add_argument("bodies", nargs="*", default=list(known), help=f"of {', '.join(known)}")
    parser.add_argument("--repeat", type=int, default=3, help="counted pairs of runs, whose median is shown")
    options = parser.parse_args()
    rows = [compared(name, known[name], options.repeat) for name in options.bodies]
    Findings(
        f"pressure given, and found from its volume: processor seconds, medians of {options.repeat}",
        ("body", "displacements", "factorizations", "by volume", "seconds", "by volume", "ratio", "pressure", "shape"),
        rows,
    ).show()


if __name__ == "__main__":
    main()
