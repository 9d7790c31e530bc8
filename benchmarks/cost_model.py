"""Operations, entries and seconds of MUMPS's factorizations, and the forecast by which `auto` chooses a solver.

Blocks of silicone of several sizes and aspect ratios, inverse, at full load from the unloaded body: one tangent of each
is factorized, analysis included, in double and in single precision, in METIS's ordering and by approximate minimum
fill (AMF). Operations and entries are MUMPS's own counts; seconds are processor time.

Command: mpirun -n 1 python benchmarks/cost_model.py [--sizes 5000 20000 60000 110000] [--aspects 1 3 10 40]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from assembly import model_of, say
from bodies import block

# isort: split
import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from petsc4py import PETSc

from hpcinv.solver.linear.cost_model import Forecast, shape_of

ORDERINGS = {"METIS": 5, "AMF": 2}
OPERATIONS, ENTRIES = 3, 29  # of the elimination (RINFOG), in the factors (INFOG)


def rod(unknowns: int, aspect: int) -> dict[str, Any]:
    """A block of about a number of unknowns that is ``aspect`` times as long as it is wide."""
    sizes = [(n, 3 * (2 * n * aspect + 1) * (2 * n + 1) ** 2 + (n * aspect + 1) * (n + 1) ** 2) for n in range(1, 60)]
    n = min(sizes, key=lambda size: abs(size[1] - unknowns))[0]
    parameters = {"lx": aspect, "ly": 1, "lz": 1, "nx": n * aspect, "ny": n, "nz": n}
    data = block(unknowns, analysis="inverse", supports=[{"region": "x0", "fix": ["x", "y", "z"]}])
    return {**data, "mesh": {**data["mesh"], "parameters": parameters}}


def factorized(matrix: PETSc.Mat, precision: str, ordering: str) -> tuple[float, float, float]:
    """Processor seconds of a factorization L U, its operations and its entries."""
    options = PETSc.Options("cost_")
    options.setValue("pc_precision", precision)
    options.setValue("mat_mumps_icntl_7", ORDERINGS[ordering])
    pc = PETSc.PC().create(matrix.comm)
    pc.setOptionsPrefix("cost_")
    pc.setOperators(matrix)
    pc.setType(PETSc.PC.Type.LU)
    pc.setFactorSolverType("mumps")
    pc.setFromOptions()
    begun = time.process_time()
    pc.setUp()
    seconds = time.process_time() - begun
    factors = pc.getFactorMatrix()
    entries = factors.getMumpsInfog(ENTRIES)
    figures = seconds, factors.getMumpsRinfog(OPERATIONS), entries if entries >= 0 else -1e6 * entries
    pc.destroy()
    return figures


def compare(unknowns: int, aspect: int) -> None:
    model = model_of(rod(unknowns, aspect))
    equilibrium = model.equilibrium(model.weak_form("inverse"))
    equilibrium.system.linearise(1.0)
    forecast = Forecast(model.unknowns.size, 2, shape_of(model.unknowns))
    matrix = equilibrium.system.matrix
    double, operations, entries = factorized(matrix, "double", "METIS")
    single = {ordering: factorized(matrix, "single", ordering) for ordering in ORDERINGS}
    say(
        f"{model.unknowns.size:9}{aspect:8}{operations / 1e9:12.1f}{forecast.operations / 1e9:10.1f}"
        f"{entries / 1e6:12.1f}{forecast.entries / 1e6:10.1f}{double:10.2f}{forecast.factorization:10.2f}"
        f"{single['METIS'][0]:12.2f}{single['AMF'][0]:8.2f}"
    )
    equilibrium.destroy()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[5_000, 20_000, 60_000, 110_000])
    parser.add_argument("--aspects", type=int, nargs="+", default=[1, 3, 10, 40])
    options = parser.parse_args()
    say(
        f"{'unknowns':>9}{'aspect':>8}{'Gflop':>12}{'forecast':>10}{'1e6 entries':>12}{'forecast':>10}"
        f"{'double s':>10}{'forecast':>10}{'single s':>12}{'AMF':>8}"
    )
    for unknowns in options.sizes:
        for aspect in options.aspects:
            compare(unknowns, aspect)
