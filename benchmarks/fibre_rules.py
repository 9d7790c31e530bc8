"""What fibres by a rule cost, compared with a run: a left ventricle in cells of several sizes, inverse, at 9 mmHg.

Run ``mpirun -n 2 python benchmarks/fibre_rules.py``.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from hpcinv.parallel.runtime import MPI  # its import order first

# isort: split
import hpcinv
from hpcinv.job.job import parse
from hpcinv.mesh import build_body
from hpcinv.model.fibre_directions import rule_directions

HERE = Path(__file__)
SIZES = ("8 mm", "6 mm", "4 mm")


def job(size: str) -> Any:
    """The ventricle of jobs/ventricle.yaml in its given state, with fibres by a rule."""
    rule = {"kind": "ventricle", "endo": "endo", "epi": "epi", "base": "base", "helix": ["60 deg", "-60 deg"]}
    parameters = {"size": size}
    return parse(
        {
            "mesh": {"file": "../meshes/ventricle.py", "unit": "mm", "parameters": parameters, "geometry_degree": 2},
            "fibres": {"fibre": {"rule": rule, "given_on": "current"}},
            "material": {"law": "guccione", "c": "0.4 kPa", "b_f": 20, "b_t": 7, "b_fs": 14, "kappa": "incompressible"},
            "supports": [{"region": "base", "fix": ["x", "y", "z"]}],
            "effects": [{"effect": "pressure", "region": "endo", "pressure": "9 mmHg"}],
            "certificate": "off",
        },
        HERE,
    )


def main() -> None:
    """Print a line for each size; the first one is run twice, since it may compile kernels."""
    comm = MPI.COMM_WORLD
    for number, size in enumerate((SIZES[0], *SIZES)):
        given = job(size)
        body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
        family = given.fibres["fibre"]
        comm.barrier()
        began = time.perf_counter()
        rule_directions(body, family.rule, "fibres.fibre")
        rule_seconds = comm.allreduce(time.perf_counter() - began, op=MPI.MAX)
        began = time.perf_counter()
        hpcinv.run(given, comm, progress=False)
        run_seconds = comm.allreduce(time.perf_counter() - began, op=MPI.MAX)
        if number and comm.rank == 0:
            cells = sum(body.partition.cells)
            share = f"rule {rule_seconds:.2f} s, run {run_seconds:.1f} s: {rule_seconds / run_seconds:.1%}"
            print(f"{size}: {cells} cells, {share}", flush=True)


if __name__ == "__main__":
    main()
