"""Promises of accuracy: 28 bodies that demand one, most of them with singular edges or layers, and the true errors.

Command: python benchmarks/promises.py [--bodies corner tube] [--levels 4 1 0.3]

Slabs are in plane strain, and are compared with a program of its own on graded meshes (`slabs/plane_strain.py`), tubes
and columns with closed forms, spheres with their radial equation. Levels multiply the demands.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

import hpcinv.base.parallel.runtime  # its import order first

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "benchmarks"), str(ROOT / "tests"), str(ROOT / "tests" / "verification")]

from helpers.closed_forms import root  # noqa: E402
from helpers.verification import box, job  # noqa: E402
from slabs.plane_strain import SlabProblem, solve  # noqa: E402

import hpcinv  # noqa: E402

ESTIMATE = {"round_trip": "off", "stability": False, "overlap": False, "estimate": True}
MU, LAM = 10e3, 15e3  # Pa
SLABS = {
    "corner": SlabProblem(
        "corner", MU, LAM, {"left": (0, 1)}, {"uy": (2, 0.5)}, ((0, 0), (0, 2)), {"right": (0.0, -300.0)}
    ),
    "cantilever": SlabProblem(
        "cantilever", MU, LAM, {"left": (0, 1)}, {"uy": (3, 0.5)}, ((0, 0), (0, 1)), {"right": (0.0, -60.0)}
    ),
    "slot": SlabProblem(
        "slot", MU, LAM, {"left": (0, 1)}, {"ux": (2, 0.5)}, ((0, 0), (0, 1)), {"right": (600.0, 100.0)}
    ),
    "pad": SlabProblem(
        "pad", MU, LAM, {"bonded": (0, 1)}, {"uy": (1, 0.25)}, ((0, 0), (0.5, 0)), {"right": (0.0, -100.0)}
    ),
    "window": SlabProblem(
        "window", MU, LAM, {"bottom": (0, 1)}, {"ux": (1.5, 1.5)}, ((0, 0), (1.5, 0)), {"top": (200.0, 0.0)}
    ),
    "step": SlabProblem(
        "step", MU, LAM, {"left": (0, 1)}, {"uy": (2, 0.25)}, ((0, 0), (0, 1)), {"right": (0.0, -400.0)}
    ),
    "tee": SlabProblem(
        "tee",
        MU,
        LAM,
        {"left": (0, 1), "right": (0, 1)},
        {"ux": (1, 1.5)},
        ((0, 0), (0, 0.5), (2, 0), (2, 0.5)),
        {"top": (100.0, 0.0)},
    ),
    "zed": SlabProblem(
        "zed", MU, LAM, {"left": (0, 1)}, {"uy": (1.5, 0.75)}, ((0, 0), (0, 0.5)), {"right": (100.0, -60.0)}
    ),
    "cross": SlabProblem(
        "cross", MU, LAM, {"left": (0, 1)}, {"uy": (1.5, 0.75)}, ((0, 0.5), (0, 1)), {"right": (0.0, 100.0)}
    ),
    "comb": SlabProblem(
        "comb", MU, LAM, {"bottom": (0, 1)}, {"ux": (1.5, 0.75)}, ((0, 0), (1.5, 0)), {"right": (-300.0, 0.0)}
    ),
    "block": SlabProblem(
        "block", MU, LAM, {"bottom": (0, 1)}, {"uy": (0, 1)}, ((0, 0), (1, 0)), {"top": (0.0, 1500.0)}
    ),
}
# Name, whether incompressible, whether of hexahedra, and the largest error (m) that is demanded.
DEMANDS = (
    ("corner", True, True, 2e-3),
    ("corner", False, False, 4e-3),
    ("cantilever", False, True, 8e-4),
    ("cantilever", True, False, 4e-3),
    ("slot", True, False, 2e-3),
    ("slot", False, True, 2e-3),
    ("pad", True, True, 3e-3),
    ("window", True, True, 5e-3),
    ("window", False, False, 8e-3),
    ("step", True, False, 1.2e-2),
    ("step", True, True, 8e-3),
    ("step", False, True, 2e-2),
    ("tee", True, False, 4e-3),
    ("tee", False, False, 6e-3),
    ("zed", True, True, 8e-3),
    ("zed", False, False, 1e-2),
    ("cross", True, False, 1e-2),
    ("comb", True, True, 2e-3),
    ("comb", False, False, 2e-3),
    ("block", True, True, 2e-3),
    ("block", True, False, 2e-3),
)
SPHERES = {0.5: 5.5e3, 0.7: 2e3}  # pressure (Pa) by inner radius (m)
INNER, INTERFACE, OUTER, PRESSURE, STIFF, SOFT = 0.5, 0.75, 1.0, 10e3, 100e3, 10e3  # m, Pa: of the layered tube


@dataclass(frozen=True)
class PromisedBody:
    """A job with the one quantity ``q``, and its true value."""

    name: str
    cells: str
    data: dict[str, Any]
    exact: float
    demand: float


def slab(problem: SlabProblem, *, hexahedra: bool, divisions: int = 1, displacement: int = 2) -> dict[str, Any]:
    """Return the job of a slab, with the quantity ``q``, without demands."""
    incompressible = {"law": "isochoric-neo-hookean", "mu": problem.mu, "kappa": "incompressible"}
    ((quantity, (x, y)),) = problem.points.items()
    return {
        "analysis": "forward",
        "mesh": {
            "file": "../benchmarks/slabs/slab.py",
            "parameters": {"shape": problem.shape, "n": divisions, "hexahedra": hexahedra},
        },
        "material": incompressible
        if problem.lam is None
        else {"law": "neo-hookean", "mu": problem.mu, "lam": problem.lam},
        "effects": [
            {"effect": "traction", "region": line, "traction": [*traction, 0.0], "area_in": "reference"}
            for line, traction in problem.tractions.items()
        ],
        "supports": [{"region": side, "fix": ["z"]} for side in ("z0", "z1")]
        + [{"region": line, "fix": ["xyz"[c] for c in axes]} for line, axes in problem.fixed.items()],
        "quantities": [{"name": "q", "of": quantity, "at": [x, y, 0.1]}],
        "discretisation": {"displacement": displacement},
        "certificate": ESTIMATE,
    }


def exact_of(problem: SlabProblem) -> float:
    """Return the value of the quantity of a slab by the program of its own."""
    ((quantity, _),) = problem.points.items()
    return float(solve(problem)[quantity]["xy".index(quantity[1])])


def inner_radius_at_rest() -> float:
    """Return the inner radius of the layered tube without its pressure."""
    points, weights = np.polynomial.legendre.leggauss(40)

    def carried(A: float) -> float:
        total = 0.0
        for begin, end, mu in ((INNER, INTERFACE, STIFF), (INTERFACE, OUTER, SOFT)):
            r = (begin + end) / 2 + (end - begin) / 2 * points
            stretch = r / np.sqrt(r**2 - INNER**2 + A**2)
            total += float(np.sum(weights * mu * (stretch**2 - stretch**-2) / r)) * (end - begin) / 2
        return total

    return root(lambda A: carried(A) - PRESSURE, 0.3, INNER)


def tube(*, hexahedra: bool) -> dict[str, Any]:
    """Two incompressible layers under pressure."""
    size = {"inner": INNER, "outer": OUTER, "radial": 2, "around": 4, "along": 1, "length": 0.2}
    law = {"law": "isochoric-neo-hookean", "kappa": "incompressible"}
    return {
        "analysis": "inverse",
        "mesh": {
            "file": "../meshes/thick_cylinder.py",
            "parameters": size | {"hexahedra": hexahedra},
            "geometry_degree": 2,
        },
        "regions": {"core": f"norm(x, y) < {INTERFACE + 1e-4}"},
        "material": {"core": law | {"mu": STIFF}, "elsewhere": law | {"mu": SOFT}},
        "effects": [{"effect": "pressure", "region": "inner", "pressure": PRESSURE}],
        "supports": [{"region": cut, "fix": [cut[0]]} for cut in ("x0", "y0", "z0", "z1")],
        "quantities": [{"name": "q", "of": "norm(X, Y)", "on": "inner", "reduce": "mean"}],
        "certificate": ESTIMATE,
    }


def sphere(inner: float, *, hexahedra: bool, radial: int = 2) -> dict[str, Any]:
    """A compressible octant under pressure."""
    size = {"inner": inner, "outer": OUTER, "radial": radial, "along": 2, "hexahedra": hexahedra}
    return {
        "analysis": "forward",
        "mesh": {"file": "../meshes/thick_sphere.py", "parameters": size, "geometry_degree": 2},
        "material": {"law": "neo-hookean", "mu": MU, "lam": LAM},
        "effects": [{"effect": "pressure", "region": "inner", "pressure": SPHERES[inner]}],
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        "quantities": [{"name": "q", "of": "norm(x, y, z)", "on": "inner", "reduce": "mean"}],
        "certificate": ESTIMATE,
    }


def inner_radius_under_pressure(inner: float) -> float:
    """Return the inner radius of a sphere by its equation ``P_rr' = 2 (P_θθ - P_rr) / R``."""

    def hoop(radial: Any, along: Any) -> Any:
        return MU * (along - 1 / along) + LAM * np.log(radial * along**2) / along

    def rates(R: Any, state: Any) -> Any:
        (r, stress), radial = state, np.ones_like(R)
        along = r / R
        for _ in range(60):
            volume = np.log(radial * along**2)
            slope = MU * (1 + radial**-2) + LAM * (1 - volume) / radial**2
            radial = radial - (MU * (radial - 1 / radial) + LAM * volume / radial - stress) / slope
        return np.vstack([radial, 2 * (hoop(radial, along) - stress) / R])

    def ends(first: Any, last: Any) -> Any:
        return np.array([first[1] + SPHERES[inner] * (first[0] / inner) ** 2, last[1]])

    R = np.linspace(inner, OUTER, 40)
    solved = solve_bvp(rates, ends, R, np.vstack([1.1 * R, -0.1 * MU * (OUTER - R)]), tol=1e-10, max_nodes=100_000)
    return float(solved.y[0, 0])


def column() -> dict[str, Any]:
    """A smooth one: the length at rest of a confined column under its weight."""
    return {
        "mesh": box((1, 1, 2), lx="0.2 m", ly="0.2 m"),
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "current"}],
        "supports": [{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        "quantities": [{"name": "q", "of": "Z", "at": [0.1, 0.1, 1.0]}],
        "certificate": ESTIMATE,
    }


def bodies(names: list[str]) -> Iterator[PromisedBody]:
    for name, is_incompressible, hexahedra, demand in DEMANDS:
        if name in names:
            problem = replace(SLABS[name], lam=None if is_incompressible else LAM)
            cells = ("hexahedra" if hexahedra else "tetrahedra") + (", incompressible" if is_incompressible else "")
            yield PromisedBody(name, cells, slab(problem, hexahedra=hexahedra), exact_of(problem), demand)
    if "layered tube" in names:
        for cells, hexahedra in (("hexahedra", True), ("tetrahedra", False)):
            yield PromisedBody(
                "layered tube", f"{cells}, incompressible", tube(hexahedra=hexahedra), inner_radius_at_rest(), 2e-3
            )
    for inner in SPHERES if "sphere" in names else ():
        for cells, hexahedra in (("hexahedra", True), ("tetrahedra", False)):
            exact = inner_radius_under_pressure(inner)
            yield PromisedBody(f"sphere from {inner} m", cells, sphere(inner, hexahedra=hexahedra), exact, 1e-3)
    if "column" in names:
        yield PromisedBody("column", "tetrahedra", column(), 1.080279882353, 1e-6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = [*SLABS, "layered tube", "sphere", "column"]
    parser.add_argument("--bodies", nargs="+", choices=known, default=known)
    parser.add_argument("--unknowns", type=int, default=40_000, help="largest number of unknowns")
    parser.add_argument("--levels", nargs="+", type=float, default=[1.0])
    options, kept = parser.parse_args(), []
    print("| body | cells | demand | promised | true error | kept | steps | unknowns |")
    print("|---|---|---|---|---|---|---|---|")
    for body in bodies(options.bodies):
        for level in options.levels:
            kept.append(is_kept(body, level * body.demand, options.unknowns))
    print(f"\n{sum(kept)} of {len(kept)} promises kept")


def is_kept(body: PromisedBody, demand: float, most: int) -> bool:
    """Print a line on a search; return whether its promise holds, also where it is not what was demanded."""
    result = hpcinv.run(job(**body.data, accuracy={"q": demand}, solver={"maximum_unknowns": most}), progress=False)
    record, true = result.accuracy, abs(result.quantities["q"] - body.exact)
    assert record is not None
    bound, row = record.bounds["q"], record.rows[record.chosen]
    holds = true <= bound and (bound <= demand) == (record.ending.name == "MET")
    how = ("yes" if bound <= demand else "yes, not met") if holds else "NO"
    print(
        f"| {body.name} | {body.cells} | {demand:.1e} | {bound:.1e} | {true:.1e} |"
        f" {how} | {len(record.rows)} to degree {row.degree} | {row.unknowns} |",
        flush=True,
    )
    return holds


if __name__ == "__main__":
    main()
