"""Simulation-based calibration of the posterior on a finite-element model: ranks must be uniform.

Numbers are drawn from their priors, the model makes volumes from them, and errors are added. The rank of a drawn
number among samples of the posterior by 'hpcinv identify --posterior' is uniform if the posterior is right. The model
is an octant of a thick sphere (Mooney-Rivlin) with a given state, whose unloaded volume and volumes at two pressures
are seen.

Source: Talts, Betancourt, Simpson, Vehtari & Gelman (2018), arXiv:1804.06788.

Command: python benchmarks/posterior_calibration.py [--repeats 100] [--samples 39] [--first SEED]
"""

from __future__ import annotations

import argparse
import io
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import scipy.stats

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.job.job import Job, parse
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.identification.identification_run import identify

PATH = Path(__file__).parents[1] / "jobs" / "sphere.yaml"
PRIORS = {"material.c1": (0.5, 0.05), "material.c2": (0.1, 0.03)}  # mean and standard deviation, Pa
PRESSURES = (0.1, 0.4)  # of two more states; the given one has 0.2 Pa
SD = 2e-3  # of a volume, 0.4 % of the given one, m³
QUANTITIES = ("V0", *(f"V-at-{i}" for i in range(len(PRESSURES))))
BINS = 5


def sphere(**more: Any) -> Job:
    """Return the sphere with some changes."""
    mesh = {"inner": 1.0, "outer": 1.5, "radial": 1, "along": 1, "hexahedra": True}

    def inflated(by: float) -> list[dict[str, Any]]:
        return [{"effect": "pressure", "region": "inner", "pressure": by}]

    data = {
        "mesh": {"file": "../meshes/thick_sphere.py", "parameters": mesh, "geometry_degree": 2},
        "material": {"law": "mooney-rivlin", "c1": 0.5, "c2": 0.1, "d1": "incompressible"},
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        "cavities": {"hollow": {"surface": "inner", "lid": {"apex": [0, 0, 0]}}},
        "states": [
            {"name": "scan", "given": True, "effects": inflated(0.2)},
            *({"name": f"at-{i}", "effects": inflated(by)} for i, by in enumerate(PRESSURES)),
        ],
        "quantities": [
            {"name": "V", "of": "volume", "cavity": "hollow"},
            {"name": "V0", "of": "volume", "cavity": "hollow", "over": "reference", "state": "scan"},
        ],
        "certificate": "off",
    }
    return parse(data, PATH).with_(more)


def ranks(seed: int, samples: int, workspace: Workspace) -> tuple[np.ndarray, float]:
    """Return the rank of each drawn number among the samples, and the share of accepted proposals."""
    random = np.random.default_rng(seed)
    drawn = {key: float(random.normal(*prior)) for key, prior in PRIORS.items()}
    truth = hpcinv.run(sphere(**drawn), MPI.COMM_SELF, workspace=workspace).quantities
    observations = [
        {"name": name, "quantity": name, "value": float(truth[name]) + SD * random.standard_normal(), "sd": SD}
        for name in QUANTITIES
    ]
    parameters = {key: {"prior": {"mean": mean, "sd": sd}} for key, (mean, sd) in PRIORS.items()}
    section = {"parameters": parameters, "observations": observations}
    posterior = identify(sphere(identify=section), MPI.COMM_SELF, workspace=workspace, samples=samples).estimate.sampled
    assert posterior is not None
    return (posterior.samples < list(drawn.values())).sum(axis=0), posterior.acceptance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--samples", type=int, default=39)
    parser.add_argument("--first", type=int, default=0, help="seed of the first repeat")
    options = parser.parse_args()
    found, acceptance, failed = list[np.ndarray](), list[float](), 0
    begun = time.process_time()
    with Workspace(MPI.COMM_SELF) as workspace:
        for seed in range(options.first, options.first + options.repeats):
            try:
                with redirect_stdout(io.StringIO()):
                    rank, accepted = ranks(seed, options.samples, workspace)
            except SolveError:  # such as numbers without a solution
                failed += 1
                continue
            found.append(rank)
            acceptance.append(accepted)
            print(f"{seed}: ranks {rank}, {accepted:.0%} accepted, {time.process_time() - begun:.0f} s", flush=True)
    print(f"{len(found)} repeats of {options.samples} samples, {failed} failed; {np.mean(acceptance):.0%} accepted")
    for key, parameter in zip(PRIORS, np.transpose(found), strict=True):
        counts = np.bincount(parameter * BINS // (options.samples + 1), minlength=BINS)
        chance = scipy.stats.chisquare(counts).pvalue
        print(f"{key}: ranks by fifth {counts}; as uneven by chance {chance:.2g}")


if __name__ == "__main__":
    main()
