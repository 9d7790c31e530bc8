"""Bodies with cavities of given and of unknown pressure: the same answer, and the price.

First table: the volume that a pressure makes is given to a second run, which finds the pressure. The last columns are
relative differences of pressures and shapes.

Second table: cavities of unknown pressure, forward from the mesh and back, and the same round trip with the pressure
that was found. "closed form" is the difference of the pressure from the neo-Hookean sphere's, or of the gas from
(p + a) V = n a V₀; the last column is how far the shape back is from the mesh, relative to the displacement.

All runs are of one process, which has mesh, kernels and equations from a first run, which is not counted.

Command: mpirun -n 1 python benchmarks/cavities.py [bodies …] [--repeat 3]
"""

from __future__ import annotations

import argparse
import io
import math
import statistics
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from bench_runs import Findings
from robustness import SPRINGS, VENTRICLE

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job, load, parse
from hpcinv.output.result import Result
from hpcinv.physics.effects.pressure import Pressure
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
    springs = {"effects": [SPRINGS, {"effect": "pressure", "region": "endo", "pressure": "2.5 kPa"}]}
    nabw = VENTRICLE | springs | {"cavities": {NAME: {"surface": "endo"}}, "quantities": VOLUMES, "certificate": "off"}
    nabw["mesh"] = VENTRICLE["mesh"] | {"parameters": {"size": "8 mm"}}
    return {
        "nabw's ventricle, inverse": parse(nabw, ROOT / "benchmarks" / "bench.yaml"),
        "Land's problem 2": filled,
        "Land's problem 3": contracted.with_({"solver": {}}),
        "ventricle, inverse": parse({**data, **unloaded, "certificate": "off"}, ROOT / "jobs" / "ventricle.yaml"),
    }


BELLOWS: dict[str, Any] = {
    "analysis": "round_trip",
    "first": "forward",
    "mesh": {"file": "../meshes/bellows.py", "geometry_degree": 2},
    "material": {"law": "mooney-rivlin", "c1": "30 kPa", "c2": "10 kPa", "d1": "2 MPa"},
    "supports": [
        {"region": "bottom", "fix": ["x", "y", "z"]},
        {"region": "x0", "fix": ["x"]},
        {"region": "y0", "fix": ["y"]},
    ],
}
AXIS = {"apex": [0, 0, 0]}
AMBIENT, AMOUNT = 101_325.0, 1.2
MU, STRETCH = 100e3, 2.0  # of the balloon, beyond the largest pressure


def controlled() -> dict[str, tuple[Job, float | None]]:
    """Return round trips with a cavity ``hole`` of unknown pressure, and the pressure in closed form if it is known."""
    finger = load(ROOT / "jobs" / "syringe-finger.yaml")
    (syringe,) = finger.data["cavities"].values()
    inner, outer = 0.5, 1.0
    grown = [(outer**3 - inner**3 + (STRETCH * inner) ** 3) ** (1 / 3) / outer, STRETCH]
    far, near = (MU / 2 * (4 / s + s**-4) for s in grown)
    balloon: dict[str, Any] = BELLOWS | {
        "mesh": {"file": "../meshes/thick_sphere.py", "parameters": {"radial": 2, "along": 3, "hexahedra": True}},
        "material": {"law": "neo-hookean", "mu": MU, "lam": "incompressible"},
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
    }
    balloon["mesh"] |= {"geometry_degree": 2}
    chambers = {"parameters": {"chambers": 2, "size": "3.5 mm"}}
    jobs = {
        "balloon beyond its maximum": (
            balloon,
            {"surface": "inner", "lid": AXIS, "volume": math.pi * (STRETCH * inner) ** 3 / 6},
            far - near,
        ),
        "two connected chambers": (
            BELLOWS | {"mesh": BELLOWS["mesh"] | chambers},
            {"surface": ["chamber1", "chamber2"], "lid": AXIS, "volume": "3 ml"},
            None,
        ),
        "bellows, heated gas": (
            BELLOWS,
            {"surface": "chamber1", "lid": AXIS, "gas": {"ambient": AMBIENT, "amount": AMOUNT}},
            None,
        ),
        "finger by a syringe": (
            {key: value for key, value in finger.data.items() if key not in ("cavities", "quantities")},
            syringe,
            None,
        ),
    }
    more = {"certificate": "off"}
    path = ROOT / "jobs" / "bench.yaml"
    return {
        name: (parse({**data, "cavities": {"hole": hole}, **more}, path), pressure)
        for name, (data, hole, pressure) in jobs.items()
    }


def pressed(job: Job, pressure: float) -> Job:
    """Return the job with a given pressure in its cavity ``hole``."""
    effects = [
        {"effect": "pressure", "region": region, "pressure": pressure} for region in job.cavities["hole"].regions
    ]
    return job.with_({"cavities": {}, "effects": [*job.data.get("effects", []), *effects]})


def closed(name: str, job: Job, closed_form: float | None, repeat: int) -> list[str]:
    """Return the figures of a round trip with unknown pressure, and with the same pressure given."""
    seconds: dict[str, list[float]] = {"unknown": [], "given": []}
    with Workspace(MPI.COMM_WORLD) as workspace:
        for _ in range(repeat + 1):
            result, taken = measure(job, workspace)
            seconds["unknown"].append(taken)
        there, back = result.solutions
        cavity = there.cavities[0]
        plain = None
        for _ in range(repeat + 1 if closed_form is None else 0):  # at this pressure the balloon has a smaller shape
            plain, taken = measure(pressed(job, cavity.pressure), workspace)
            seconds["given"].append(taken)
        difference = ""
        if closed_form is not None:
            difference = f"{abs(cavity.pressure / closed_form - 1):.1e}"
        elif job.cavities["hole"].gas is not None:
            gas = (cavity.pressure + AMBIENT) * cavity.volume / (AMOUNT * AMBIENT * cavity.unloaded_volume)
            difference = f"{abs(gas - 1):.1e}"
        unknown = statistics.median(seconds["unknown"][1:])
        given = statistics.median(seconds["given"][1:]) if plain else None
        counts = [
            "" if run is None else "+".join(str(solution.factorizations) for solution in run.solutions)
            for run in (plain, result)
        ]
        shape = np.abs(plain.solutions[0].u - there.u).max() / np.abs(there.u).max() if plain else None
        return [
            name,
            f"{unknowns(result):,}",
            f"{cavity.pressure / 1e3:.4g}",
            *counts,
            "" if given is None else f"{given:.2f}",
            f"{unknown:.2f}",
            "" if given is None else f"{unknown / given:.2f}",
            difference,
            "" if shape is None else f"{shape:.1e}",
            f"{np.abs(back.u - there.u).max() / np.abs(there.u).max():.1e}",
        ]


def unknowns(result: Result) -> int:
    """Return the number of unknowns of a solve."""
    spaces = [field.function_space.dofmap for field in result.solutions[0].fields if field is not None]
    return sum(space.index_map.size_global * space.index_map_bs for space in spaces)


def by_volume(job: Job, volume: float) -> Job:
    """Return the job with a volume instead of its pressure."""
    key = "unloaded_volume" if job.analysis == "inverse" else "volume"
    effects = [effect for effect in job.data["effects"] if effect["effect"] != "pressure"]
    return job.with_({"effects": effects, f"cavities.{NAME}.{key}": volume})


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
            given_pressure, taken = measure(job, workspace)
            seconds["pressure"].append(taken)
            filled, taken = measure(by_volume(job, given_pressure.quantities[key]), workspace)
            seconds["volume"].append(taken)
        (given,) = (effect for effect in job.effects if isinstance(effect, Pressure))
        pressures = given.quantities()["pressure"][0], filled.solutions[0].cavities[0].pressure
        shapes = [result.solutions[0].u for result in (given_pressure, filled)]
        by_pressure, by_volume_seconds = (statistics.median(values[1:]) for values in seconds.values())
        return [
            name,
            f"{unknowns(given_pressure):,}",
            *(str(result.solutions[0].factorizations) for result in (given_pressure, filled)),
            f"{by_pressure:.2f}",
            f"{by_volume_seconds:.2f}",
            f"{by_volume_seconds / by_pressure:.2f}",
            f"{abs(pressures[1] / pressures[0] - 1):.1e}",
            f"{np.abs(shapes[1] - shapes[0]).max() / np.abs(shapes[0]).max():.1e}",
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known, closed_bodies = bodies(), controlled()
    parser.add_argument("bodies", nargs="*", help=f"of {', '.join([*known, *closed_bodies])}")
    parser.add_argument("--repeat", type=int, default=3, help="counted runs, whose median is shown")
    options = parser.parse_args()
    chosen = options.bodies or [*known, *closed_bodies]
    about = f"processor seconds, medians of {options.repeat}"
    Findings(
        f"pressure given, and found from its volume: {about}",
        ("body", "unknowns", "factorizations", "by volume", "seconds", "by volume", "ratio", "pressure", "shape"),
        [compared(name, known[name], options.repeat) for name in chosen if name in known],
    ).show()
    Findings(
        f"unknown pressure, forward and back, and the same with the pressure given: {about}",
        (
            *("body", "unknowns", "kPa", "factorizations", "unknown", "seconds", "unknown", "ratio"),
            *("closed form", "shape", "back"),
        ),
        [closed(name, *closed_bodies[name], options.repeat) for name in chosen if name in closed_bodies],
    ).show()


if __name__ == "__main__":
    main()
