"""Families of fibres: what a job may say, tubes against radial quadrature, and the way there and back.

A thick tube under inner pressure ``p``, incompressible and kept at its length, has ``r² = R² + c``, the hoop stretch
``λ = r/R`` and ``p = ∫ (σ_θθ - σ_rr)/r dr`` over the wall with ``σ_θθ - σ_rr = λ dW/dλ``. Two families of helices at
±β to the circumference leave it a tube. β lies on the undeformed body, or on the deformed one: ``tan β0 = λ tan β``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import log2
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.command_line import CUBE, hpcinv_here, write_job
from helpers.mesh_cases import spec
from helpers.verification import BOX, Solved, box, job

import hpcinv as package
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError, MeshError
from hpcinv.mesh import build_body, read_source
from hpcinv.solver.equations import Equations

ARTERY = {"law": "holzapfel-gasser-ogden", "mu": 3e3, "k1": 2.4e3, "k2": 0.84, "dispersion": 0.05, "kappa": 2e4}
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(40)


def helices(given_on: str, angle: float) -> dict[str, Any]:
    """Two families around the z axis, at this angle (degrees) to the circumference."""
    x, y = "XY" if given_on == "reference" else "xy"

    def helix(sign: str) -> dict[str, Any]:
        direction = [f"-{y}*cos(b)", f"{x}*cos(b)", f"{sign}norm({x}, {y})*sin(b)"]
        return {"direction": direction, "constants": {"b": f"{angle} deg"}, "given_on": given_on}

    return {"fibre1": helix(""), "fibre2": helix("-")}


# validation

FIBRE: dict[str, Any] = {"direction": ["-Y", "X", 0], "given_on": "reference"}


def problems(fibre: dict[str, Any], **changes: Any) -> list[str]:
    data = {"mesh": box(), "material": {"law": "neo-hookean", "mu": 1, "lam": 1}, "fibres": {"fibre": fibre}}
    with pytest.raises(JobError) as caught:
        job(supports=[{"region": "x0", "fix": ["x", "y", "z"]}], **data | changes)
    return [p.split(": ", 1)[1] for p in caught.value.problems]


def without(*keys: str, **changes: Any) -> dict[str, Any]:
    return {key: value for key, value in FIBRE.items() if key not in keys} | changes


NEEDS_ONE = "fibres.fibre: needs exactly one of 'direction' (three formulas), 'data' (an array of the mesh file) and 'r"


@pytest.mark.parametrize(
    ("fibre", "text"),
    [
        (without("direction"), NEEDS_ONE),
        (without(data="grain"), NEEDS_ONE),
        (without("given_on"), "fibres.fibre.given_on: is needed: body on which the direction is given"),
        (without(given_on="deformed"), "fibres.fibre.given_on: must be 'reference' or 'current', not 'deformed'"),
        (without(direction=[0, "0", "k"], constants={"k": 0}), "fibres.fibre.direction: must not be zero"),
        (without(direction=[1, 0]), "fibres.fibre.direction[2]: is needed"),
        (without(direction=["R", 0, 0]), "fibres.fibre.direction[0]: unknown name 'R' in 'R'. Known: X, Y, Z, x, y"),
        (without(direction=["X", 0, "atan(Z)"]), "fibres.fibre.direction[2]: 'atan(Z)' needs a pure number where"),
        (without(direction=["X > 0", 0, 0]), "fibres.fibre.direction[0]: must be a number, but 'X > 0' is a condition"),
        (without(constants={"X": 1}), "fibres.fibre.constants.X: is already the name of something else"),
        (
            without("direction", data="grain", constants={"k": 1}),
            "fibres.fibre.constants: are not valid without 'direct",
        ),
        (without(diretion=[1, 0, 0]), "fibres.fibre.diretion: unknown key. Did you mean 'direction'?"),
    ],
)
def test_invalid_directions_are_refused_with_their_field(fibre: dict[str, Any], text: str) -> None:
    assert problems(fibre)[0].startswith(text)


def test_laws_name_their_missing_fibres() -> None:
    law = {"law": "transversely-isotropic", "mu": 1, "k": 1, "kappa": 1}
    missing = "there are no fibres 'grain'; define them in 'fibres'"
    assert problems(FIBRE, material=law | {"fibre": "grain"}) == [f"material.fibre: {missing}. Known: fibre"]
    assert problems(FIBRE, material={"core": law, "skin": law | {"fibre": "fibr"}}) == [
        "material.skin.fibre: there are no fibres 'fibr'; define them in 'fibres'. Did you mean 'fibre'?"
    ]
    effect = {"effect": "active-stress", "fibre": "grain", "stress": 1}
    assert problems(FIBRE, effects=[effect]) == [f"effects[0].fibre: {missing}. Known: fibre"]
    assert problems(FIBRE, fibres={}, material=law)[0] == (
        "material.fibre: there are no fibres 'fibre'; define them in 'fibres'"
    )


@pytest.mark.parallel(2)
def test_directions_without_a_length_somewhere_are_refused_before_anything_is_solved(comm: MPI.Intracomm) -> None:
    for direction, text in (
        (["max(X - 0.5 m, 0)", 0, 0], "fibres.fibre: the length of the direction must be positive, but is 0"),
        (["X", "sqrt(y - 0.5 m)", 0], "fibres.fibre: the length of the direction must be finite, but is nan"),
    ):
        given = job(
            mesh=box((4, 2, 1)),
            fibres={
                "fibre": {"direction": direction, "given_on": "current"},
                "unused": without(direction=["X - X", 0, 0]),
            },
            material={"law": "transversely-isotropic", "mu": 1, "k": 1, "kappa": 1},
            supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        )
        body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
        with pytest.raises(MeshError) as caught:
            Equations(given, body, Timings())
        assert caught.value.message == f"{given.resolve(BOX)}: {text} in some cell"


@pytest.mark.parallel(2)
def test_the_command_line_refuses_them_with_2(run_directory: Path) -> None:
    material = {"law": "transversely-isotropic", "mu": 1, "k": 1, "kappa": 1}
    fibres = {"fibre": without(direction=["max(X - 0.5 m, 0)", 0, 0])}
    file = write_job(run_directory / "job.yaml", CUBE, material=material, fibres=fibres)
    done = hpcinv_here("run", file, cwd=run_directory)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("fibres.fibre: the length of the direction must be positive") == 1
    assert not (run_directory / "results").exists()


# tubes


@dataclass(frozen=True)
class Tube:
    """The radial problem of one of two bodies, ``analysis`` says which, with these radii, moduli and pressure (SI)."""

    analysis: str
    given_on: str
    inner: float = 0.7
    outer: float = 1.0
    pressure: float = 1e3
    mu: float = 3e3
    k1: float = 2.4e3
    k2: float = 0.84
    dispersion: float = 0.05
    angle: float = 35.0  # degrees

    def name(self) -> str:
        return f"{self.analysis}, β on the {self.given_on} body"

    def hoop(self, stretch: np.ndarray) -> np.ndarray:
        """λ dW/dλ, of both families together."""
        tangent, d = np.tan(np.radians(self.angle)), self.dispersion
        along = 1 / (1 + (tangent * (stretch if self.given_on == "current" else 1)) ** 2)  # cos² β0
        E = d * (stretch**2 + stretch**-2 - 2) + (1 - 3 * d) * along * (stretch**2 - 1)
        slope = d * (2 * stretch - 2 * stretch**-3) + (1 - 3 * d) * along * 2 * stretch
        ground = self.mu * (stretch - stretch**-3)
        return stretch * (ground + 2 * self.k1 * E * np.exp(self.k2 * E**2) * slope)

    def pressure_at(self, c: float) -> float:
        moved = c if self.analysis == "forward" else 0.0
        a, b = np.sqrt(self.inner**2 + moved), np.sqrt(self.outer**2 + moved)
        r = (a + b) / 2 + (b - a) / 2 * POINTS
        return float(WEIGHTS @ (self.hoop(r / np.sqrt(r**2 - c)) / r)) * (b - a) / 2

    @cached_property
    def c(self) -> float:
        low, high = 0.0, (4.0 if self.analysis == "forward" else 0.9) * self.inner**2
        assert self.pressure_at(high) > self.pressure
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if self.pressure_at(middle) < self.pressure else (low, middle)
        return low

    def other(self, radius: Any) -> Any:
        """Radius in the other body."""
        return np.sqrt(radius**2 + (self.c if self.analysis == "forward" else -self.c))

    def outward(self, r: np.ndarray) -> np.ndarray:
        """Radial displacement ``r - R`` at a radius of the given body."""
        return np.abs(self.other(r) - r)


def tube_error(comm: MPI.Intracomm, tube: Tube, divisions: int) -> float:
    """Largest error of the displacement at any node, as a share of the inner radius."""
    parameters = {"inner": tube.inner, "outer": tube.outer, "length": 0.1, "hexahedra": True}
    parameters |= {"radial": divisions, "around": divisions, "along": 1}
    law = {name: getattr(tube, name) for name in ("mu", "k1", "k2", "dispersion")}
    solved = Solved(
        job(
            analysis=tube.analysis,
            mesh={"file": "../meshes/thick_cylinder.py", "parameters": parameters, "geometry_degree": 2},
            fibres=helices(tube.given_on, tube.angle),
            material={"law": "holzapfel-gasser-ogden", "kappa": "incompressible"} | law,
            effects=[{"effect": "pressure", "region": "inner", "pressure": tube.pressure}],
            supports=[{"region": cut, "fix": [cut[0]]} for cut in ("x0", "y0", "z0", "z1")],
        ),
        comm,
    )
    u = solved.model.unknowns.geometry_values(solved.model.unknowns.displacement()) * solved.body.length_scale
    x = solved.body.mesh.geometry.x * solved.body.length_scale
    r = np.hypot(x[:, 0], x[:, 1])
    exact = (tube.outward(r) / r)[:, None] * x * [1, 1, 0]
    return float(comm.allreduce(float(np.abs(u - exact).max()), op=MPI.MAX)) / tube.inner


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize(
    "tube", [Tube("forward", "reference"), Tube("forward", "current"), Tube("inverse", "current")], ids=Tube.name
)
def test_a_tube_with_two_families_widens_as_its_quadrature_says(tube: Tube, comm: MPI.Intracomm) -> None:
    errors = [tube_error(comm, tube, divisions) for divisions in (4, 8)]
    order = log2(errors[0] / errors[1])
    print(f"{tube.name()}: {errors[0]:.1e}, {errors[1]:.1e}, order {order:.2f}")
    assert errors[1] < 1e-4
    assert order > 3
    # The two meanings of β are a thousand times farther apart.
    swapped = replace(tube, given_on={"reference": "current", "current": "reference"}[tube.given_on])
    assert abs(swapped.other(tube.inner) - tube.other(tube.inner)) > 0.01 * tube.inner


@pytest.mark.release
def test_the_arterial_ring_has_the_undeformed_radii_of_its_header(comm: MPI.Intracomm) -> None:
    file = Path(__file__).parents[2] / "jobs" / "arterial-ring.yaml"
    ring = Tube("inverse", "current", 1.5e-3, 1.8e-3, 100 * 133.322387415, dispersion=0.0, angle=20.0)
    radii = {"inner-radius": float(ring.other(ring.inner)), "outer-radius": float(ring.other(ring.outer))}
    for radius in radii.values():
        assert f"{radius * 1e3:.7f} mm" in file.read_text()
    quantities = package.run(package.load(file), comm).quantities
    print(", ".join(f"{name} {quantities[name] * 1e3:.7f} mm, exact {r * 1e3:.7f} mm" for name, r in radii.items()))
    for name, radius in radii.items():
        assert quantities[name] == pytest.approx(radius, rel=1e-5)
    assert abs(quantities["out-of-round"]) < 1e-4 * radii["inner-radius"]


# there and back


def spiral(given_on: str) -> dict[str, Any]:
    """A family whose direction differs from place to place, on either body."""
    x, y, z = "XYZ" if given_on == "reference" else "xyz"
    return {"direction": [f"1 m + {z}", f"0.5*{x}", f"-{y} - 0.2 m"], "given_on": given_on}


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_bent_blocks_with_fibres_on_either_body_come_back(comm: MPI.Intracomm) -> None:
    for hexahedra, degree in ((False, 2), (True, 1)):
        first = "forward" if hexahedra else "inverse"
        solved = Solved(
            job(
                analysis="round_trip",
                first=first,
                mesh=box((2, 1, 1), lx=2.0, hexahedra=hexahedra) | {"geometry_degree": degree},
                fibres={"fibre1": spiral("reference"), "fibre2": spiral("current")},
                material=ARTERY,
                effects=[{"effect": "gravity", "acceleration": [0, -1, 0.5], "density": "1 g/cm^3"}],
                supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
                discretisation={"displacement": degree, "formulation": "displacement"},
            ),
            comm,
        )
        model = solved.model
        there = model.unknowns.geometry_values(model.unknowns.displacement())
        gap = comm.allreduce(float(np.abs(solved.again() - there).max()), op=MPI.MAX)
        size = comm.allreduce(float(np.abs(there).max()), op=MPI.MAX)
        cells = "hexahedra" if hexahedra else "tetrahedra"
        print(f"{first} first, {cells} of degree {degree}, {comm.size} ranks: {size:.2f} m, gap {gap / size:.1e}")
        assert size > 0.2
        assert gap < 1e-11 * size


# data arrays


def write_with_directions(path: Path, meshes: Path) -> None:
    """A box as VTU, with the direction of ``spiral`` at its nodes."""
    mesh = read_source(spec(meshes / "box.py", parameters={"nx": 2, "ny": 2, "nz": 2}), meshes / "box.py")
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: mesh.cells}, np.array(mesh.points))
    x, y, z = mesh.points.T
    grid.point_data["grain"] = np.stack([1 + z, 0.5 * x, -y - 0.2], axis=1)
    grid.point_data["straight"] = np.tile([1.0, 0.0, 0.0], (len(x), 1))
    grid.cell_data["stiffness"] = np.ones(len(mesh.cells))
    grid.save(path)


@pytest.mark.parallel([2, 1])
def test_directions_at_nodes_agree_with_their_formula(comm: MPI.Intracomm, run_directory: Path, meshes: Path) -> None:
    file = run_directory / "grain.vtu"
    on_root(comm, lambda: write_with_directions(file, meshes))

    def solved(fibre: dict[str, Any]) -> np.ndarray:
        case = Solved(
            job(
                mesh={"file": str(file)},
                regions={"foot": "x < 1 mm"},
                fibres={"fibre": fibre},
                material={"law": "transversely-isotropic", "mu": "3 kPa", "k": "9 kPa", "kappa": "9 kPa"},
                effects=[{"effect": "gravity", "acceleration": [0, -1, 0.5], "density": "1 g/cm^3"}],
                supports=[{"region": "foot", "fix": ["x", "y", "z"]}],
                discretisation={"displacement": 1},
            ),
            comm,
        )
        u: np.ndarray = case.model.unknowns.displacement().x.array
        return u

    formula, data = solved(spiral("current")), solved({"data": "grain", "given_on": "current"})
    straight = solved({"data": "straight", "given_on": "current"})
    size, gap, other = (
        comm.allreduce(float(np.abs(a).max()), op=MPI.MAX) for a in (formula, formula - data, formula - straight)
    )
    print(f"{comm.size} ranks: gap {gap / size:.1e}")
    assert gap < 1e-11 * size
    assert other > 1e-2 * size
    with pytest.raises(MeshError, match="the array 'stiffness' has 1 components, not 3"):
        solved({"data": "stiffness", "given_on": "current"})
