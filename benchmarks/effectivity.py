"""How right the error estimate is: estimated over true error of bodies whose solution is known.

Command: python benchmarks/effectivity.py [--divisions 2 4] [--displacement 2 3]
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hpcinv.parallel.runtime  # its import order first

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "verification")]

import test_thick_cylinder as cylinder  # noqa: E402
import test_thick_sphere as sphere  # noqa: E402
from helpers.closed_forms import root  # noqa: E402
from helpers.verification import box, job  # noqa: E402

import hpcinv  # noqa: E402

ESTIMATE = {"round_trip": "off", "stability": False, "overlap": False, "estimate": True}
CELLS = {"tetrahedra": False, "hexahedra": True}


def wall_of_sphere(
    divisions: int, geometry: int, displacement: int, *, hexahedra: bool
) -> tuple[Any, dict[str, float]]:
    A = root(lambda A: sphere.carried(A, 0.5, 0.0) - sphere.PRESSURE, 0.5, 1.0)
    size = {"inner": sphere.INNER, "outer": sphere.OUTER, "radial": divisions, "along": divisions}
    data = job(
        mesh={
            "file": "../meshes/thick_sphere.py",
            "parameters": size | {"hexahedra": hexahedra},
            "geometry_degree": geometry,
        },
        material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": sphere.PRESSURE}],
        supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        quantities=[
            {"name": "inner-radius", "of": "norm(X, Y, Z)", "on": "inner", "reduce": "mean"},
            {"name": "outer-radius", "of": "norm(X, Y, Z)", "on": "outer", "reduce": "mean"},
            {"name": "volume", "of": 1, "on": "wall", "reduce": "integral", "over": "reference"},
        ],
        discretisation={"displacement": displacement, "pressure": displacement - 1},
        certificate=ESTIMATE,
    )
    volume = math.pi / 6 * (sphere.OUTER**3 - sphere.INNER**3)
    return data, {"inner-radius": A, "outer-radius": sphere.before(A), "volume": volume}


def wall_of_cylinder(
    divisions: int, geometry: int, displacement: int, *, hexahedra: bool
) -> tuple[Any, dict[str, float]]:
    size = {"inner": cylinder.INNER, "outer": cylinder.OUTER, "radial": divisions, "around": 2 * divisions}
    data = job(
        mesh={
            "file": "../meshes/thick_cylinder.py",
            "parameters": size | {"along": 1, "length": 0.5 / divisions, "hexahedra": hexahedra},
            "geometry_degree": geometry,
        },
        material={"law": "neo-hookean", "mu": 1.0, "lam": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": cylinder.PRESSURE}],
        supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"] + [{"region": "z1", "fix": ["z"]}],
        quantities=[
            {"name": "inner-radius", "of": "norm(X, Y)", "on": "inner", "reduce": "mean"},
            {"name": "outer-radius", "of": "norm(X, Y)", "on": "outer", "reduce": "mean"},
        ],
        discretisation={"displacement": displacement, "pressure": displacement - 1},
        certificate=ESTIMATE,
    )
    return data, {"inner-radius": cylinder.A, "outer-radius": cylinder.B}


def column(divisions: int, displacement: int, *, hexahedra: bool) -> tuple[Any, dict[str, float]]:
    data = job(
        mesh=box((1, 1, divisions), lx="0.2 m", ly="0.2 m", hexahedra=hexahedra),
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "current"}],
        supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        quantities=[{"name": "length", "of": "Z", "on": "z1", "reduce": "mean"}],
        discretisation={"displacement": displacement},
        certificate=ESTIMATE,
    )
    return data, {"length": 1.080279882353}


def beam(size: str, geometry: int, certificate: dict[str, Any], displacement: int = 2) -> Any:
    return job(
        analysis="forward",
        mesh={"file": "../meshes/pdms_beam.py", "parameters": {"size": size}, "geometry_degree": geometry},
        material={"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8},
        effects=[{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 963}],
        supports=[{"region": "clamp", "fix": ["x", "y", "z"]}],
        quantities=[{"name": "tip", "of": "norm(ux, uy, uz)", "at": [0.182, 0, 0]}],
        discretisation={"displacement": displacement},
        certificate=certificate,
    )


def cases(divisions: list[int], degrees: list[int]) -> Iterator[tuple[str, Any, dict[str, float]]]:
    for name, wall in (("sphere", wall_of_sphere), ("cylinder", wall_of_cylinder)):
        for geometry, shape in ((1, "straight"), (2, "curved")):
            for cells, hexahedra in CELLS.items():
                for degree in degrees:
                    for n in divisions:
                        found = wall(n, geometry, degree, hexahedra=hexahedra)
                        yield f"{name} | {shape} {cells} | {degree} | {n}", *found
    for cells, hexahedra in CELLS.items():
        for degree in degrees:
            for n in divisions:
                yield f"column | {cells} | {degree} | {n}", *column(n, degree, hexahedra=hexahedra)
    without = ESTIMATE | {"estimate": False}
    exact = {"tip": hpcinv.run(beam("3 mm", 2, without, 3)).quantities["tip"]}
    for geometry, shape in ((1, "straight"), (2, "curved")):
        for size in ("4 mm", "3 mm"):
            yield f"beam | {shape} tetrahedra | 2 | {size}", beam(size, geometry, ESTIMATE), exact


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--divisions", type=int, nargs="+", default=[2, 4])
    parser.add_argument("--displacement", type=int, nargs="+", default=[2, 3])
    options = parser.parse_args()
    print("| body | cells | degree | divisions | quantity | true error | estimated | effectivity |")
    print("|---|---|---|---|---|---|---|---|")
    for name, data, exact in cases(options.divisions, options.displacement):
        found = hpcinv.run(data)
        assert found.estimate is not None
        for quantity, value in exact.items():
            true, estimated = value - found.quantities[quantity], found.estimate.quantities[quantity]
            left_out = " (without geometry)" if found.estimate.without_geometry else ""
            print(
                f"| {name} | {quantity} | {true:.1e} | {estimated:.1e}{left_out} | {estimated / true:.2f} |", flush=True
            )


if __name__ == "__main__":
    main()
