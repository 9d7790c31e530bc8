"""Which methods find an unloaded shape, as load, number of load steps and method vary: slab and left ventricle.

The grid is from Barnafi, Regazzoni and Riccobelli (2024), doi:10.1016/j.cma.2024.116845, section 6, and their scripts
``fenics/run-tests-robustness.sh`` (nabw/mechanics-reference-configuration). The slab is theirs: 1 cm x 3 mm x 3 mm,
neo-Hookean with E = 10 kPa, linear tetrahedra (theirs: 24 x 8 x 8 boxes), gravity of 1 to 100 m/s². The ventricle has
their law and springs, on an ellipsoid of ours; the active stress is our second Piola-Kirchhoff stress. Their Armijo
rule for Sellier's iteration has no counterpart here; Aitken's relaxation is the nearest.

A cell is the number of factorizations, or the largest load factor that was solved, or how the iteration ended. Fixed
points may take 100 forward solves, whose load steps are adaptive. "checks" is what the quick certificate says of the
shape that the direct method finds with its own steps: equilibrium, volume ratio, cells, overlap. "by volume" is the
largest relative difference from this shape, if the unloaded cavity's volume is given instead of the pressure in it.

Command: mpirun -n 1 python benchmarks/robustness.py [slab] [ventricle] [--divisions 4] [--size "8 mm"]
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import HpcinvError
from hpcinv.job.job import Job, parse
from hpcinv.trust.certificate import Verdict

HERE = Path(__file__)
SLAB: dict[str, Any] = {
    "job": "slab",
    "analysis": "inverse",
    "mesh": {
        "file": "../meshes/box.py",
        "parameters": {"lx": "10 mm", "ly": "3 mm", "lz": "3 mm"},
    },
    "material": {
        "law": "formula",
        "energy": "mu/2*(I1_bar - 3) + lam/2*(J - 1)*ln(J)",
        "parameters": {"mu": 1e4 / 2.6, "lam": 3e3 / (1.3 * 0.4)},
    },
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    "discretisation": {"displacement": 1},
}
VENTRICLE: dict[str, Any] = {
    "job": "ventricle",
    "analysis": "inverse",
    "mesh": {"file": "../meshes/ventricle.py", "unit": "mm", "parameters": {}},
    "fibres": {
        family: {
            "rule": {"kind": "ventricle", "endo": "endo", "epi": "epi", "base": "base", "helix": ["60 deg", "-60 deg"]}
            | ({"gives": "sheet"} if family == "sheet" else {}),
            "given_on": "current",
        }
        for family in ("fibre", "sheet")
    },
    "material": {
        "law": "usyk-mcculloch",
        "c": "0.88 kPa",
        "b_f": 8,
        "b_s": 6,
        "b_n": 3,
        "b_fs": 12,
        "b_fn": 3,
        "b_sn": 3,
        "kappa": "50 kPa",
    },
    "discretisation": {"displacement": 1, "formulation": "displacement"},
    "cavities": {"lv": {"surface": "endo"}},
    "quantities": [{"name": "V0", "of": "volume", "cavity": "lv", "over": "reference"}],
}
SPRINGS = {"effect": "elastic-foundation", "region": "epi", "normal": 2e5, "tangential": 2e4, "area_in": "current"}
FIXED_POINT = {"maximum_iterations": 100, "tolerance": 1e-6, "memory": 3}  # theirs: 1e-6, 3 steps of Anderson's
ENDS = {"comes no closer": "diverges", "too many iterations": "> 100 solves", "was not solved": "a forward solve fails"}
"""How a fixed-point iteration ended, by words of its message."""
METHODS: Mapping[str, Mapping[str, Any]] = {
    "direct": {},
    "direct, 1 step": {"solver": {"strategy": "fixed", "steps": 1}},
    "direct, 10 steps": {"solver": {"strategy": "fixed", "steps": 10}},
    "direct, 100 steps": {"solver": {"strategy": "fixed", "steps": 100}},
    **{rule: {"method": rule, "fixed_point": FIXED_POINT} for rule in ("sellier", "aitken", "anderson")},
}


def slabs() -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the loads of the slab: title and changes of the job."""
    for load in (1, 10, 25, 50, 75, 100):
        gravity = {"effect": "gravity", "acceleration": [0, 0, load], "density": 1000, "density_in": "current"}
        yield f"gravity {load} m/s²", SLAB | {"effects": [gravity]}


def ventricles() -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the loads of the ventricle: pressures without contraction, then contractions without pressure."""
    for pressure in (100, 1000, 2500, 5000, 10000):
        load = {"effect": "pressure", "region": "endo", "pressure": pressure}
        yield f"pressure {pressure} Pa", VENTRICLE | {"effects": [SPRINGS, load]}
    for stress in (1000, 5000, 10000, 20000, 40000):
        load = {"effect": "active-stress", "stress": stress}
        yield f"active stress {stress} Pa", VENTRICLE | {"effects": [SPRINGS, load]}


GRIDS = {"slab": slabs, "ventricle": ventricles}


def outcome(job: Job, comm: MPI.Intracomm) -> tuple[str, str]:
    """Return the factorizations of a run, or how it ended, and the checks that its shape fails; collective."""
    try:
        result = hpcinv.run(job, comm, progress=False)
    except HpcinvError as error:
        if load := re.search(r"load factor (\S+) of 1", error.message):
            return f"stops at {load[1]}", ""
        return next((end for words, end in ENDS.items() if words in error.message), error.message), ""
    failed = [line.name for line in result.certificate.lines if line.verdict is Verdict.FAIL]
    return str(sum(solution.factorizations for solution in result.solutions)), ", ".join(failed) or "pass"


def difference_by_volume(job: Job, comm: MPI.Intracomm) -> str:
    """Return the relative difference of shapes by pressure and by volume, of a job with a cavity; collective."""
    if not job.cavities:
        return ""
    pressed = hpcinv.run(job, comm, progress=False)
    effects = [effect for effect in job.data["effects"] if effect["effect"] != "pressure"]
    volume = {"cavities.lv.unloaded_volume": pressed.quantities["V0"]}
    filled = hpcinv.run(job.with_({"effects": effects, **volume}), comm, progress=False)
    u, other = (result.solutions[0].u for result in (pressed, filled))
    return f"{np.abs(other - u).max() / np.abs(u).max():.1e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("body", nargs="*", choices=[[], *GRIDS], help="bodies; default: both")
    parser.add_argument("--divisions", type=int, default=4, help="boxes across the slab; theirs: 8")
    parser.add_argument("--size", default="8 mm", help="of the cells of the ventricle")
    options, comm = parser.parse_args(), MPI.COMM_WORLD
    n = options.divisions
    meshes = {"slab": {"nx": 3 * n, "ny": n, "nz": n}, "ventricle": {"size": options.size}}
    for body in options.body or GRIDS:
        if comm.rank == 0:
            print(
                f"| {body} | {' | '.join(METHODS)} | checks | by volume |\n|---|{'---|' * (len(METHODS) + 2)}",
                flush=True,
            )
        for title, data in GRIDS[body]():
            mesh = {**data["mesh"], "parameters": data["mesh"]["parameters"] | meshes[body]}
            settings = {**data, "mesh": mesh, "certificate": "quick"}
            ends = [
                outcome(parse({**settings, **method}, HERE.with_suffix(".yaml")), comm) for method in METHODS.values()
            ]
            difference = difference_by_volume(parse(settings, HERE.with_suffix(".yaml")), comm)
            if comm.rank == 0:
                print(f"| {title} | {' | '.join(end for end, _ in ends)} | {ends[0][1]} | {difference} |", flush=True)


if __name__ == "__main__":
    main()
