"""Twenty jobs that demand an accuracy, of quantities whose values are known from closed forms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import log, pi
from typing import Any

import numpy as np

from helpers import rotating_bar as bar
from helpers import thick_cylinder as cylinder
from helpers import thick_sphere as sphere
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, root
from helpers.verification import box, job
from hpcinv.job.job import Job

DENSITY, GRAVITY = 1000.0, 9.81
C1, C2, K = 1.0e5, 1.5e5, 0.3
WIDTH = 1e-3  # m: of a bar so thin that the forces across it hardly move it


@dataclass(frozen=True)
class Case:
    """A job with the one quantity ``q``, its exact value, and the largest error (SI) that is demanded."""

    name: str
    data: dict[str, Any]
    quantity: dict[str, Any]
    exact: float
    demand: float

    def job(self, **changes: Any) -> Job:
        quantities = [{"name": "q", **self.quantity}]
        return job(**(self.data | {"quantities": quantities, "accuracy": {"q": self.demand}} | changes))


def spheres() -> Iterator[Case]:
    def wall(pressure: float, divisions: int = 2, *, c2: float = 0.0, degree: int = 2, **mesh: Any) -> dict[str, Any]:
        parameters = {"inner": 1.0, "outer": 1.5, "radial": divisions, "along": divisions, **mesh}
        return {
            "mesh": {"file": "../meshes/thick_sphere.py", "parameters": parameters, "geometry_degree": degree},
            "material": {"law": "mooney-rivlin", "c1": 0.5 - c2, "c2": c2, "d1": "incompressible"},
            "effects": [{"effect": "pressure", "region": "inner", "pressure": pressure}],
            "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        }

    def inner(pressure: float, c2: float = 0.0) -> float:
        return root(lambda A: sphere.carried(A, 0.5 - c2, c2) - pressure, 0.3, 1.0)

    radius = {"of": "norm(X, Y, Z)", "reduce": "mean"}
    yield Case("sphere", wall(0.2, hexahedra=True), radius | {"on": "inner"}, inner(0.2), 1e-3)
    outer = sphere.outer_radius(inner(0.2))
    yield Case("sphere, finer", wall(0.2, hexahedra=True), radius | {"on": "outer"}, outer, 1e-5)
    yield Case(
        "sphere, Mooney–Rivlin, at a point",
        wall(0.2, c2=0.1, hexahedra=True),
        {"of": "X", "at": [1.0, 0.0, 0.0]},
        inner(0.2, 0.1),
        1e-4,
    )
    yield Case("sphere of tetrahedra", wall(0.3), radius | {"on": "inner", "over": "current"}, inner(0.3), 3e-4)
    yield Case("sphere of straight tetrahedra", wall(0.1, degree=1), radius | {"on": "inner"}, inner(0.1), 5e-3)
    yield Case(
        "volume of the sphere's wall",
        wall(0.5, hexahedra=True),
        {"of": 1, "on": "wall", "reduce": "integral", "over": "reference"},
        pi / 6 * (1.5**3 - 1),
        1e-3,
    )


def cylinders() -> Iterator[Case]:
    def wall(direction: str, *, hexahedra: bool, divisions: int = 2) -> dict[str, Any]:
        inner, outer = (1.0, 1.5) if direction == "inverse" else (cylinder.A, cylinder.B)
        mesh = {"radial": divisions, "around": 2 * divisions, "along": 1, "length": 0.25, "hexahedra": hexahedra}
        return {
            "analysis": direction,
            "mesh": {
                "file": "../meshes/thick_cylinder.py",
                "parameters": {"inner": inner, "outer": outer, **mesh},
                "geometry_degree": 2,
            },
            "material": {"law": "neo-hookean", "mu": 1.0, "lam": "incompressible"},
            "effects": [{"effect": "pressure", "region": "inner", "pressure": cylinder.PRESSURE}],
            "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"] + [{"region": "z1", "fix": ["z"]}],
        }

    def radius(letters: str, region: str) -> dict[str, Any]:
        return {"of": f"norm({letters})", "on": region, "reduce": "mean"}

    def radial_stress(r: float) -> float:
        R = (r**2 - 1 + cylinder.A**2) ** 0.5
        here, there = r / R, 1.5 / cylinder.B
        return -(log(here / there) + (there**-2 - here**-2) / 2)

    yield Case("cylinder", wall("inverse", hexahedra=True), radius("X, Y", "inner"), cylinder.A, 1e-4)
    yield Case("cylinder, forward", wall("forward", hexahedra=True), radius("x, y", "outer"), 1.5, 1e-5)
    yield Case("cylinder of tetrahedra", wall("inverse", hexahedra=False), radius("X, Y", "inner"), cylinder.A, 1e-3)
    stress = {"of": "sxx", "at": [1.25, 0.0, 0.125]}
    yield Case("stress in the cylinder", wall("inverse", hexahedra=True), stress, radial_stress(1.25), 1e-3)
    yield Case("cylinder of tetrahedra, forward", wall("forward", hexahedra=False), radius("x, y", "inner"), 1.0, 2e-4)


def stretch(load: float) -> float:
    """Of a confined column under a compressive stress."""
    return root(lambda s: (MU * (s**2 - 1) + LAM * log(s)) / s + load, 0.2, 1.0)


def unloaded(density_in: str) -> float:
    """Length of the column that is 1 m long under its weight."""
    nodes, weights = np.polynomial.legendre.leggauss(30)
    z, w = (1 + nodes) / 2, weights / 2
    if density_in == "current":
        return float(sum(b / stretch(DENSITY * GRAVITY * (1 - a)) for a, b in zip(z, w, strict=True)))

    def loaded(length: float) -> float:
        loads = (DENSITY * GRAVITY * length * (1 - a) for a in z)
        return float(sum(b * length * stretch(load) for load, b in zip(loads, w, strict=True)))

    return root(lambda length: loaded(length) - 1, 1.0, 1.2)


def columns() -> Iterator[Case]:
    def column(density_in: str, *, direction: str = "inverse", length: float = 1.0, **mesh: Any) -> dict[str, Any]:
        gravity = {"effect": "gravity", "acceleration": [0, 0, -GRAVITY], "density": DENSITY}
        return {
            "analysis": direction,
            "mesh": box((1, 1, 2), lx=0.2, ly=0.2, lz=length, **mesh),
            "material": NEO_HOOKEAN,
            "effects": [gravity | {"density_in": density_in}],
            "supports": [{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        }

    top = {"of": "Z", "at": [0.1, 0.1, 1.0]}
    spatial, reference = unloaded("current"), unloaded("reference")
    yield Case("column", column("current"), top, spatial, 1e-4)
    yield Case("column of bricks", column("current", hexahedra=True), top, spatial, 1e-8)
    yield Case("column, density of the body at rest", column("reference"), top, reference, 1e-6)
    yield Case(
        "column, forward, linear elements",
        column("current", direction="forward", length=spatial) | {"discretisation": {"displacement": 1}},
        {"of": "z", "on": "z1", "reduce": "mean"},
        1.0,
        1e-3,
    )


def bars() -> Iterator[Case]:
    def rotating(direction: str, density_in: str) -> dict[str, Any]:
        spin = {"effect": "centrifugal", "angular_velocity": bar.SPIN, "axis": [0, 0, 1], "centre": [0, WIDTH / 2, 0]}
        return {
            "analysis": direction,
            "mesh": box((2, 1, 1), lx=1.0, ly=WIDTH, lz=WIDTH, hexahedra=True),
            "material": NEO_HOOKEAN,
            "effects": [spin | {"density": bar.DENSITY, "density_in": density_in}],
            "supports": [{"region": "boundary", "fix": ["y", "z"]}, {"region": "x0", "fix": ["x"]}],
        }

    end = {"of": "ux", "at": [1.0, WIDTH / 2, WIDTH / 2]}
    for direction, density_in, demand in (("forward", "reference", 1e-5), ("inverse", "current", 1e-7)):
        exact = bar.lengthening(direction, density_in)
        yield Case(f"rotating bar, {direction}", rotating(direction, density_in), end, exact, demand)


def shears() -> Iterator[Case]:
    def shear(direction: str, displacement: str, constants: dict[str, Any], **mesh: Any) -> dict[str, Any]:
        return {
            "analysis": direction,
            "mesh": box((2, 2, 2), **mesh),
            "material": {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": 1e8 * (C1 + C2)},
            "supports": [{"region": "boundary", "displacement": [displacement, "0", "0"], "constants": constants}],
        }

    stress = {"of": "sxy", "at": [0.5, 0.6, 0.4]}
    exact, k = 4 * (C1 + C2) * K * 0.6, f"{K} m^-1"
    yield Case("generalised shear", shear("inverse", "k*y*y", {"k": k}, hexahedra=True), stress, exact, 1e-8 * exact)
    yield Case("generalised shear, forward", shear("forward", "k*y*y", {"k": k}), stress, exact, 1e-4 * exact)
    yield Case("simple shear", shear("inverse", "k*y", {"k": K}), stress, 2 * (C1 + C2) * K, 1e-8 * exact)


def cases() -> list[Case]:
    """All of them."""
    return [*spheres(), *cylinders(), *columns(), *bars(), *shears()]
