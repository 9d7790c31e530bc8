"""What Newton's method and the continuation take: the measuring set of docs/theory/newton.md, counted, not timed.

Every case is solved from the unloaded body. Counted are factorizations, Newton iterations, and solves that failed; the
last columns are the largest difference from the displacements of an earlier run, and seconds of processor time.

Constants of the method can be given other values, and left out by infinite ones; `--second-order` adds a term of second
order to the predictor, where that turns and stretches the body by no more than a number.

Command: mpirun -n 1 python benchmarks/newton.py [cases …] [--answers FILE]
[--with NewtonMonitor.close_correction=0.1 …]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import parse
from hpcinv.output.result import Result
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.load_stepping import AdaptiveSteps
from hpcinv.solver.mip_newton import ExtrapolatedStress
from hpcinv.solver.newton import NewtonMonitor
from hpcinv.solver.predictor import Prediction, Predictor
from hpcinv.solver.workspace import Workspace, collect_garbage

MESHES = Path(__file__).parents[1] / "meshes"
SILICONE = {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8}
CLAMPED = [{"region": "x0", "fix": ["x", "y", "z"]}]
SYMMETRIC = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
NO_CERTIFICATE = "off"
BOTH = ("inverse", "forward")


def mesh(name: str, *, geometry_degree: int = 2, **parameters: Any) -> dict[str, Any]:
    return {"file": str(MESHES / name), "parameters": parameters, "geometry_degree": geometry_degree}


def weight(size: float, density: float = 963.0, axis: int = 1) -> list[dict[str, Any]]:
    acceleration = [-9.81 * size if i == axis else 0.0 for i in range(3)]
    return [{"effect": "gravity", "acceleration": acceleration, "density": density}]


def cases() -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and jobs; those that share kernels follow each other."""
    beam: dict[str, Any] = {"mesh": mesh("pdms_beam.py", size="4 mm"), "material": SILICONE}
    beam["supports"] = [{"region": "clamp", "fix": ["x", "y", "z"]}]
    for size in (1, 2, 4):
        yield f"beam, weight ×{size}", {"analysis": "inverse", **beam, "effects": weight(size)}
    sagging = {"file": str(MESHES / "pdms-beam-sagging.msh")}
    yield "sagging beam", {"analysis": "inverse", **beam, "mesh": sagging, "effects": weight(1)}
    for size in (1, 2, 4, 8):
        yield f"beam, weight ×{size}", {"analysis": "forward", **beam, "effects": weight(size)}
    yield "standing beam", {"analysis": "inverse", **beam, "effects": weight(1, axis=0)}
    stiff = {**beam, "material": {**SILICONE, "d1": 2.5e10}, "discretisation": {"formulation": "displacement"}}
    yield "beam, d1 ×30, displacement form", {"analysis": "forward", **stiff, "effects": weight(1)}

    slender: dict[str, Any] = {
        "mesh": mesh("box.py", lx="200 mm", ly="1 mm", lz="1 mm", nx=40, ny=1, nz=1, hexahedra=True),
        "material": {"law": "mooney-rivlin", "c1": "25 kPa", "c2": "25 kPa", "d1": "incompressible"},
        "supports": CLAMPED,
    }
    for analysis in BOTH:
        for share in (0.5, 1):
            effects = weight(share, density=2.64398573)
            yield f"beam 200:1, weight ×{share:g}", {"analysis": analysis, **slender, "effects": effects}

    sphere = {
        "mesh": mesh("thick_sphere.py", inner=1, outer=1.5, radial=2, along=2, hexahedra=True),
        "material": {"law": "isochoric-neo-hookean", "mu": 1, "kappa": "incompressible"},
        "supports": SYMMETRIC,
    }
    for pressure, analysis in ((0.2, "inverse"), (1.5, "inverse"), (0.2, "forward"), (0.37, "forward")):
        effects = [{"effect": "pressure", "region": "inner", "pressure": pressure}]
        yield f"sphere, pressure {pressure:g} mu", {"analysis": analysis, **sphere, "effects": effects}

    block = mesh("box.py", geometry_degree=1, nx=3, ny=3, nz=3)
    soft = {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}
    laws = {
        "compressible": soft,
        "nearly incompressible": {"law": "neo-hookean", "mu": "10 kPa", "lam": "10 MPa"},
    }
    held = {"region": "z0", "fix": ["x", "y", "z"]}
    motions = {
        "shear by 1": ["lx", 0, 0],
        "shear by 2": ["2*lx", 0, 0],
        "turned by 60°": turned(60),
        "turned by 150°": turned(150),
        "squeezed to 1/2": [0, 0, "-0.5*lx"],
        "stretched to 1.6": [0, 0, "0.6*lx"],
    }
    for kind, law in laws.items():
        for name, displacement in motions.items():
            supports = [held, {"region": "z1", "displacement": displacement, "constants": {"lx": "1 m"}}]
            data = {"analysis": "forward", "mesh": block, "material": law, "supports": supports}
            yield f"block, {kind}, {name}", data
    for analysis, size in (("inverse", 3), ("inverse", 6), ("forward", 1), ("forward", 2)):
        data = {
            "analysis": analysis,
            "mesh": block,
            "material": soft,
            "supports": [held],
            "effects": weight(size, axis=2),
        }
        yield f"block, compressible, weight ×{size:g}", data

    bar = mesh("box.py", geometry_degree=1, nx=4, ny=2, nz=2, lx=2)
    gent: dict[str, Any] = {"law": "gent", "mu": "10 kPa", "jm": 2.0, "kappa": "incompressible"}
    ogden: dict[str, Any] = {
        "law": "ogden",
        "mu": ["6.3 kPa", "12 Pa", "-100 Pa"],
        "alpha": [1.3, 5, -2],
        "kappa": "20 kPa",
    }
    for name, law in (("Gent", gent), ("Ogden", ogden)):
        for analysis in BOTH:
            for pull in (10, 40):
                traction = [f"{pull} kPa" if name == "Gent" else f"{pull / 5} kPa", 0, 0]
                effects = [{"effect": "traction", "region": "x1", "traction": traction, "area_in": "reference"}]
                data = {"analysis": analysis, "mesh": bar, "material": law, "supports": CLAMPED, "effects": effects}
                yield f"bar, {name}, traction {traction[0]}", data


def turned(degrees: float) -> list[Any]:
    """Displacement of the top, turned about its centre."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    x, y = "(x - 0.5*lx)", "(y - 0.5*lx)"
    return [f"{c - 1}*{x} - {s}*{y}", f"{s}*{x} + {c - 1}*{y}", 0]


CONSTANTS = {"AdaptiveSteps": AdaptiveSteps, "ExtrapolatedStress": ExtrapolatedStress, "NewtonMonitor": NewtonMonitor}


def change(constant: str) -> None:
    """Give a constant of the method another value."""
    name, value = constant.split("=")
    owner, attribute = name.split(".")
    assert hasattr(CONSTANTS[owner], attribute), constant
    setattr(CONSTANTS[owner], attribute, float(value))


def add_second_order(farthest: float) -> None:
    """Let predictions follow ``x + ẋ h + ẍ h²/2``, with ẍ from R(x + ε ẋ h) and the same factors."""
    first_order, share = Predictor.predict, 0.1

    def predict(self: Predictor, load: float, numbers: BorderedSolver, *, new_tangent: bool = False) -> Prediction:
        system = self.system
        start = system.position()
        prediction = first_order(self, load, numbers, new_tangent=new_tangent)
        if not prediction.is_taken or max(prediction.increment.rotation, prediction.increment.strain) > farthest:
            return prediction
        end, first, middle = system.position(), system.rhs.duplicate(), start.copy()
        system.set_state(start)
        system.residual(first)
        middle.axpby(share, 1 - share, end)
        system.set_state(middle)
        system.residual(system.rhs)
        system.rhs.axpy(share - 1, first)  # what is left is of second order
        self.linear.ksp.solve(system.rhs, middle)
        end.axpy(-1 / share**2, middle)
        system.set_state(end)
        return prediction

    Predictor.predict = predict  # type: ignore[method-assign]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help="parts of names; left out, all cases")
    parser.add_argument("--answers", type=Path, help="shapes of an earlier run to compare with; written if not there")
    parser.add_argument("--with", dest="constants", nargs="*", default=[], help="other values of constants")
    parser.add_argument("--second-order", type=float, metavar="FARTHEST", help="a predictor of second order")
    options = parser.parse_args()
    for constant in options.constants:
        change(constant)
    if options.second_order is not None:
        add_second_order(options.second_order)
    comm = MPI.COMM_WORLD
    earlier = dict(np.load(options.answers)) if options.answers and options.answers.exists() else {}
    shapes, total = dict[str, Any](), np.zeros(4, dtype=int)
    begin = time.process_time()
    say(comm, "| case | factorizations | iterations | failed solves | solves |")
    say(comm, "|---|---|---|---|---|")
    with Workspace(comm) as workspace:
        for name, data in cases():
            label = f"{data['analysis']}, {name}"
            if options.cases and not any(part in label for part in options.cases):
                continue
            started = time.process_time()
            counts, shape = effort(data, comm, workspace)
            total += counts
            seconds = time.process_time() - started
            gap = difference(shape, earlier.get(label), comm)
            say(comm, f"| {label} | {' | '.join(map(str, counts))} |{gap} {seconds:.1f} s")
            shapes[label] = shape
    say(comm, f"| all | {' | '.join(map(str, total))} |")
    say(comm, f"CPU time {time.process_time() - begin:.0f} s")
    if options.answers and not earlier and comm.size == 1:
        np.savez(options.answers, **shapes)


def effort(data: Mapping[str, Any], comm: MPI.Intracomm, workspace: Workspace) -> tuple[list[int], Any]:
    """Factorizations, iterations, failed solves and all solves, and the displacement; of the first solution."""
    job = parse({"certificate": NO_CERTIFICATE, **data}, Path(__file__))
    try:
        result: Result = hpcinv.run(job, comm, workspace=workspace, progress=False)
    except hpcinv.errors.SolveError as error:
        say(comm, str(error))
        return [0, 0, 0, 0], np.zeros(0)
    solves = result.solutions[0].solves
    failed = sum(not s.outcome.accepted for s in solves)
    iterations = sum(len(s.iterations) for s in solves)
    counts = [result.solutions[0].factorizations, iterations, failed, len(solves)]
    collect_garbage(comm)
    return counts, result.solutions[0].u.copy()


def difference(shape: Any, earlier: Any, comm: MPI.Intracomm) -> str:
    if earlier is None or comm.size > 1:
        return ""
    if shape.shape != earlier.shape or not shape.size:
        return " DIFFERENT"
    return f" {np.abs(shape - earlier).max() / np.abs(earlier).max():.1e}"


def say(comm: MPI.Intracomm, line: str) -> None:
    if comm.rank == 0:
        print(line, flush=True)


if __name__ == "__main__":
    main()
