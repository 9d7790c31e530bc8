"""One block of hexahedra, loaded forward by hpcinv, felupe, scikit-fem and CalculiX, each in a process with one thread.

All solve the same equations: linear hexahedra with 2 x 2 x 2 points, the isochoric neo-Hookean law with
``kappa/2 (J - 1)²``, the lower face held, the upper one moved by a fifth of the height and a tenth to the side, in one
load step, to a relative error of 1e-8. The table has medians of processor seconds over rounds in which the programs
take turns: of one assembly of the tangent, of the solution with the set-up of unknowns, and of the whole process.
The distance is between the displacements of a node inside, relative to hpcinv's.

felupe and scikit-fem are libraries: their users choose the solver of linear systems, here PARDISO of Intel's MKL by
pypardiso. hpcinv takes MUMPS, as it does by default. CalculiX runs the deck that hpcinv writes of the same run, with
its own criterion of convergence and SPOOLES.

Command: python3 -m uv run --with felupe --with scikit-fem --with pypardiso python benchmarks/beside_others.py
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
SIDE, MU, KAPPA, MOVE, TOLERANCE = 0.1, 2e4, 2e5, (0.01, 0.0, 0.02), 1e-8
INSIDE = np.array([0.25, 0.5, 0.5]) * SIDE
"""place of a node, if the number of cells can be divided by 4"""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
RUN = "block"
"""directory of the run of hpcinv, and name of its deck"""

Measured = dict[str, Any]


def timed[T](call: Callable[[], T]) -> tuple[T, float]:
    """Return what a call returns, and its seconds of the processor."""
    start = time.process_time()
    result = call()
    return result, time.process_time() - start


def job_of(cells: int) -> dict[str, Any]:
    """Return the job of a block with so many cells along each edge."""
    size = {"lx": SIDE, "ly": SIDE, "lz": SIDE, "nx": cells, "ny": cells, "nz": cells, "hexahedra": True}
    return {
        "job": RUN,
        "analysis": "forward",
        "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": size, "geometry_degree": 1},
        "material": {"law": "isochoric-neo-hookean", "mu": MU, "kappa": KAPPA},
        "discretisation": {"displacement": 1, "formulation": "displacement", "quadrature": 3},
        "supports": [
            {"region": "z0", "fix": ["x", "y", "z"]},
            {"region": "z1", "displacement": [f"{part}" for part in MOVE]},
        ],
        "solver": {"tolerance": TOLERANCE},
        "quantities": [{"name": f"inside-{axis}", "of": f"u{axis}", "at": INSIDE.tolist()} for axis in "xyz"],
        "certificate": "off",
    }


def by_hpcinv(cells: int, place: Path) -> Measured:
    """Solve it by a run whose output the deck is made of."""
    import hpcinv

    result, seconds = timed(lambda: hpcinv.run(job_of(cells), directory=place / RUN, overwrite=True, progress=False))
    data = result.to_dict()
    tangents = data["solutions"][0]["factorizations"]
    return {
        "assembly": data["timings"]["phases"]["tangent"]["max"] / tangents,
        "solution": seconds,
        "iterations": tangents,
        "inside": [float(result.quantities[f"inside-{axis}"]) for axis in "xyz"],
    }


def by_felupe(cells: int, place: Path) -> Measured:
    """Solve it by felupe's Newton method."""
    import felupe

    solved = pardiso()

    mesh = felupe.Cube(b=(SIDE, SIDE, SIDE), n=cells + 1)

    def solve() -> tuple[Any, Any, Any]:
        field = felupe.FieldContainer([felupe.Field(felupe.RegionHexahedron(mesh), dim=3)])
        body = felupe.SolidBody(felupe.NeoHooke(mu=MU, bulk=KAPPA), field)
        held = {"z0": felupe.Boundary(field[0], fz=0.0)}
        for axis, part in enumerate(MOVE):
            held[f"z1{axis}"] = felupe.Boundary(field[0], fz=SIDE, value=part, skip=[i != axis for i in range(3)])
        fixed, free = felupe.dof.partition(field, held)
        return (
            felupe.newtonraphson(
                items=[body],
                dof0=fixed,
                dof1=free,
                ext0=felupe.dof.apply(field, held, fixed),
                solver=solved,
                tol=TOLERANCE,
                verbose=0,
            ),
            body,
            field,
        )

    (found, body, field), seconds = timed(solve)
    _, assembly = timed(lambda: body.assemble.matrix(field))
    node = int(np.argmin(np.linalg.norm(mesh.points - INSIDE, axis=1)))
    return {
        "assembly": assembly,
        "solution": seconds,
        "iterations": found.iterations,
        "inside": found.x[0].values[node].tolist(),
    }


def by_scikit_fem(cells: int, place: Path) -> Measured:
    """Solve it by Newton's method around scikit-fem's assembly."""
    import skfem
    from skfem.helpers import ddot, det, grad, identity, inv, mul, transpose

    solved = pardiso()

    def virtual_work(v: Any, w: Any) -> Any:
        deformation = grad(w["u"]) + identity(grad(w["u"]))
        volume, inverse = det(deformation), transpose(inv(deformation))
        isochoric = MU * volume ** (-2 / 3)
        stress = isochoric * (deformation - ddot(deformation, deformation) / 3 * inverse)
        return ddot(stress + KAPPA * (volume - 1) * volume * inverse, grad(v))

    def tangent(u: Any, v: Any, w: Any) -> Any:
        deformation, change = grad(w["u"]) + identity(grad(w["u"])), grad(u)
        volume, inverse = det(deformation), transpose(inv(deformation))
        growth = ddot(inverse, change)
        invariant = ddot(deformation, deformation)
        turned = mul(mul(inverse, transpose(change)), inverse)
        isochoric = MU * volume ** (-2 / 3)
        stress = isochoric * (
            change
            - 2 / 3 * growth * (deformation - invariant / 3 * inverse)
            - 2 / 3 * ddot(deformation, change) * inverse
            + invariant / 3 * turned
        )
        stress = stress + KAPPA * ((2 * volume - 1) * volume * growth * inverse - (volume - 1) * volume * turned)
        return ddot(stress, grad(v))

    forces, matrices = skfem.LinearForm(virtual_work), skfem.BilinearForm(tangent)
    side = np.linspace(0, SIDE, cells + 1)
    mesh = skfem.MeshHex.init_tensor(side, side, side)

    def solve() -> tuple[Any, Any, int]:
        basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex1()), intorder=3)
        lower, upper = (basis.get_dofs(lambda x, at=at: np.isclose(x[2], at)) for at in (0.0, SIDE))
        free, state = basis.complement_dofs(np.concatenate([lower.all(), upper.all()])), basis.zeros()
        for axis, part in enumerate(MOVE):
            state[upper.all(f"u^{axis + 1}")] = part
        moved = np.linalg.norm(state)
        # The first step begins at the unloaded body, as of the other programs.
        applied, state = state, basis.zeros()
        for count in range(1, 20):
            fields = {"u": basis.interpolate(state)}
            matrix, residual = matrices.assemble(basis, **fields), forces.assemble(basis, **fields)
            step = applied - state if count == 1 else basis.zeros()
            right = -(residual + matrix @ step)
            step[free] = solved(matrix[free][:, free].tocsr(), right[free])
            state = state + step
            if np.linalg.norm(step) < TOLERANCE * moved:
                break
        return basis, state, count

    (basis, state, count), seconds = timed(solve)
    _, assembly = timed(lambda: matrices.assemble(basis, u=basis.interpolate(state)))
    node = int(np.argmin(np.linalg.norm(mesh.p.T - INSIDE, axis=1)))
    return {
        "assembly": assembly,
        "solution": seconds,
        "iterations": count,
        "inside": state[basis.nodal_dofs[:, node]].tolist(),
    }


def by_calculix(cells: int, place: Path) -> Measured:
    """Run the deck that ``hpcinv export`` has written of hpcinv's run."""
    # Columns: number of the node, place in the unloaded body, and where the program should find it, in mm.
    nodes = np.loadtxt(place / f"{RUN}-expected.csv", delimiter=",", skiprows=1)
    node = nodes[np.argmin(np.linalg.norm(nodes[:, 1:4] / 1000 - INSIDE, axis=1))]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(["ccx", "-i", RUN], cwd=place, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    blocks = (place / f"{RUN}.dat").read_text().split(" displacements ")
    rows = [line.split() for line in blocks[-1].splitlines() if line.strip()]
    (inside,) = (row[1:] for row in rows if row[0] == str(int(node[0])))
    convergence = (place / f"{RUN}.cvg").read_text().splitlines()
    return {
        "solution": seconds,
        "whole": seconds,
        "iterations": sum(line.split()[:1] == ["1"] for line in convergence),
        "inside": [float(part) / 1000 for part in inside],
    }


def pardiso() -> Any:
    """Return a function that solves a linear system by PARDISO; an environment of ``--with`` has it elsewhere."""
    for file in metadata.files("mkl") or ():
        if file.name.startswith("libmkl_rt"):
            os.environ["PYPARDISO_MKL_RT"] = str(file.locate())
    import pypardiso

    return pypardiso.spsolve


PROGRAMS: dict[str, Callable[[int, Path], Measured]] = {
    "hpcinv": by_hpcinv,
    "felupe": by_felupe,
    "scikit-fem": by_scikit_fem,
    "CalculiX": by_calculix,
}


def measured(name: str, cells: int, place: Path) -> Measured:
    """Solve the block by a program, in a process of its own; with the processor seconds of the whole process."""
    command = [sys.executable, __file__, "--cells", str(cells), "--here", name, str(place)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | ONE_THREAD)
    if name == "hpcinv":  # the deck for CalculiX
        deck = ["export", str(place / RUN), "--deck", str(place / f"{RUN}.inp")]
        subprocess.run([sys.executable, "-m", "hpcinv", *deck], check=True, stdout=subprocess.DEVNULL)
    found: Measured = json.loads(done.stdout.splitlines()[-1])
    return found


def rows(rounds: list[dict[str, Measured]]) -> Iterator[str]:
    """Yield the rows of the table."""
    yield "| program | one tangent, s | solution, s | whole process, s | / hpcinv | iterations | distance |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    reference = np.array(rounds[0]["hpcinv"]["inside"])
    for name in PROGRAMS:
        found = [one[name] for one in rounds]
        cells = [
            f"{statistics.median(values):.2f}" if (values := [f[key] for f in found if key in f]) else ""
            for key in ("assembly", "solution", "whole")
        ]
        ratio = statistics.median(one[name]["whole"] / one["hpcinv"]["whole"] for one in rounds)
        distance = np.linalg.norm(np.array(found[0]["inside"]) - reference) / np.linalg.norm(reference)
        yield f"| {' | '.join([name, *cells, f'{ratio:.1f}', str(found[0]['iterations']), f'{distance:.1e}'])} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=24, metavar="N", help="along each edge, a multiple of 4 (24)")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="rounds, for medians (3)")
    parser.add_argument("--here", nargs=2, metavar=("PROGRAM", "PLACE"), help="one solution in this process, as JSON")
    options = parser.parse_args()
    if options.here:
        name, place = options.here
        found = PROGRAMS[name](options.cells, Path(place))
        print(json.dumps({"whole": time.process_time()} | found))
        return
    with tempfile.TemporaryDirectory() as place:
        rounds = [
            {name: measured(name, options.cells, Path(place)) for name in PROGRAMS} for _ in range(options.rounds)
        ]
    print(f"{3 * (options.cells + 1) ** 3:,} unknowns, medians of {options.rounds}", "", *rows(rounds), sep="\n")


if __name__ == "__main__":
    main()
