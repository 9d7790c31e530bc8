"""Regions that slide: held along the normal of a surface, exactly, in any orientation.

A job that is turned with its supports and loads has the turned solution. On planes along axes it is held by ordinary
supports, which gives independent values. A stiff body that slides in a bore is a pendulum.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import NEO_HOOKEAN, neo_hookean_stress, root
from helpers.thick_sphere import INNER, OUTER, PRESSURE, carried, outer_radius
from helpers.verification import Solved, box, job

from hpcinv import run
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.mesh.body import read_source
from hpcinv.mesh.mesh_files import save
from hpcinv.output.result import Result

TURN = np.linalg.qr(np.array([[1.0, 2.0, -1.0], [0.5, -1.0, 3.0], [2.0, 0.3, 1.0]]))[0]
TURN *= np.linalg.det(TURN)
NORMALS = [{"region": f"{axis}0", "fix": ["normal"]} for axis in "xyz"]
GRAVITY = np.array([2.0, 1.0, -6.0])
FORMS = [{"formulation": "displacement", "displacement": 2}, {"formulation": "mixed", "displacement": 2}]
IDS = ["displacement", "mixed"]
TUBE = {
    "file": "../meshes/thick_cylinder.py",
    "parameters": {"radial": 1, "around": 2, "along": 1, "hexahedra": True},
    "geometry_degree": 2,
}


def turned(mesh: dict[str, Any], directory: Path, comm: MPI.Intracomm) -> dict[str, Any]:
    """The mesh of a job, turned by `TURN`, in a file."""
    path = Path(comm.bcast(str(directory / "turned.msh")))
    if comm.rank == 0:
        spec = job(mesh=mesh, material=NEO_HOOKEAN, supports=NORMALS)
        source = read_source(spec.mesh, spec.resolve(spec.mesh.file))
        save(path, source, source.points @ TURN.T)
    comm.Barrier()
    return {"file": str(path)}


def sagged(
    comm: MPI.Intracomm, direction: str, mesh: dict[str, Any], turn: np.ndarray, supports: Any, **more: Any
) -> Result:
    quantities = [
        {"name": "corner", "of": "displacement", "at": (turn @ np.ones(3)).tolist()},
        {"name": "carried", "of": "reaction", "on": "z0"},
        {"name": "leaned", "of": "reaction", "on": "x0"},
    ]
    gravity = {"effect": "gravity", "acceleration": (turn @ GRAVITY).tolist(), "density": 60.0}
    solver = {"tolerance": 1e-12, "linear": more.pop("linear", "direct")}
    settings = {"analysis": direction, "mesh": mesh, "effects": [gravity], "supports": supports}
    return run(job(**settings, material=NEO_HOOKEAN, quantities=quantities, solver=solver, **more), comm)


@pytest.mark.parametrize("form", FORMS, ids=IDS)
@pytest.mark.parametrize("linear", ["direct", "iterative"])
@pytest.mark.everyday("iterative-displacement")
@pytest.mark.parallel([2, 1])  # three ranks are in the test below
def test_a_turned_block_on_oblique_planes_sags_as_one_along_axes(
    comm: MPI.Intracomm, tmp_path: Path, form: dict[str, Any], linear: str
) -> None:
    along = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    # One plane by its direction, which need not have unit length; one by its formula, with edges on the two others.
    a, b, c = 2 * TURN[:, 2]
    formula = {"surface": f"a*x + {b}*y + {c}*z", "constants": {"a": a}}
    oblique = [NORMALS[0], {**NORMALS[1], "normal": (3 * TURN[:, 1]).tolist()}, NORMALS[2] | formula]
    oblique_mesh = turned(box(), tmp_path, comm)
    for direction in ("forward", "inverse"):
        exact = sagged(comm, direction, box(), np.eye(3), along, discretisation=form, linear=linear).quantities
        values = sagged(comm, direction, oblique_mesh, TURN, oblique, discretisation=form, linear=linear).quantities
        for name, vector in exact.items():
            assert TURN.T @ values[name] == pytest.approx(vector, abs=1e-12 * float(np.linalg.norm(vector))), name


@pytest.mark.parallel([1, 3, 2])
def test_certificate_and_sensitivities_hold_on_oblique_planes(comm: MPI.Intracomm, tmp_path: Path) -> None:
    along = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    more = {
        "certificate": {"round_trip": "near", "stability": True, "estimate": True, "overlap": False},
        "sensitivities": {"effects[0].density": "1 kg/m^3"},
    }
    exact = sagged(comm, "inverse", box(), np.eye(3), along, **more)
    by_formula = {"surface": " + ".join(f"{n}*{axis}" for n, axis in zip(TURN[:, 2], "xyz", strict=True))}
    supports = [*NORMALS[:2], NORMALS[2] | by_formula]
    result = sagged(comm, "inverse", turned(box(), tmp_path, comm), TURN, supports, **more)
    lines = {line.name: line for line in result.certificate.lines}
    assert (lines["round trip, relative to the displacement"].value or 0.0) < 1e-10
    assert lines["stability: unstable directions"].value == 0
    assert "depth beyond the plane of symmetry 'x0', relative to the body" in lines
    estimate, turned_estimate = (
        next(line.value for line in r.certificate.lines if "discretisation error" in line.name) for r in (exact, result)
    )
    assert turned_estimate == pytest.approx(estimate, rel=1e-2)
    slopes = [r.sensitivities.slopes["corner"]["effects[0].density"] for r in (exact, result) if r.sensitivities]
    assert TURN.T @ slopes[1] == pytest.approx(slopes[0], rel=1e-9)


def test_a_turned_octant_of_a_sphere_recovers_its_radii(comm: MPI.Intracomm, tmp_path: Path) -> None:
    parameters = {"inner": INNER, "outer": OUTER, "radial": 2, "along": 2}
    mesh = {"file": "../meshes/thick_sphere.py", "parameters": parameters, "geometry_degree": 2}
    quantities = run(
        job(
            mesh=turned(mesh, tmp_path, comm),
            material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
            effects=[{"effect": "pressure", "region": "inner", "pressure": PRESSURE}],
            supports=NORMALS,
            quantities=[
                {"name": name, "of": "norm(X, Y, Z)", "on": name, "reduce": "mean"} for name in ("inner", "outer")
            ],
        ),
        comm,
    ).quantities
    A = root(lambda A: carried(A, 0.5, 0.0) - PRESSURE, 0.5, 1.0)
    assert quantities["inner"] == pytest.approx(A, rel=5e-3)
    assert quantities["outer"] == pytest.approx(outer_radius(A), rel=5e-3)


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_a_ring_in_a_bore_is_compressed_along_it(comm: MPI.Intracomm, tmp_path: Path, direction: str) -> None:
    """Between two rigid cylinders only the length changes: the state is homogeneous, ``F = diag(1, 1, λ)``.

    The outer one is fitted to its nodes, which move along it. In regular hexahedra the mean normals of nodes are along
    their nodal forces, and it is so to rounding errors.
    """
    stretch = 0.9
    traction = TURN[:, 2] * neo_hookean_stress(np.diag([1.0, 1.0, stretch]))[2, 2]
    quantities = run(
        job(
            analysis=direction,
            mesh=turned(TUBE, tmp_path, comm),
            material=NEO_HOOKEAN,
            effects=[{"effect": "traction", "region": "z1", "traction": traction.tolist(), "area_in": "reference"}],
            supports=[
                *NORMALS,
                {"region": "inner", "fix": ["normal"]},
                {"region": "outer", "fix": ["normal"], "surface": "cylinder"},
            ],
            quantities=[{"name": "end", "of": "displacement", "at": (TURN @ [1.0, 0.0, 1.0]).tolist()}],
            discretisation={"formulation": "displacement", "displacement": 2},
            solver={"tolerance": 1e-12},
        ),
        comm,
    ).quantities
    moved = stretch - 1 if direction == "forward" else 1 - 1 / stretch
    assert TURN.T @ quantities["end"] == pytest.approx([0.0, 0.0, moved], abs=1e-10)


def pendulum(direction: str, weight: float, stiffness: float, **more: Any) -> Job:
    """A quarter of a tube that slides in a bore, with springs at its inner surface.

    Its centre of mass is on the line x = y. About the axis its weight has a moment of at most ``weight`` (N m), the
    springs ``stiffness * sin(angle)``; both are too small to strain the tube.
    """
    arm = np.sqrt(2) * (1 - 0.5**3) / 3  # ∫ r cos φ dA of the quarter about its middle
    settings = {
        "mesh": TUBE,
        "supports": [
            {"region": "outer", "fix": ["normal"], "surface": "norm(x, y) - r", "constants": {"r": "1000 mm"}},
            {"region": "z0", "fix": ["z"]},
        ],
        "effects": [
            {"effect": "gravity", "acceleration": more.pop("along"), "density": weight / arm},
            {"effect": "elastic-foundation", "region": "inner"}
            | dict.fromkeys(("normal", "tangential"), stiffness / (np.pi / 4 * 0.5**2)),
        ],
        "discretisation": {"formulation": "displacement", "displacement": 2},
    }
    return job(analysis=direction, material=NEO_HOOKEAN, **settings, **more)


@pytest.mark.parallel([2, 1])
def test_a_pendulum_in_a_bore_swings_to_its_equilibrium(comm: MPI.Intracomm) -> None:
    """The moments ``cos θ / 2`` and ``sin θ`` are equal, or ``1/2`` and ``sin θ`` at the given place of the inverse."""
    for direction, angle in (("forward", np.arctan(0.5)), ("inverse", np.arcsin(0.5))):
        result = run(
            pendulum(
                direction,
                0.5,
                1.0,
                along=[-(0.5**0.5), 0.5**0.5, 0],
                quantities=[{"name": "corner", "of": "displacement", "at": [1, 0, 0]}],
                certificate={"round_trip": "near", "stability": True, "estimate": False, "overlap": False},
                solver={"tolerance": 1e-12},
            ),
            comm,
        )
        moved = np.array([np.cos(angle) - 1, np.sin(angle), 0.0])
        exact = moved if direction == "forward" else moved * [-1, 1, 1]
        # The arc of a cell is a parabola, with errors of 2e-4 in moments.
        assert result.quantities["corner"] == pytest.approx(exact, abs=1e-3)
        lines = {line.name: line.value for line in result.certificate.lines}
        assert (lines["round trip, relative to the displacement"] or 0.0) < 1e-10
        assert lines["stability: unstable directions"] == 0


@pytest.mark.parametrize(("stiffness", "unstable"), [(1.02, 0), (0.98, 1)])
def test_a_pendulum_upside_down_needs_springs(comm: MPI.Intracomm, stiffness: float, unstable: int) -> None:
    """The reaction of the bore, which turns with its tangent plane, makes the weight topple the tube."""
    checks = {"round_trip": "off", "stability": True, "estimate": False, "overlap": False}
    result = run(pendulum("forward", 1.0, stiffness, along=[-(0.5**0.5), -(0.5**0.5), 0], certificate=checks), comm)
    assert {line.name: line.value for line in result.certificate.lines}["stability: unstable directions"] == unstable


def test_newton_converges_quadratically_on_a_curved_surface(comm: MPI.Intracomm) -> None:
    """The tube is 1e4 times as stiff as its springs, and so much larger is the constant."""
    for direction in ("forward", "inverse"):
        solver = {"tolerance": 1e-10, "reuse_tangent": False}
        solves = Solved(pendulum(direction, 0.5, 1.0, along=[-(0.5**0.5), 0.5**0.5, 0], solver=solver), comm).solves
        *_, previous, last = (iteration.correction for iteration in solves[-1].iterations)
        assert last <= 1e4 * previous**2 <= 1e-7


def test_a_rigid_motion_of_the_surface_moves_the_body_rigidly(comm: MPI.Intracomm) -> None:
    """The same motion by its angle takes the given body forth, or leads back from it, without stress."""
    motion = {"rotate": "50 deg", "axis": [1, 2, 2], "about": [0.2, 0, "100 mm"], "move": [0.3, 0, 0]}
    place, centre, move = np.array([0.5, 0.25, 0.75]), np.array([0.2, 0.0, 0.1]), np.array([0.3, 0.0, 0.0])
    axis, angle = np.array([1.0, 2.0, 2.0]) / 3, np.deg2rad(50)

    def rotated(arm: np.ndarray, angle: float) -> np.ndarray:
        along = (axis @ arm) * axis
        return np.asarray(along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm))

    exact = {
        "forward": centre + move + rotated(place - centre, angle) - place,
        "inverse": place - centre - rotated(place - centre - move, -angle),
    }
    for direction, displacement in exact.items():
        quantities = run(
            job(
                analysis=direction,
                mesh=box(),
                material=NEO_HOOKEAN,
                supports=[{"region": "boundary", "motion": motion}],
                quantities=[
                    {"name": "inside", "of": "displacement", "at": place.tolist()},
                    {"name": "stress", "of": "von_mises", "at": place.tolist()},
                ],
                discretisation={"formulation": "displacement", "displacement": 2},
                solver={"tolerance": 1e-12},
            ),
            comm,
        ).quantities
        assert quantities["inside"] == pytest.approx(displacement, abs=1e-11)
        assert quantities["stress"] == pytest.approx(0.0, abs=1e-6)


def test_prescribed_components_move_nodes_along_their_slide(comm: MPI.Intracomm) -> None:
    """Where y is prescribed as 0.1 z, the plane y + z = const carries z along: ``u = (0, 0.1 z, -0.1 z)``."""
    for direction in ("forward", "inverse"):
        quantities = run(
            job(
                analysis=direction,
                mesh=box(),
                material=NEO_HOOKEAN,
                supports=[
                    {"region": "boundary", "displacement": ["0", "0.1*z", None]},
                    {"region": "boundary", "fix": ["normal"], "normal": [0, 1, 1]},
                ],
                quantities=[{"name": "inside", "of": "displacement", "at": [0.5, 0.25, 0.5]}],
                discretisation={"formulation": "displacement", "displacement": 2},
                solver={"tolerance": 1e-12},
            ),
            comm,
        ).quantities
        assert quantities["inside"] == pytest.approx([0.0, 0.05, -0.05], abs=1e-12)


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        ("x - 1 cm", "nodes of 'x0' are up to 0.01 m off 'x - 1 cm' (allowed: 0.00707 m)"),
        ("x^2", "'x^2' has no value or no normal at some nodes of 'x0'"),
    ],
)
def test_nodes_off_their_surface_are_refused(surface: str, message: str) -> None:
    supports = [{"region": "x0", "fix": ["normal"], "surface": surface}, *NORMALS[1:]]
    with pytest.raises(MeshError, match="supports.0..surface: " + re.escape(message)):
        run(job(mesh=box(), material=NEO_HOOKEAN, supports=supports))


@pytest.mark.parallel([2, 1])
def test_a_bore_that_barely_holds_a_body_is_named(comm: MPI.Intracomm) -> None:
    """A heated sector turns outwards on its bore, unless a plane holds it."""
    heat = {"effect": "thermal-expansion", "coefficient": "1e-3 1/K", "temperature_change": "20 K"}
    slides = [{"region": name, "fix": ["normal"]} for name in ("inner", "z0")]
    for further, said in (([], True), ([{"region": "y0", "fix": ["normal"]}], False)):
        case = job(
            analysis="forward",
            mesh=TUBE | {"parameters": {"radial": 1, "around": 4, "along": 1, "hexahedra": True}},
            material=NEO_HOOKEAN,
            supports=[*slides, *further],
            effects=[heat],
            certificate={"level": "off", "stability": True},
        )
        lines = run(case, comm, progress=False).certificate.lines
        (line,) = (line for line in lines if line.name.startswith("stability"))
        assert ("nearly free to turn about the axis through (0, 0, 0) m along z" in line.note) is said, line


def test_a_sharp_edge_has_no_normal() -> None:
    supports = [{"region": "boundary", "fix": ["normal"]}]
    with pytest.raises(MeshError, match=r"supports\[0\].fix: 'boundary' has a sharp edge at"):
        run(job(mesh=box(), material=NEO_HOOKEAN, supports=supports))


@pytest.mark.parametrize("normal", [{}, {"normal": [-2, 0, 0]}], ids=["of the surface", "given"])
def test_slides_on_the_whole_surface_enclose_an_incompressible_body(normal: dict[str, Any]) -> None:
    supports = [{"region": f"{axis}{end}", "fix": ["normal"]} for axis in "xyz" for end in (0, 1)]
    supports[0] |= normal
    material = {"law": "isochoric-neo-hookean", "mu": 1e3, "kappa": "incompressible"}
    with pytest.raises(MeshError, match="its pressure is not determined"):
        run(job(mesh=box(), material=material, supports=supports))


def test_a_support_that_leaves_a_slide_is_refused() -> None:
    moved = {"region": "x0", "displacement": [None, None, "0.1*(1 - z)"]}
    supports = [
        {"region": "z0", "fix": ["normal"], "normal": [0, 1, 1]},
        moved,
        {"region": "x1", "fix": ["x", "y", "z"]},
    ]
    clash = [*supports, {"region": "y0", "fix": ["y"]}]
    with pytest.raises(MeshError, match="along the normal by"):
        run(job(mesh=box(), material=NEO_HOOKEAN, supports=clash))
