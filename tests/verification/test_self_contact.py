"""Bodies that touch themselves: a ring under outer pressure, and surfaces that are searched for in themselves.

The ring is cut at x = 0. Its inner surface touches itself there under a pressure above 5.246887 EI/R³, if it is thin
(Flaherty, Keller & Rubinow, 1972, doi:10.1137/0123047); it becomes flat there at 10.336033 EI/R³. `thin_ring` solves
the equations of an inextensible ring with middle lines that touch at a given distance, which reproduce both numbers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.verification import job
from scipy.integrate import solve_bvp

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError
from hpcinv.output.result import Solution

POISSON, WIDTH = 0.3, 0.1
FOLDED = """
def build(gmsh, *, half=0, gap=0.04, thick=0.2):
    signs = (1,) if half else (1, -1)
    for sign in signs:
        for x, z, wide, high in ((-thick, 0, thick, gap / 2), (-thick, gap / 2, thick, thick), (0, gap / 2, 1, thick)):
            gmsh.model.occ.addBox(x, 0, z if sign > 0 else -z - high, wide, 0.3, high)
    volumes = gmsh.model.occ.getEntities(3)
    gmsh.model.occ.fragment(volumes[:1], volumes[1:])
    gmsh.model.occ.synchronize()
    for _, edge in gmsh.model.getEntities(1):
        box = gmsh.model.getBoundingBox(1, edge)
        length = max(box[3] - box[0], box[4] - box[1], box[5] - box[2])
        gmsh.model.mesh.setTransfiniteCurve(edge, 6 if length > 0.5 else 2)
    for _, face in gmsh.model.getEntities(2):
        gmsh.model.mesh.setTransfiniteSurface(face)
        gmsh.model.mesh.setRecombine(2, face)
    for _, volume in gmsh.model.getEntities(3):
        gmsh.model.mesh.setTransfiniteVolume(volume)
    faces = {tag: gmsh.model.occ.getCenterOfMass(2, tag) for _, tag in gmsh.model.getEntities(2)}
    outer = [tag for tag in faces if len(gmsh.model.getAdjacencies(2, tag)[0]) == 1]
    named = {"skin": outer, "back": [tag for tag in outer if abs(faces[tag][0] + thick) < 1e-6]}
    named["middle"] = [tag for tag in outer if abs(faces[tag][2]) < 1e-6]
    far = gap / 2 + thick
    for name, height in (("lip", gap / 2), ("other_lip", -gap / 2), ("top", far), ("foot", -far)):
        named[name] = [tag for tag in outer if abs(faces[tag][2] - height) < 1e-6 and faces[tag][0] > 0]
    for name, tags in named.items():
        if tags:
            gmsh.model.addPhysicalGroup(2, tags, name=name)
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], name="all")
    gmsh.model.mesh.generate(3)
"""


def folded(directory: Path, comm: MPI.Intracomm, between: tuple[str, str] | None, **data: Any) -> Solution:
    """Return a folded block whose arms are pressed on each other; without an interface, its half on a rigid plane."""
    if comm.rank == 0:
        (directory / "folded.py").write_text(FOLDED)
    comm.Barrier()
    push = {"effect": "traction", "area_in": "reference"}
    effects = [push | {"region": "top", "traction": [0, 0, "-0.01 Pa*X/(1 m)"]}]
    supports = [{"region": "back", "fix": ["x", "y", "z"]}]
    if between is None:
        plane = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1]}
        effects.append({"effect": "contact", "region": "lip", "obstacle": plane, "penetration": "1e-11 m"})
        supports.append({"region": "middle", "fix": ["z"]})
    else:
        effects.append(push | {"region": "foot", "traction": [0, 0, "0.01 Pa*X/(1 m)"]})
        data["interfaces"] = [{"between": list(between), "kind": "contact"} | data.pop("interface", {})]
    given: dict[str, Any] = {
        "analysis": "forward",
        "mesh": {"file": str(directory / "folded.py"), "parameters": {"half": int(between is None)}},
        "material": {"law": "neo-hookean", "mu": 1.0, "lam": 1.0},
        "discretisation": {"displacement": 1},
        "effects": effects,
        "supports": supports,
    }
    return hpcinv.run(job(**given | data), comm).solutions[0]


def thin_ring(pressure: float, thickness: float) -> dict[str, float]:
    """Return force, half axis and curvature at the contact of a ring of radius and bending stiffness 1."""

    def rates(_: np.ndarray, v: np.ndarray) -> np.ndarray:
        _, _, angle, moment, tx, ty = v
        c, s = np.cos(angle), np.sin(angle)
        return np.array([c, s, 1 + moment, tx * s - ty * c, pressure * s, -pressure * c])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[1], a[2] - np.pi / 2, a[4], b[0], b[2] - np.pi, b[1] - thickness / 2])

    s = np.linspace(0, np.pi / 2, 101)
    guess = [1.4 * np.cos(s), 0.3 * np.sin(s), np.pi / 2 + s, 2 * np.cos(2 * s), 0 * s, -pressure + 0 * s]
    found = solve_bvp(rates, ends, s, np.array(guess), tol=1e-8, max_nodes=20000)
    assert found.success
    return {"force": 2 * found.y[5, -1], "half_axis": found.y[0, 0], "curvature": 1 + found.y[3, -1]}


def pressed_ring(
    comm: MPI.Intracomm, pressure: float, *, thickness: float, around: int, between: tuple[str, str]
) -> Solution:
    """Return a ring under a pressure in EI/R³; an uneven one is added first, which says where it gives way."""
    stiffness = thickness**3 / 12 / (1 - POISSON**2)
    uneven = f"{0.3 * stiffness}*(Y^2-X^2)*(1 Pa/m^2)"
    parts = [("squeeze", 3.6 * stiffness), ("press", (pressure - 3.6) * stiffness)]
    parts += [("squeeze", uneven), ("press", f"-{uneven}")]
    side = 1 + thickness / 2
    data: dict[str, Any] = {
        "analysis": "forward",
        "mesh": {
            "file": "../meshes/half_ring.py",
            "geometry_degree": 2,
            "parameters": {"thickness": thickness, "width": WIDTH, "around": around},
        },
        "material": {"law": "neo-hookean", "young": 1.0, "poisson": POISSON},
        "discretisation": {"displacement": 2},
        "regions": {"middle": {"vertices": [[side, 0, 0], [side, 0, WIDTH]]}},
        "load_cases": ["squeeze", "press"],
        "effects": [{"effect": "pressure", "region": "outer", "pressure": p, "case": case} for case, p in parts],
        "supports": [
            {"region": "x0", "fix": ["x"]},
            {"region": "z0", "fix": ["z"]},
            {"region": "z1", "fix": ["z"]},
            {"region": "middle", "fix": ["y"]},
        ],
        "interfaces": [{"between": list(between), "kind": "contact"}],
    }
    return hpcinv.run(job(**data), comm).solutions[0]


def force_of(solution: Solution, thickness: float) -> float:
    """Return the force per width on both halves of the ring, in EI/R²."""
    return abs(2 * solution.contacts[0].force[1]) / WIDTH / (thickness**3 / 12 / (1 - POISSON**2))


@pytest.mark.parallel([3, 2, 1])
def test_arms_of_a_folded_block_press_on_each_other_as_on_a_plane(comm: MPI.Intracomm, run_directory: Path) -> None:
    """Its halves are equal, so the plane between them is the rigid one that the half is pressed on."""
    lips, skin, half = (folded(run_directory, comm, b) for b in (("lip", "other_lip"), ("skin", "skin"), None))
    force = half.contacts[0].force[2]
    print(f"force {lips.contacts[0].force[2]:.6e}, {skin.contacts[0].force[2]:.6e} N, on a plane {force:.6e} N")
    assert lips.contacts[0].force[2] == pytest.approx(force, rel=0.03)
    assert np.abs(skin.u - lips.u).max() < 1e-9
    assert skin.contacts[0].force == pytest.approx(lips.contacts[0].force, abs=1e-9)


def test_the_equations_of_a_thin_ring_have_the_known_pressures() -> None:
    assert thin_ring(5.246887, 0.0)["force"] == pytest.approx(0.0, abs=1e-5)
    assert thin_ring(10.336033, 0.0)["curvature"] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.release
@pytest.mark.parametrize("between", [("inner", "inner"), ("lower", "upper")])
def test_a_ring_under_pressure_touches_itself(comm: MPI.Intracomm, between: tuple[str, str]) -> None:
    """The thickness is 1/10 of the radius, so shear and the pressure in the wall change some percent."""
    solution = pressed_ring(comm, 8.0, thickness=0.1, around=10, between=between)
    thin = thin_ring(8.0, 0.1)
    force = force_of(solution, 0.1)
    farthest = comm.allreduce(float((solution.mesh_nodes + solution.u)[:, 0].max()), op=MPI.MAX)
    print(f"force {force:.4f}, thin ring {thin['force']:.4f}; half axis {farthest:.4f}, {thin['half_axis'] + 0.05:.4f}")
    assert force == pytest.approx(thin["force"], rel=0.06)
    assert farthest == pytest.approx(thin["half_axis"] + 0.05, rel=0.01)
    assert solution.contacts[0].penetration < 1e-9


@pytest.mark.parametrize(
    ("between", "data", "error", "match"),
    [
        (("skin", "skin"), {"analysis": "round_trip", "first": "forward"}, JobError, "which only a forward analysis"),
        (("skin", "skin"), {"interface": {"kind": "tied"}}, JobError, "names one region twice: name the two surfaces"),
        (("skin", "lip"), {}, MeshError, r"'skin' and 'lip' have \d+ facets in common"),
    ],
)
def test_surfaces_that_cannot_meet_themselves_are_refused(
    run_directory: Path, between: tuple[str, str], data: dict[str, Any], error: type[Exception], match: str
) -> None:
    with pytest.raises(error, match=match):
        folded(run_directory, MPI.COMM_SELF, between, **data)
