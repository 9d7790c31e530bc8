"""Seconds of derivatives (``result.vjp``), compared to the run of which they are.

The body is a block that hangs aslant. Weights are of the whole shape; inputs are the modulus of each cell and the
pressure of each facet, then also the nodes of the given body. Seconds are of the processor, of one rank.

Command: python benchmarks/derivatives.py [--sizes 8000 35000]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import load
from hpcinv.solver.workspace import Workspace

MESH = Path(__file__).parents[1] / "meshes" / "box.py"
SPACES = {
    "linear": {"displacement": 1, "formulation": "displacement"},
    "quadratic": {"displacement": 2, "formulation": "displacement"},
    "quadratic, pressure": {"displacement": 2, "formulation": "mixed"},
}


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """Return what a call returns, and its seconds of the processor."""
    start = time.process_time()
    result = call()
    return result, time.process_time() - start


def block(unknowns: int, spaces: dict[str, Any]) -> dict[str, Any]:
    """Return the job of a block with about so many unknown displacements."""
    points = round((unknowns / 3 / 2) ** (1 / 3)) - 1  # of n x n x 2 n cells or halves
    cells = max(points // int(spaces["displacement"]), 1)
    size = {"lx": 0.1, "ly": 0.1, "lz": 0.2, "nx": cells, "ny": cells, "nz": 2 * cells}
    return {
        "mesh": {"file": str(MESH), "parameters": size, "geometry_degree": spaces["displacement"]},
        "material": {"law": "isochoric-neo-hookean", "mu": 2e4, "kappa": 2e5},
        "discretisation": spaces,
        "effects": [
            {"effect": "gravity", "acceleration": [1, 0, -5], "density": 1000},
            {"effect": "pressure", "region": "x1", "pressure": 100},
        ],
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        "certificate": "off",
    }


def measure(unknowns: int, name: str) -> str:
    """Return a row of the table."""
    job, workspace = load(block(unknowns, SPACES[name])), Workspace(MPI.COMM_SELF)
    inputs = ["material.mu", "effects[1].pressure"]
    small = hpcinv.run(load(block(300, SPACES[name])), MPI.COMM_SELF, progress=False)
    small.vjp({"shape": np.ones_like(small.shape_in_file)}, inputs, nodes=True)  # makes the programs
    result, run = timed(lambda: hpcinv.run(job, MPI.COMM_SELF, progress=False, workspace=workspace))
    weights = {"shape": np.ones_like(result.shape_in_file)}
    _, first = timed(lambda: result.vjp(weights, inputs))
    _, later = timed(lambda: result.vjp(weights, inputs))
    _, nodes = timed(lambda: result.vjp(weights, inputs, nodes=True))
    _, again = timed(lambda: result.vjp(weights, inputs, nodes=True))
    shares = " | ".join(f"{part / run:.2f}" for part in (first, later, nodes, again))
    return f"| {name} | {result.shape_in_file.size:,} | {run:.1f} | {shares} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[8_000, 35_000], help="unknowns, about")
    options = parser.parse_args()
    print("| displacement | numbers of the shape | run (s) | first `vjp` / run | later | first with nodes | later |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for size in options.sizes:
        for kind in SPACES:
            print(measure(size, kind), flush=True)
