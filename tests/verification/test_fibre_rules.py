"""Fibres by rules: a tube against its closed form, ventricles with prescribed angles, what is refused.

In a tube the Laplace solution across the wall is ``ln(r/a)/ln(b/a)``, and the directions are the cylinder's.
A prism with two holes has the axes of its cross-section and of its height.
"""

from __future__ import annotations

from math import log2, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.verification import Solved, box, job

import hpcinv as package
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import Job
from hpcinv.mesh import Body, build_body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.data import cell_vectors
from hpcinv.model.fibre_directions import _farthest, _first_by_place, rule_directions
from hpcinv.model.laplace import Laplace

TUBE = {"kind": "tube", "inner": "inner", "outer": "outer", "inlet": "z0", "outlet": "z1"}
VENTRICLE = {"kind": "ventricle", "endo": "endo", "epi": "epi", "base": "base", "helix": ["60 deg", "-60 deg"]}
LAW = {"law": "transversely-isotropic", "mu": "3 kPa", "k": "9 kPa", "kappa": "9 kPa"}
A, B = 0.7, 1.0


def with_rule(mesh: dict[str, Any], rule: dict[str, Any], support: str, **changes: Any) -> Job:
    data: dict[str, Any] = {"material": LAW, "supports": [{"region": support, "fix": ["x", "y", "z"]}]}
    return job(mesh=mesh, fibres={"fibre": {"rule": rule, "given_on": "current"}}, **data | changes)


def tube(divisions: int, **changes: Any) -> dict[str, Any]:
    parameters = {"inner": A, "outer": B, "length": 0.3, "hexahedra": True, "radial": divisions, "along": 1}
    mesh = {"file": "../meshes/thick_cylinder.py", "parameters": parameters | {"around": divisions}}
    return mesh | {"geometry_degree": 2} | changes


def found(given: Job, comm: MPI.Intracomm, **changes: str) -> tuple[Body, np.ndarray, np.ndarray]:
    """The body, and points (n, 3) in m and directions (n, 3) of the job's fibres in the cells that this rank owns."""
    body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
    rule = given.fibres["fibre"].rule
    assert rule is not None
    function = rule_directions(body, rule.model_copy(update=changes), "fibres.fibre").function
    owned = body.mesh.topology.index_map(3).size_local
    at = function.function_space.element.basix_element.points
    shapes = scalar_element(body.source.kind, body.source.degree).tabulate(0, at)[0, :, :, 0]
    nodes = body.mesh.geometry.x[body.mesh.geometry.dofmaps[0][:owned]] * body.length_scale
    x = np.einsum("pn,cni->cpi", shapes, nodes)
    return body, x.reshape(-1, 3), cell_vectors(function)[:owned].reshape(-1, 3)


def most(comm: MPI.Intracomm, values: np.ndarray) -> float:
    return float(comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX))


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between lines, in radians."""
    return np.asarray(np.arcsin(np.minimum(np.linalg.norm(np.cross(a, b), axis=1), 1.0)))


# tubes


def in_tube(x: np.ndarray, inside: float, outside: float, power: int = 1) -> np.ndarray:
    """Directions of helices in the closed form."""
    r = np.hypot(x[:, 0], x[:, 1])
    depth = np.clip(np.log(r / A) / np.log(B / A), 0, 1)
    helix = (inside + outside) / 2 + (inside - outside) / 2 * (1 - 2 * depth) ** power
    c, s = np.cos(helix), np.sin(helix)
    return np.stack([-x[:, 1] / r * c, x[:, 0] / r * c, s], axis=1)


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_helices_in_a_tube_agree_with_the_closed_form(comm: MPI.Intracomm) -> None:
    errors = []
    for divisions in (2, 4):
        given = with_rule(tube(divisions), TUBE | {"helix": ["60 deg", "-60 deg"]}, "z0")
        _, x, fibre = found(given, comm)
        assert most(comm, np.abs(np.linalg.norm(fibre, axis=1) - 1)) < 1e-12
        errors.append(most(comm, angle(fibre, in_tube(x, pi / 3, -pi / 3))))
    print(f"{comm.size} ranks: {errors[0]:.1e}, {errors[1]:.1e} rad, order {log2(errors[0] / errors[1]):.2f}")
    assert errors[1] < 0.02
    assert log2(errors[0] / errors[1]) > 1.5
    _, x, fibre = found(given, comm, transmural="cubic")
    cubic = most(comm, angle(fibre, in_tube(x, pi / 3, -pi / 3, 3)))
    print(f"cubic: {cubic:.1e} rad")
    assert cubic < 0.04


def test_around_along_and_across_a_tube_with_an_axis(comm: MPI.Intracomm) -> None:
    rule = {name: TUBE[name] for name in ("kind", "inner", "outer")} | {"axis": [0, 0, 2], "helix": "20 deg"}
    given = with_rule(tube(4), rule, "z0")
    _, x, fibre = found(given, comm)
    assert most(comm, angle(fibre, in_tube(x, pi / 9, pi / 9))) < 0.01
    _, _, radial = found(given, comm, gives="sheet")
    assert most(comm, angle(radial, x * [1, 1, 0] / np.hypot(x[:, 0], x[:, 1])[:, None])) < 0.01
    _, _, normal = found(given, comm, gives="normal")
    assert np.abs(np.einsum("ni,ni->n", fibre, normal)).max() < 1e-12
    assert angle(normal, np.cross(fibre, radial)).max() < 1e-7


@pytest.mark.parallel([2, 1])
def test_a_tube_with_a_rule_moves_as_one_with_formulas(comm: MPI.Intracomm, run_directory: Path) -> None:
    def given(fibre: dict[str, Any]) -> Job:
        return job(
            mesh=tube(2),
            fibres={"fibre": fibre | {"given_on": "current"}},
            material=LAW,
            effects=[{"effect": "pressure", "region": "inner", "pressure": "0.5 kPa"}],
            supports=[{"region": cut, "fix": [cut[0]]} for cut in ("x0", "y0", "z0", "z1")],
            discretisation={"displacement": 1, "formulation": "displacement"},
            output={"mesh": []},
        )

    by_rule = package.run(given({"rule": TUBE | {"helix": "20 deg"}}), comm)
    formulas = ["-y*cos(20 deg)", "x*cos(20 deg)", "norm(x, y)*sin(20 deg)"]
    by_formula = Solved(given({"direction": formulas}), comm)
    expected = by_formula.model.unknowns.displacement().x.array * by_formula.body.length_scale
    here = by_rule.solutions[0].displacement.x.array
    assert most(comm, np.abs(here - expected)) < 0.01 * most(comm, np.abs(expected)) > 0
    by_rule.write_fields(run_directory)
    if comm.rank == 0:
        pieces = [pyvista.read(file) for file in run_directory.rglob("*.vtu")]
        lengths = [np.linalg.norm(p.cell_data["fibre:fibre"], axis=1) for p in pieces if p.n_cells]
        assert lengths
        assert all(np.allclose(length, 1.0) for length in lengths)


# ventricles


@pytest.mark.parallel([3, 2, 1])
def test_a_ventricle_has_the_prescribed_angles_at_its_surfaces(comm: MPI.Intracomm) -> None:
    mesh = {"file": "../meshes/ventricle.py", "unit": "mm", "parameters": {"size": "8 mm"}, "geometry_degree": 2}
    given = with_rule(mesh, VENTRICLE | {"sheet": ["-65 deg", "25 deg"]}, "base")
    _, x, fibre = found(given, comm)
    _, _, sheet = found(given, comm, gives="sheet")
    _, _, normal = found(given, comm, gives="normal")
    turning = np.abs(np.linalg.norm(np.cross(fibre, sheet), axis=1) - 1) > 1e-9
    assert not turning.any()
    assert most(comm, angle(np.cross(sheet, fibre), normal)) < 1e-7
    r = np.hypot(x[:, 0], x[:, 1])
    for radius, length, expected in ((0.025, 0.060, 60.0), (0.035, 0.070, -60.0)):
        on = (np.abs((r / radius) ** 2 + (x[:, 2] / length) ** 2 - 1) < 0.01) & (x[:, 2] > -0.045)
        p, f = x[on], fibre[on]
        around = np.stack([-p[:, 1], p[:, 0], 0 * p[:, 0]], axis=1) / r[on][:, None]
        outward = p / np.array([radius, radius, length]) ** 2
        outward /= np.linalg.norm(outward, axis=1)[:, None]
        along = np.cross(outward, around)  # towards the base
        helix = np.degrees(np.arctan(np.einsum("ni,ni->n", f, along) / np.einsum("ni,ni->n", f, around)))
        count, total = (comm.allreduce(n, op=MPI.SUM) for n in (len(p), float(helix.sum())))
        worst = most(comm, np.abs(helix - expected))
        print(f"{comm.size} ranks: {count} points, mean {total / count:.2f}°, largest deviation {worst:.1f}°")
        assert count > 100
        assert total / count == pytest.approx(expected, abs=2)
        assert worst < 15


@pytest.mark.parallel([1, 2])
def test_the_apex_is_farthest_from_the_middle_of_the_base(comm: MPI.Intracomm) -> None:
    regions = {"base": "x > 0.9 m and z < 0.6 m", "epi": "y < 0.01 m"}
    given = with_rule(box((2, 2, 2)), VENTRICLE | {"endo": "y1"}, "y1", regions=regions)
    body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
    laplace = Laplace(body)
    x = laplace.space.tabulate_dof_coordinates() * body.length_scale
    owned = laplace.space.dofmap.index_map.size_local
    apex = _farthest(body, laplace, laplace.dofs("epi"), laplace.dofs("base"))
    laplace_dofs = apex, laplace.dofs("epi"), laplace.dofs("base")
    found_points, epi, base = (np.vstack(comm.allgather(x[dofs[dofs < owned]])) for dofs in laplace_dofs)
    distances = np.linalg.norm(epi - base.mean(axis=0), axis=1)
    assert np.partition(distances, -2)[-2] < 0.99 * distances.max()  # there is one
    assert found_points == pytest.approx(epi[[np.argmax(distances)]])
    laplace.destroy()


def test_equally_far_points_are_chosen_by_place_whatever_their_order_and_rounding() -> None:
    """Four corners of a square: rounding must not decide which of two corners of least x is the apex."""
    corners = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0.0]])
    chance = np.random.default_rng(3)
    for _ in range(20):
        rounded = corners[chance.permutation(4)] + chance.uniform(-1e-15, 1e-15, (4, 3))
        assert _first_by_place(rounded, 1e-9) == pytest.approx([-1, -1, 0], abs=1e-12)


PRISM = """
def build(gmsh, *, size=0.25):
    geo = gmsh.model.geo
    def circle(x, r):
        c = geo.addPoint(x, 0, 0)
        p = [geo.addPoint(x + r * dx, r * dy, 0) for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1))]
        return [geo.addCircleArc(p[i], c, p[(i + 1) % 4]) for i in range(4)]
    rings = circle(0, 2.0), circle(-0.75, 0.6), circle(0.85, 0.5)
    face = geo.addPlaneSurface([geo.addCurveLoop(ring) for ring in rings])
    new = [tag for _, tag in geo.extrude([(2, face)], 0, 0, 0.5, [2])]
    geo.synchronize()
    for name, tags in (("apex", [face]), ("base", new[:1]), ("epi", new[2:6]), ("lv", new[6:10]), ("rv", new[10:14])):
        gmsh.model.addPhysicalGroup(2, tags, name=name)
    gmsh.model.addPhysicalGroup(3, [new[1]], name="wall")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.model.mesh.generate(3)
"""


@pytest.mark.parallel([2, 1])
def test_two_ventricles_have_the_angles_at_all_three_surfaces(comm: MPI.Intracomm, run_directory: Path) -> None:
    file = run_directory / "prism.py"
    if comm.rank == 0:
        file.write_text(PRISM)
    comm.barrier()
    rule = VENTRICLE | {"endo": "lv", "rv": "rv", "apex": "apex", "helix": ["50 deg", "-40 deg"]}
    given = with_rule({"file": str(file)}, rule, "base")
    body, x, fibre = found(given, comm)
    directions = rule_directions(body, given.fibres["fibre"].rule, "fibres.fibre")  # type: ignore[arg-type]
    print(f"{directions.turning} and {directions.undefined} of {sum(body.partition.cells)} cells are special")
    assert directions.turning < 0.05 * sum(body.partition.cells)
    assert not directions.undefined
    for centre, radius, outward, expected in ((-0.75, 0.6, 1, 50.0), (0.85, 0.5, 1, 50.0), (0.0, 2.0, 1, -40.0)):
        r = np.hypot(x[:, 0] - centre, x[:, 1])
        on = np.abs(r - radius) < 1e-6  # corners of cells
        p, f = x[on] - [centre, 0, 0], fibre[on]
        around = outward * np.stack([-p[:, 1], p[:, 0], 0 * r[on]], axis=1) / radius
        helix = np.degrees(np.arctan(f[:, 2] / np.einsum("ni,ni->n", f, around)))
        tangent = np.degrees(np.arcsin(np.abs(np.einsum("ni,ni->n", f, p * [1, 1, 0])) / radius))
        worst, off = most(comm, np.abs(helix - expected)), most(comm, tangent)
        print(f"radius {radius}: {on.sum()} points, largest deviation {worst:.1f}°, out of the surface {off:.1f}°")
        assert comm.allreduce(int(on.sum()), op=MPI.SUM) > 20
        assert worst < 5
        assert off < 15


# what is refused


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        ({"kind": "cone"}, "fibres.fibre.rule.kind: unknown kind 'cone'"),
        (TUBE, "fibres.fibre.rule.helix: is needed"),
        (
            TUBE | {"helix": 60},
            "fibres.fibre.rule.helix[0]: must be at least -1.5708 and at most 1.5708, not 60; a pla",
        ),
        (TUBE | {"helix": 0, "inlet": None}, "fibres.fibre.rule: needs 'inlet' and 'outlet' (regions at the ends of"),
        (TUBE | {"helix": 0, "axis": [0, 0, 1]}, "fibres.fibre.rule.axis: is not valid with 'inlet'"),
        (
            TUBE | {"helix": 0, "inner": "wall", "outer": "wall"},
            "fibres.fibre.rule.outer: 'wall' is already the region of 'inner'",
        ),
    ],
)
def test_faults_of_a_rule_are_reported_with_their_field(rule: dict[str, Any], text: str) -> None:
    with pytest.raises(JobError) as caught:
        with_rule(box(), rule, "x0")
    assert text in "\n".join(caught.value.problems)


def test_a_region_that_the_mesh_file_lacks_is_reported_before_the_run() -> None:
    rule = {"kind": "tube", "inner": "clamp", "outer": "skin", "axis": [0, 0, 1], "helix": 0}
    with pytest.raises(JobError, match=r"fibres\.fibre\.rule\.outer: .*'skin'"):
        with_rule({"file": "../meshes/pdms-beam-sagging.msh", "unit": "mm"}, rule, "clamp")


def test_a_rule_is_for_the_body_of_the_mesh() -> None:
    with pytest.raises(
        JobError, match=r"fibres\.fibre\.given_on: must be 'reference' for a rule, which is evaluated on"
    ):
        with_rule(tube(2), TUBE | {"helix": 0}, "z0", analysis="forward")


@pytest.mark.parallel(2)
def test_fibre_rules_without_a_direction_are_refused_on_all_ranks(comm: MPI.Intracomm) -> None:
    sides = {"kind": "tube", "helix": 0, "inner": "x0", "outer": "x1"}
    for rule, text in (
        (sides | {"axis": [1, 0, 0]}, "cells the direction along the wall is not defined"),
        (sides | {"inlet": "y0", "outlet": "end"}, "fibres.fibre.rule.outlet: .*no region 'end'"),
        (sides | {"outer": "y0", "axis": [0, 0, 1]}, r"'x0' \(inner\) and 'y0' \(outer\) touch, at \d+ points"),
    ):
        with pytest.raises(MeshError, match=text):
            found(with_rule(box((2, 2, 2)), rule, "x0"), comm)
