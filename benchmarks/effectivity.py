"""How right the error estimate is: estimated over true error of bodies whose solution is known.

Command: python benchmarks/effectivity.py [--divisions 2 4] [--displacement 2 3] [--bodies sphere bar]

Slabs with singular edges (corner, cantilever, slot, pad, window; not by default) are compared with graded meshes of a
program of its own (`slabs/plane_strain.py`). Degree 1 is for bodies whose pressure is not an unknown: column, bars and
patch. Shells (not by default) are compared with closed forms or a fine mesh, where the largest displacement of a node
is compared too; their divisions are cells along the first axis. Errors below 1e-8 of the value come from Newton's
method, and have no effectivity.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv.base.parallel.runtime  # its import order first

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "benchmarks"), str(ROOT / "tests"), str(ROOT / "tests" / "verification")]

import test_fibres as fibres  # noqa: E402
import test_layers as layers  # noqa: E402
import test_material_regions as regions  # noqa: E402
from helpers import rotating_bar as rotating  # noqa: E402
from helpers import thick_cylinder as cylinder  # noqa: E402
from helpers import thick_sphere as sphere  # noqa: E402
from helpers.closed_forms import NEO_HOOKEAN, root  # noqa: E402
from helpers.verification import box, job  # noqa: E402
from promises import LAM, SLABS, exact_of, slab  # noqa: E402
from scipy.spatial import cKDTree  # noqa: E402
from shell_scenes import SCENES, Scene  # noqa: E402

import hpcinv  # noqa: E402

ESTIMATE = {"round_trip": "off", "stability": False, "overlap": False, "estimate": True}
CELLS = {"tetrahedra": False, "hexahedra": True}
RESOLVED = 1e-8  # of a value: error from which it is one of the discretisation

type Case = tuple[Any, dict[str, float]]


def wall_of_sphere(divisions: int, geometry: int, displacement: int, *, hexahedra: bool) -> Case:
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
    return data, {"inner-radius": A, "outer-radius": sphere.outer_radius(A), "volume": volume}


def layered_sphere(divisions: int, geometry: int, displacement: int, *, hexahedra: bool) -> Case:
    """Two incompressible layers with different moduli."""
    return layers_of_sphere(layers.radii(), divisions, geometry, displacement, hexahedra=hexahedra)


def grown_layers(divisions: int, geometry: int, displacement: int, *, hexahedra: bool) -> Case:
    """Two layers of one incompressible material: one grows, the other shrinks."""
    pressure = {"effect": "pressure", "region": "inner", "pressure": layers.PRESSURE}
    changes = {
        "material": layers.law(50e3),
        "effects": [pressure, {"effect": "growth", "stretch": layers.GROWN}],
    }
    exact = layers.radii(layers.GROWN, dict.fromkeys(layers.MU, 50e3))
    return layers_of_sphere(exact, divisions, geometry, displacement, hexahedra=hexahedra, **changes)


def layers_of_sphere(
    exact: dict[str, float], divisions: int, geometry: int, displacement: int, *, hexahedra: bool, **changes: Any
) -> Case:
    data = layers.wall(divisions, hexahedra=hexahedra, geometry=geometry, **changes)
    spaces = data.discretisation.model_copy(update={"displacement": displacement})
    return data.model_copy(update={"discretisation": spaces}), exact


def plane_strain(
    divisions: int, geometry: int, displacement: int, *, hexahedra: bool, length: float, **changes: Any
) -> Any:
    """A quarter of a thick cylinder that keeps its length."""
    size = {"inner": cylinder.INNER, "outer": cylinder.OUTER, "radial": divisions, "around": 2 * divisions}
    return job(
        mesh={
            "file": "../meshes/thick_cylinder.py",
            "parameters": {**size, "along": 1, "length": length, "hexahedra": hexahedra, **changes.pop("size", {})},
            "geometry_degree": geometry,
        },
        supports=[{"region": cut, "fix": [cut[0]]} for cut in ("x0", "y0", "z0", "z1")],
        quantities=[
            {"name": "inner-radius", "of": "norm(X, Y)", "on": "inner", "reduce": "mean"},
            {"name": "outer-radius", "of": "norm(X, Y)", "on": "outer", "reduce": "mean"},
        ],
        discretisation={"displacement": displacement, "pressure": displacement - 1},
        certificate=ESTIMATE,
        **changes,
    )


def cylinder_under(effect: dict[str, Any], divisions: int, geometry: int, displacement: int, hexahedra: bool) -> Case:
    data = plane_strain(
        divisions,
        geometry,
        displacement,
        hexahedra=hexahedra,
        length=0.5 / divisions,
        material={"law": "neo-hookean", "mu": 1.0, "lam": "incompressible"},
        effects=[effect],
    )
    return data, {"inner-radius": cylinder.A, "outer-radius": cylinder.B}


def wall_of_cylinder(divisions: int, geometry: int, displacement: int, *, hexahedra: bool) -> Case:
    effect = {"effect": "pressure", "region": "inner", "pressure": cylinder.PRESSURE}
    return cylinder_under(effect, divisions, geometry, displacement, hexahedra)


def rotating_disk(divisions: int, geometry: int, displacement: int, *, hexahedra: bool) -> Case:
    """By the balance of forces, it has the radii of a cylinder under the pressure ``rho ω² (b² - a²)/2``."""
    density = 2 * cylinder.PRESSURE / (cylinder.OUTER**2 - cylinder.INNER**2)
    effect = {"effect": "centrifugal", "angular_velocity": 1.0, "axis": [0, 0, 1], "density": density}
    return cylinder_under(effect, divisions, geometry, displacement, hexahedra)


def tube_with_fibres(divisions: int, geometry: int, displacement: int, *, hexahedra: bool) -> Case:
    tube = fibres.Tube("inverse", "current")
    data = plane_strain(
        divisions,
        geometry,
        displacement,
        hexahedra=hexahedra,
        length=0.1,
        size={"inner": tube.inner, "outer": tube.outer},
        fibres=fibres.helices(tube.given_on, tube.angle),
        material={"law": "holzapfel-gasser-ogden", "kappa": "incompressible"}
        | {name: getattr(tube, name) for name in ("mu", "k1", "k2", "dispersion")},
        effects=[{"effect": "pressure", "region": "inner", "pressure": tube.pressure}],
    )
    return data, {"inner-radius": float(tube.other(tube.inner)), "outer-radius": float(tube.other(tube.outer))}


def confined(cells: int, displacement: int, *, hexahedra: bool, **changes: Any) -> Any:
    """A bar along z that cannot move sideways."""
    data: dict[str, Any] = {
        "mesh": box((1, 1, cells), lx="0.2 m", ly="0.2 m", hexahedra=hexahedra),
        "supports": [{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        "quantities": [{"name": "length", "of": "Z", "on": "z1", "reduce": "mean"}],
        "discretisation": {"displacement": displacement, "formulation": "displacement"},
        "certificate": ESTIMATE,
    }
    return job(**data | changes)


def column(divisions: int, displacement: int, *, hexahedra: bool) -> Case:
    data = confined(
        divisions,
        displacement,
        hexahedra=hexahedra,
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "current"}],
    )
    return data, {"length": 1.080279882353}


def rotating_bar(divisions: int, displacement: int, *, hexahedra: bool) -> Case:
    """It is thin, since forces across it move the nodes inside, which the closed form does not have."""
    width = 0.002  # m
    load = {"angular_velocity": rotating.SPIN, "axis": [0, 1, 0], "density": rotating.DENSITY}
    data = confined(
        divisions,
        displacement,
        hexahedra=hexahedra,
        material=NEO_HOOKEAN,
        mesh=box((1, 1, divisions), lx=width, ly=width, hexahedra=hexahedra),
        effects=[{"effect": "centrifugal", "density_in": "reference", "centre": [width / 2, 0, 0], **load}],
    )
    return data, {"length": rotating.rest_length(rotating.LENGTH, "reference")}


def graded_bar(divisions: int, displacement: int, *, hexahedra: bool) -> Case:
    data = confined(
        divisions,
        displacement,
        hexahedra=hexahedra,
        material={"law": "neo-hookean", **{name: formula.format("z") for name, formula in regions.GRADED.items()}},
        effects=[regions.pull()],
    )
    return data, {"length": float(regions.integral(lambda z: 1 / regions.stretch_at(z), 1.0))}


def patch(divisions: int, displacement: int, *, hexahedra: bool) -> Case:
    """A uniform stretch, which all spaces contain."""
    data = confined(divisions, displacement, hexahedra=hexahedra, material=NEO_HOOKEAN, effects=[regions.pull()])
    return data, {"length": 1 / root(lambda stretch: regions.neo_hookean(stretch) - regions.END, 1.0, 3.0)}


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


WALLS = {
    "sphere": wall_of_sphere,
    "layered sphere": layered_sphere,
    "grown layers": grown_layers,
    "cylinder": wall_of_cylinder,
    "rotating disk": rotating_disk,
    "tube with fibres": tube_with_fibres,
}
BARS = {"column": column, "rotating bar": rotating_bar, "graded bar": graded_bar, "patch": patch}


def cases(bodies: list[str], divisions: list[int], degrees: list[int]) -> Iterator[tuple[str, Any, dict[str, float]]]:
    for name in (name for name in WALLS if name in bodies):
        for geometry, shape in ((1, "straight"), (2, "curved")):
            for cells, hexahedra in CELLS.items():
                for degree in (degree for degree in degrees if degree > 1):
                    for n in divisions:
                        wall_case = WALLS[name](n, geometry, degree, hexahedra=hexahedra)
                        yield f"{name} | {shape} {cells} | {degree} | {n}", *wall_case
    for name in (name for name in BARS if name in bodies):
        for cells, hexahedra in CELLS.items():
            for degree in degrees:
                for n in divisions:
                    yield f"{name} | {cells} | {degree} | {n}", *BARS[name](n, degree, hexahedra=hexahedra)
    for name in (name for name in SLABS if name in bodies):
        for text, lam in (("compressible", LAM), ("incompressible", None)):
            problem = replace(SLABS[name], lam=lam)
            exact = {"q": exact_of(problem)}
            for cells, hexahedra in CELLS.items():
                for degree in (degree for degree in degrees if degree > 1):
                    for n in divisions:
                        data = job(**slab(problem, hexahedra=hexahedra, divisions=n, displacement=degree))
                        yield f"{name}, {text} | {cells} | {degree} | {n}", data, exact
    if "beam" in bodies and 2 in degrees:
        no_estimate = ESTIMATE | {"estimate": False}
        exact = {"tip": hpcinv.run(beam("3 mm", 2, no_estimate, 3), progress=False).quantities["tip"]}
        for geometry, shape in ((1, "straight"), (2, "curved")):
            for size in ("4 mm", "3 mm"):
                yield f"beam | {shape} tetrahedra | 2 | {size}", beam(size, geometry, ESTIMATE), exact


def shell_rows(name: str, scene: Scene, divisions: list[int], finest: int) -> Iterator[str]:
    """Yield rows of a shell, whose error is the difference from a closed form or from a fine mesh."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shell.msh"

        def solved(n: int, **certificate: Any) -> Any:
            scene.save(path, n)
            return hpcinv.run(scene.as_job(path) | {"certificate": ESTIMATE | certificate}, progress=False)

        fine = solved(finest, estimate=False)
        nodes = cKDTree(fine.solutions[0].mesh_nodes)
        for n in divisions:
            result = solved(n)
            solution, estimate = result.solutions[0], result.estimate
            distance, nearest = nodes.query(solution.mesh_nodes)
            is_common = distance < 0.1 * float(scene.shell["thickness"])
            offsets = (fine.solutions[0].u[nearest] - solution.u)[is_common]
            value, exact = result.quantities["q"], scene.exact.get("q", fine.quantities["q"])
            pairs = {"q": (exact - value, estimate.quantities["q"], abs(exact))}
            largest = float(np.linalg.norm(offsets, axis=1).max())
            pairs["largest"] = largest, estimate.shape, solution.largest_displacement
            for quantity, (true, estimated, scale) in pairs.items():
                ratio = f"{estimated / true:.2f}" if math.isfinite(estimated) else "not decided"
                yield f"| {name} | {n} | {quantity} | {true / scale:.1e} | {estimated / scale:.1e} | {ratio} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--divisions", type=int, nargs="+", default=[2, 4])
    parser.add_argument("--displacement", type=int, nargs="+", default=[2, 3])
    bodies = [*WALLS, *BARS, "beam"]
    parser.add_argument("--bodies", nargs="+", choices=[*bodies, *SLABS, "shells"], default=bodies)
    parser.add_argument("--finest", type=int, default=32, help="cells of the fine mesh of a shell (default 32)")
    options = parser.parse_args()
    if "shells" in options.bodies:
        print("| shell | cells | quantity | true error, relative | estimated | effectivity |")
        print("|---|---|---|---|---|---|")
        for name, scene in SCENES.items():
            for row in shell_rows(name, scene, options.divisions, options.finest):
                print(row, flush=True)
        return
    print("| body | cells | degree | divisions | quantity | true error | estimated | effectivity |")
    print("|---|---|---|---|---|---|---|---|")
    for name, data, exact in cases(options.bodies, options.divisions, options.displacement):
        result = hpcinv.run(data, progress=False)
        assert result.estimate is not None
        for quantity, value in exact.items():
            true, estimated = value - result.quantities[quantity], result.estimate.quantities[quantity]
            left_out = " (without geometry)" if result.estimate.without_geometry else ""
            if result.estimate.limit and not result.estimate.limit.is_reliable:
                left_out += " (not reliable here)"
            effectivity = f"{estimated / true:.2f}" if abs(true) > RESOLVED * abs(value) else "–"
            print(f"| {name} | {quantity} | {true:.1e} | {estimated:.1e}{left_out} | {effectivity} |", flush=True)


if __name__ == "__main__":
    main()
