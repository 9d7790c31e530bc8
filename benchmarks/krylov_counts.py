"""Krylov iterations to a relative residual of 1e-6 with multigrid, over size, degree, compressibility and ranks.

A cube of 1 m hangs by its weight, inverse. Two systems are solved: the tangent of the unloaded body, and the tangent
after its correction at full load. "jump" is a lower half whose moduli are 1,000 times the upper half's; "bulk jump" is
one whose bulk modulus alone is.

Command: mpirun -n RANKS python benchmarks/krylov_counts.py [--sizes 20000 60000] [--kinds "P2, incompressible" …], or
python benchmarks/krylov_counts.py --ranks 1 2 4 8
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from assembly import model_of, say

# isort: split
import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)
from hpcinv.base.parallel.runtime import MPI

SOFT: dict[str, Any] = {"law": "neo-hookean", "young": "10 kPa"}
INCOMPRESSIBLE: dict[str, Any] = {"law": "isochoric-neo-hookean", "mu": "3.33 kPa", "kappa": "incompressible"}
MPIRUN = Path(sys.executable).parent / "mpirun"
TOLERANCE = 1e-6  # relative residual


def jumping(poisson: float) -> dict[str, Any]:
    """Return the materials of a body whose lower half is 1,000 times as stiff as the upper half."""
    stiff = {**SOFT, "young": "10 MPa", "poisson": poisson}
    return {"material": {"lower": stiff, "elsewhere": {**SOFT, "poisson": poisson}}}


BULK_JUMP: dict[str, Any] = {
    "material": {
        "lower": {"law": "neo-hookean", "mu": "4 kPa", "poisson": 0.49977},  # bulk by shear modulus 2,167
        "elsewhere": {"law": "neo-hookean", "mu": "4 kPa", "poisson": 0.3},  # 2.167
    }
}
LOCKING: dict[str, Any] = {"discretisation": {"displacement": 1, "formulation": "displacement"}}
KINDS: dict[str, tuple[int, dict[str, Any]]] = {
    "P1, 0.3": (1, {"material": {**SOFT, "poisson": 0.3}}),
    "P1, 0.3, jump": (1, jumping(0.3)),
    "P2, 0.3": (2, {"material": {**SOFT, "poisson": 0.3}}),
    "P2, 0.3, jump": (2, jumping(0.3)),
    "P2, 0.49": (2, {"material": {**SOFT, "poisson": 0.49}}),
    "P2, 0.49, jump": (2, jumping(0.49)),
    "P1, 0.499": (1, {"material": {**SOFT, "poisson": 0.499}, **LOCKING}),
    "P2, 0.499": (2, {"material": {**SOFT, "poisson": 0.499}}),
    "P2, 0.499, jump": (2, jumping(0.499)),
    "P1, bulk jump": (1, {**BULK_JUMP, **LOCKING}),
    "P2, bulk jump": (2, BULK_JUMP),
    "P2, incompressible": (2, {"material": INCOMPRESSIBLE}),
}


def cube(unknowns: int, degree: int, material: dict[str, Any]) -> dict[str, Any]:
    """Return the job of a cube with about a number of displacements."""
    n = round(((unknowns / 3) ** (1 / 3) - 1) / degree)
    n += n % 2  # the halves end between cells
    data: dict[str, Any] = {
        "mesh": {"file": "../meshes/box.py", "parameters": dict.fromkeys(("nx", "ny", "nz"), n)},
        "discretisation": {"displacement": degree},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -0.5], "density": 1000}],
        "supports": [{"region": "z1", "fix": ["x", "y", "z"]}],
        "solver": {"linear": "iterative", "petsc": {"ksp_rtol": TOLERANCE}},
        **material,
    }
    if "lower" in material["material"]:
        data["regions"] = {"lower": "z < 0.50000001 m"}
    return data


def row(name: str, unknowns: int) -> None:
    """Print the iterations of both systems, and the processor time of rank 0 by unknown and system."""
    model = model_of(cube(unknowns, *KINDS[name]))
    equilibrium = model.equilibrium(model.weak_form("inverse"))
    counts, begun = [], time.process_time()
    for _ in range(2):
        equilibrium.correct(1.0)
        counts.append(equilibrium.linear.take_iterations())
    seconds = (time.process_time() - begun) / 2
    say(f"{name:22}{model.unknowns.size:10}{MPI.COMM_WORLD.size:7}{counts[0]:8}{counts[1]:8}{seconds:10.1f}")
    equilibrium.destroy()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[20_000, 60_000, 200_000], help="unknowns, about")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--ranks", type=int, nargs="+", help="start mpirun with these numbers of ranks in turn")
    options = parser.parse_args()
    say(f"{'kind':22}{'unknowns':>10}{'ranks':>7}{'first':>8}{'second':>8}{'s each':>10}")
    for ranks in options.ranks or ():
        sizes = [str(size) for size in options.sizes]
        rest = [sys.executable, __file__, "--sizes", *sizes, "--kinds", *options.kinds]
        done = subprocess.run([MPIRUN, "-n", str(ranks), *rest], stdout=subprocess.PIPE, check=True, text=True)
        print(*done.stdout.splitlines()[1:], sep="\n", flush=True)
    for kind in () if options.ranks else options.kinds:
        for size in options.sizes:
            row(kind, size)


if __name__ == "__main__":
    main()
