"""Posterior of ten numbers of a ventricle: exact evaluations, their price, and the time of the whole.

The ventricle of `jobs/ventricle.yaml` was imaged at about 9 mmHg while five smooth pressures acted on its outside.
Marks in its wall were seen at 2 mmHg with errors of 1 mm, and its volume at 5 mmHg with an error of 2 ml. Sought are
the four numbers of the law, the pressure of the image, and the five smooth pressures. "true" is the share of numbers
whose true value lies in the 95 % interval.

With --evaluations, only so many are made, and the time of the whole is projected.

Command: python benchmarks/ten_parameters.py [--size "6 mm"] [--samples 50] [--evaluations N]
"""

from __future__ import annotations

import argparse
import io
import time
from contextlib import redirect_stdout, suppress
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import Interrupted
from hpcinv.job.job import Job, load, parse
from hpcinv.mesh.source import Floats
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.identification.identification_run import identify
from hpcinv.studies.identification.job_evaluation import Evaluation

JOB = Path(__file__).parents[1] / "jobs" / "ventricle.yaml"
CENTRES = ((0, 0.035, -0.02), (0, 0.03, -0.045), (0, -0.035, -0.02), (0.035, 0, -0.03), (-0.035, 0, -0.03))  # m
FORCES = (800.0, 500.0, 0.0, 0.0, 200.0)  # Pa
TRUE = {"material.c": 400.0, "material.b_f": 20.0, "material.b_t": 7.0, "material.b_fs": 14.0}
PRESSURE = 9 * 133.322368  # Pa
MARKS = 60
FIRST, BEFORE_SAMPLES = 12, 1 + 2 * 10
"""Evaluations of the least squares, as other ventricles took, and of the surrogate of ten numbers."""


def job(forces: tuple[float, ...], size: str, **more: Any) -> Job:
    """Return the ventricle with these pressures on its outside."""
    ventricle = load(JOB)
    data = {key: ventricle.data[key] for key in ("job", "mesh", "let", "fibres", "material", "supports")}
    data["mesh"] = {**data["mesh"], "parameters": {"size": size}}
    organ = {"effect": "smooth-pressure", "region": "epi", "centres": [list(c) for c in CENTRES], "width": "20 mm"}

    def filled(pressure: float | str) -> dict[str, Any]:
        return {"effect": "pressure", "region": "endo", "pressure": pressure}

    data["states"] = [
        {"name": "ed", "given": True, "effects": [filled(PRESSURE), organ | {"pressures": list(forces)}]},
        {"name": "early", "effects": [filled("2 mmHg")]},
        {"name": "late", "effects": [filled("5 mmHg")]},
    ]
    data["cavities"] = {"lv": {"surface": "endo"}}
    data["quantities"] = [{"name": "V", "of": "volume", "cavity": "lv"}]
    return parse({**data, "certificate": "off", **more}, JOB)


def section(truth: hpcinv.Result) -> dict[str, Any]:
    """Return the section ``identify`` with marks and a volume of the true ventricle, with errors."""
    random = np.random.default_rng(1)
    chosen = np.sort(random.choice(len(truth.body.given_nodes), MARKS, replace=False))
    early = truth.shapes["early"][chosen]
    seen = early + 1e-3 * random.standard_normal(early.shape)
    nodes = truth.body.given_nodes[chosen]
    marks = [{"at": at.tolist(), "observed": place.tolist()} for at, place in zip(nodes, seen, strict=True)]
    volume = float(np.asarray(truth.quantities["V-late"])) + 2e-6 * random.standard_normal()
    law = {key: {"prior": {"mean": 1.1 * value, "sd": 0.2 * value}} for key, value in TRUE.items()}
    pressed = {"states[0].effects[0].pressure": {"prior": {"mean": 1.03 * PRESSURE, "sd": 0.06 * PRESSURE}}}
    organs = {f"states[0].effects[1].pressures[{i}]": {"prior": {"mean": 0, "sd": 500}} for i in range(len(FORCES))}
    return {
        "parameters": law | pressed | organs,
        "observations": [
            {"name": "early", "state": "early", "landmarks": marks, "sd": "1 mm"},
            {"name": "late", "quantity": "V-late", "value": volume, "sd": "2 ml"},
        ],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="6 mm")
    parser.add_argument("--samples", type=int, default=50, help="exact evaluations of the second stage")
    parser.add_argument("--evaluations", type=int, default=0, help="stop after so many, and project")
    options = parser.parse_args()
    comm, made, ends = MPI.COMM_SELF, list[float](), list[float]()

    def report(_number: int, _values: Floats, chi: float, evaluation: Evaluation) -> None:
        made.append(chi)
        ends.append(time.process_time())

    def is_enough() -> bool:  # asked on each rank; one is sufficient
        return bool(options.evaluations) and len(made) >= options.evaluations

    with Workspace(comm) as workspace, redirect_stdout(io.StringIO()):
        truth = hpcinv.run(job(FORCES, options.size), comm, workspace=workspace)
        given = job((0.0,) * len(FORCES), options.size, identify=section(truth))
        begun = time.process_time()
        identified = None
        with suppress(Interrupted):
            identified = identify(
                given, comm, workspace=workspace, samples=options.samples, report=report, stop_asked=is_enough
            )
    seconds = np.diff([begun, *ends])
    print(f"{len(made)} evaluations; processor seconds: first {seconds[0]:.1f}, median {np.median(seconds):.1f}")
    if identified is None:
        whole = (FIRST + BEFORE_SAMPLES + options.samples) * np.median(seconds) / 60
        print(f"projected for {FIRST} + {BEFORE_SAMPLES} + {options.samples} evaluations: {whole:.1f} min")
        return
    posterior = identified.estimate.sampled
    assert posterior is not None
    whole, size = (time.process_time() - begun) / 60, posterior.effective_size
    print(f"whole {whole:.1f} min; {posterior.acceptance:.0%} accepted; as good as {size:.0f} independent samples")
    exact = [*TRUE.values(), PRESSURE, *FORCES]
    low, high = posterior.quantiles[0], posterior.quantiles[-1]
    for parameter, value, *interval in zip(identified.estimate.parameters, exact, low, high, strict=True):
        print(f"  {parameter.key}: true {value:.4g}, 95 % {interval[0]:.4g} to {interval[1]:.4g}")
    print(f"true: {np.mean((low <= exact) & (exact <= high)):.0%}")


if __name__ == "__main__":
    main()
