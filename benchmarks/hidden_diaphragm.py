"""A ventricle against which a hidden diaphragm presses: hoop strains with and without hidden forces.

The ventricle was imaged at 9 mmHg, while two smooth pressures of 800 and 500 Pa acted on its outside. Marks in its
wall were seen at 2 mmHg, without them, with errors. Four pressures are sought, two of which are zero. Hoop strains of
the imaged ventricle are compared with the true ones at 24 points of its wall.

Command: mpirun -n 1 python benchmarks/hidden_diaphragm.py [--sd 0.5]
"""

from __future__ import annotations

import argparse
import io
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job, load, parse
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.identification.identification_report import describe
from hpcinv.studies.identification.identification_run import identify

JOB = Path(__file__).parents[1] / "jobs" / "ventricle.yaml"
CENTRES = ((0, 0.035, -0.02), (0, 0.03, -0.045), (0, -0.035, -0.02), (0.035, 0, -0.03))  # m
ORGAN = (800.0, 500.0, 0.0, 0.0)  # Pa
RINGS = ((0.0, 0.03), (-0.02, 0.0283), (-0.04, 0.0235))  # height and radius of points in the wall, m
AROUND = 8
EVERY = 7  # of the mesh's nodes one is a mark


def job(pressures: tuple[float, ...], **more: Any) -> Job:
    """Return the ventricle with these pressures on its outside."""
    ventricle = load(JOB)
    data = {key: ventricle.data[key] for key in ("job", "mesh", "let", "fibres", "material", "supports")}
    data["mesh"] = {**data["mesh"], "parameters": {"size": "14 mm"}}
    organ = {"effect": "smooth-pressure", "region": "epi", "centres": [list(c) for c in CENTRES], "width": "20 mm"}

    def filled(pressure: str) -> dict[str, Any]:
        return {"effect": "pressure", "region": "endo", "pressure": pressure}

    angles = 2 * np.pi * np.arange(AROUND) / AROUND
    places = [(r * np.cos(angle), r * np.sin(angle), z) for z, r in RINGS for angle in angles]
    data["states"] = [
        {"name": "ed", "given": True, "effects": [filled("9 mmHg"), organ | {"pressures": list(pressures)}]},
        {"name": "early", "effects": [filled("2 mmHg")]},
    ]
    data["quantities"] = [
        {"name": f"hoop{i}", "of": "norm(x, y)/norm(X, Y) - 1", "at": [float(c) for c in place], "state": "ed"}
        for i, place in enumerate(places)
    ]
    return parse({**data, "certificate": "off", **more}, JOB)


def strains(result: hpcinv.Result) -> npt.NDArray[np.float64]:
    return np.array(list(result.quantities.values()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sd", type=float, default=0.5, help="standard deviation of the marks, mm")
    sd = 1e-3 * parser.parse_args().sd
    comm, nothing, random = MPI.COMM_WORLD, (0.0,) * len(CENTRES), np.random.default_rng(1)
    with Workspace(comm) as workspace, redirect_stdout(io.StringIO()):
        truth = hpcinv.run(job(ORGAN), comm, workspace=workspace, progress=False)
        ends = [time.process_time()]
        plain = hpcinv.run(job(nothing), comm, workspace=workspace, progress=False)
        ends.append(time.process_time())
        nodes, early = truth.body.given_nodes[::EVERY], truth.shapes["early"][::EVERY]
        seen = early + sd * random.standard_normal(early.shape)
        marks = [{"at": at.tolist(), "observed": place.tolist()} for at, place in zip(nodes, seen, strict=True)]
        prior = {"prior": {"mean": 0, "sd": "500 Pa", "strength": "evidence"}}
        section = {
            "parameters": {f"states[0].effects[1].pressures[{i}]": prior for i in range(len(CENTRES))},
            "observations": [{"name": "early", "state": "early", "landmarks": marks, "sd": sd}],
        }
        identified = identify(job(nothing, identify=section), comm, workspace=workspace)
        ends.append(time.process_time())
    exact = strains(truth)
    errors = {
        name: np.abs(strains(result) - exact).max()
        for name, result in (("plain inverse", plain), ("hidden forces", identified.result))
    }
    print("\n".join(describe(identified.estimate)))
    print(
        f"{len(marks)} marks with errors of {1e3 * sd:g} mm; true hoop strains {exact.min():.3f} to {exact.max():.3f}"
    )
    print("; ".join(f"largest error by {name} {error:.4f}" for name, error in errors.items()))
    seconds = np.diff(ends)
    print(f"processor seconds of a rank: plain inverse {seconds[0]:.1f}, with hidden forces {seconds[1]:.1f}")


if __name__ == "__main__":
    main()
