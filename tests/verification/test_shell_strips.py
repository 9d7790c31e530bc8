"""Strips of a shell bend, shear, buckle and rest as beams do, and come back."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.sheets import flat, save_sheet
from helpers.shell_cases import CLAMPED, LINEAR, YOUNG, gap, job, solve, weight

import hpcinv
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.readers import read_surface
from hpcinv.output.result import Result
from hpcinv.output.surfaces.boundary_surface import read_boundary
from hpcinv.results.cell_fields import face_arrays


def in_triangles(path: Path, file: Path) -> Path:
    """Write the vertices of a sheet as triangles of degree 1, two for each quadrilateral."""
    surface = read_surface(path)
    quadrilaterals = surface.cells[:, [0, 1, 3, 2]]
    cells = np.concatenate([quadrilaterals[:, [0, 1, 2]], quadrilaterals[:, [0, 2, 3]]])
    groups = tuple(dataclasses.replace(g, members=np.arange(len(cells))) if g.dim == 3 else g for g in surface.groups)
    facets, tags = surface.facets[:, :2], np.arange(1, len(cells) + 1)
    triangles = dataclasses.replace(
        surface, kind="triangle", degree=1, cells=cells, cell_tags=tags, facets=facets, groups=groups
    ).drop_unused_nodes()
    save_msh(file, triangles, triangles.points)
    return file


@pytest.mark.parametrize(
    ("cells", "thickness", "error"),
    [
        pytest.param("quadrilaterals", 0.1, 1e-3, marks=pytest.mark.release),
        pytest.param("quadrilaterals", 0.01, 1e-3, marks=pytest.mark.release),
        ("quadrilaterals", 0.001, 1e-3),
        pytest.param("triangles", 0.01, 3e-3, marks=pytest.mark.release),
    ],
)
def test_end_shear_of_a_cantilever_both_ways(tmp_path: Path, cells: str, thickness: float, error: float) -> None:
    """Sze, Liu & Lo 2004, doi:10.1016/j.finel.2003.11.001, §3.1: tip 6.698 and 3.286 for P L²/(E I) = 4."""
    # With 8 cells along it a thicker strip is stiffer by 1.3e-3, and one of triangles by 1.4 %.
    path = save_sheet(tmp_path / "sheet.msh", 8 if thickness < 0.01 else 16, 1, flat(10, 1))
    if cells == "triangles":
        path = in_triangles(path, tmp_path / "triangles.msh")
    traction = [0, 0, 4 * thickness**2 * YOUNG / 12 / 100]
    result = solve(
        path,
        thickness,
        analysis="round_trip",
        first="forward",
        effects=[{"effect": "traction", "region": "x1", "traction": traction, "area_in": "reference"}],
        supports=[CLAMPED],
        quantities=[{"name": "tip", "of": "displacement", "at": [10, 0.5, 0]}],
    )
    ux, _, uz = result.quantities["tip"]
    assert uz == pytest.approx(6.698, rel=error)
    assert -ux == pytest.approx(3.286, rel=2 * error)
    # at L/t = 10,000 rounding errors of positions leave a residual of 1e-4 of the load
    is_thin = thickness < 0.01
    assert result.certificate.verdict.value == ("warning" if is_thin else "pass")
    assert gap(result) < (1e-8 if is_thin else 1e-9) * 10


@pytest.mark.release
def test_short_cantilever_shears_as_a_solid(tmp_path: Path) -> None:
    """Tip w = F L³/(3 E I) + 6/5 F L/(G A): the shear factor of one layer is 5/6, the factor of a solid."""
    length, thickness, force = 4.0, 1.0, 1e-6 * YOUNG
    result = solve(
        save_sheet(tmp_path / "sheet.msh", 8, 1, flat(length, 1)),
        thickness,
        analysis="round_trip",
        first="forward",
        effects=[{"effect": "traction", "region": "x1", "traction": [0, 0, force], "area_in": "reference"}],
        supports=[CLAMPED],
        quantities=[{"name": "tip", "of": "uz", "at": [length, 0.5, 0]}],
    )
    bending, shear = force * length**3 / 3 / (YOUNG / 12), force * length / (YOUNG / 2)
    assert (result.quantities["tip"] - bending) / shear == pytest.approx(6 / 5, rel=0.02)
    assert gap(result) < 1e-12


def test_end_moment_of_a_cantilever(tmp_path: Path) -> None:
    """Sze, Liu & Lo 2004, §3.2: half of the moment that bends it to a circle makes a half circle.

    The faces have the stress ±6 M/(b t²) in pictures, fields and shape files.
    """
    length, thickness, share = 12.0, 0.1, 0.5
    path = save_sheet(tmp_path / "sheet.msh", 16, 1, flat(length, 1))
    moment = YOUNG * 2 * np.pi * share / length * thickness**3 / 12
    run = tmp_path / "run"
    result = hpcinv.run(
        job(
            path,
            thickness,
            analysis="forward",
            effects=[{"effect": "edge-moment", "region": "x1", "moment": [0, -moment, 0]}],
            supports=[CLAMPED],
            quantities=[{"name": "tip", "of": "displacement", "at": [length, 0.5, 0]}],
            output={"report": False, "mesh": ["msh"]},
        ),
        progress=False,
        directory=run,
    )
    ux, _, uz = result.quantities["tip"]
    assert ux == pytest.approx(-length, rel=1e-3)
    assert uz == pytest.approx(2 * length / np.pi, rel=1e-3)

    largest = np.pi * share * thickness / length
    even = YOUNG * largest**2  # of this law in bending
    boundary, shape = read_boundary(run / "surface.npz"), read_surface(run / "shape.msh").data
    fields = pyvista.read(run / "fields" / "undeformed.pvd")[0]
    for face, sign in (("outer", -1), ("inner", 1)):  # it bends towards its outer face
        stress = sign * 6 * moment / thickness**2 + even
        on_face = np.isclose(fields.points[:, 2], -sign * thickness / 2)
        tensors = [
            boundary.results[0].stress[boundary.region_mask(face)],
            shape[f"cauchy_stress_{face}"].values,
            fields.point_data["cauchy_stress_projected"][on_face],
        ]
        for tensor in tensors:
            assert len(tensor) >= 33
            values = np.linalg.eigvalsh(tensor.reshape(-1, 3, 3))[:, 2 if sign > 0 else 0]
            assert values == pytest.approx(stress, rel=5e-3)  # 2.5e-3 next to the edge with the moment
        assert shape[f"von_mises_{face}"].values == pytest.approx(abs(stress), rel=1e-2)
        stretches = shape[f"principal_stretches_{face}"].values
        assert stretches[:, 0 if sign > 0 else 2] == pytest.approx(1 + sign * largest, rel=2e-4)
    assert boundary.body_kind == "shell"


@pytest.mark.everyday("2")
@pytest.mark.parametrize("layers", [1, 2])
def test_moment_on_an_edge_that_contracts(tmp_path: Path, layers: int) -> None:
    """A strip whose width is held bends to an arc of 80° under ``E t³ κ/(12 (1 - ν²))``, and comes back."""
    length, thickness, poisson, angle = 1.0, 0.0025, 0.3, np.radians(80)
    path = save_sheet(tmp_path / "sheet.msh", 6, 1, flat(length, 0.1))
    moment = YOUNG * thickness**3 / 12 / (1 - poisson**2) * angle / length
    shell = {"thickness": thickness} | ({"layers": {"a": 1, "b": 1}} if layers == 2 else {})
    result = hpcinv.run(
        job(
            path,
            thickness,
            mesh={"file": str(path), "shell": shell},
            analysis="round_trip",
            material={"law": "st-venant-kirchhoff", "young": YOUNG, "poisson": poisson},
            effects=[{"effect": "edge-moment", "region": "x1", "moment": [0, -moment, 0]}],
            supports=[CLAMPED, {"region": "y0", "fix": ["y"]}, {"region": "y1", "fix": ["y"]}],
        ),
        progress=False,
    )
    solution = result.solutions[0]
    tip = solution.u[solution.mesh_nodes[:, 0] > length * (1 - 1e-9)].mean(axis=0)
    assert abs(tip[2]) == pytest.approx(length * (1 - np.cos(angle)) / angle, rel=1e-3)
    assert abs(tip[0]) == pytest.approx(length * (1 - np.sin(angle) / angle), rel=1e-3)
    assert gap(result) < 1e-8


@pytest.mark.release
def test_hinged_strip_sags_as_a_beam(tmp_path: Path) -> None:
    """A hinge holds the midsurface alone: 5 w L⁴/(384 E I); a clamped strip sags a fifth as far.

    The estimated error is the difference from cells of half the size.
    """
    length, thickness, weight = 10.0, 0.1, 1e-3 * 1000 * 0.1

    def solved(columns: int, rows: int, **data: Any) -> Result:
        return solve(
            save_sheet(tmp_path / "sheet.msh", columns, rows, flat(length, 1)),
            thickness,
            effects=[{"effect": "gravity", "density": 1000, "acceleration": [0, 0, -1e-3], "density_in": "reference"}],
            supports=[
                {"region": "x0", "fix": ["x", "y", "z"], "hinge": True},
                {"region": "x1", "fix": ["y", "z"], "hinge": True},
            ],
            quantities=[{"name": "middle", "of": "uz", "at": [length / 2, 0.5, 0]}],
            **data,
        )

    result = solved(8, 1, analysis="round_trip", certificate={"level": "quick", "estimate": True})
    assert result.estimate is not None
    assert any("on cells of half the size" in line.note for line in result.certificate.lines)
    difference = solved(16, 2, analysis="inverse").quantities["middle"] - result.quantities["middle"]
    assert result.estimate.quantities["middle"] == pytest.approx(difference, rel=1e-6)
    assert result.quantities["middle"] == pytest.approx(-5 * weight * length**4 / 384 / (YOUNG * 1e-3 / 12), rel=5e-3)
    assert gap(result) < 1e-10 * length
    bending = 6 * weight * length**2 / 8 / thickness**2
    for solution in result.solutions:
        x, _, z = solution.reference_nodes.T
        stress = face_arrays(result.body, solution)["cauchy_stress"][:, 0]
        for side in (-1, 1):
            here = np.isclose(x, length / 2) & np.isclose(z, side * thickness / 2)
            assert stress[here] == pytest.approx(-side * bending, rel=5e-3)


@pytest.mark.release
@pytest.mark.parametrize(
    ("share", "count", "verdicts"),
    [
        pytest.param(0.99, 0, {"pass"}, marks=pytest.mark.release),
        (1.01, 1, {"fail", "not decided"}),
        pytest.param(3.9, 1, {"fail"}, marks=pytest.mark.release),
        pytest.param(4.1, 2, {"fail"}, marks=pytest.mark.release),
    ],
)
def test_hinged_strip_buckles_as_euler_says(tmp_path: Path, share: float, count: int, verdicts: set[str]) -> None:
    """A strip on two hinges has one unstable mode beyond π² E t²/(12 L²), two beyond 4 times this stress."""
    length, thickness = 1.0, 0.01
    stress = share * np.pi**2 * YOUNG * thickness**2 / 12 / length**2
    result = solve(
        save_sheet(tmp_path / "sheet.msh", 8, 1, flat(length, 0.2)),
        thickness,
        analysis="forward",
        effects=[{"effect": "traction", "region": "x1", "traction": [-stress, 0, 0], "area_in": "reference"}],
        supports=[
            {"region": "x0", "fix": ["x", "y", "z"], "hinge": True},
            {"region": "x1", "fix": ["y", "z"], "hinge": True},
        ],
        certificate={"level": "off", "stability": True},
    )
    [line] = [line for line in result.certificate.lines if line.name.startswith("stability")]
    assert line.value == count
    assert line.verdict.value in verdicts


def test_bimetal_strip_bends_as_timoshenko_says(tmp_path: Path) -> None:
    """Two layers of other thickness and stiffness are warmed: curvature κ, and the straight strip back.

    Source: Timoshenko, J. Opt. Soc. Am. 11, 233-255, 1925.
    """
    length, thickness, change, m, n = 10.0, 0.1, 10.0, 1 / 2, 2.0
    path = save_sheet(tmp_path / "strip.msh", 4, 1, flat(length, 1))
    result = hpcinv.run(
        job(
            path,
            thickness,
            mesh={"file": str(path), "shell": {"thickness": thickness, "layers": {"bottom": m, "top": 1}}},
            analysis="round_trip",
            first="forward",
            material={"bottom": LINEAR | {"young": n * YOUNG}, "top": LINEAR},
            effects=[
                {
                    "effect": "thermal-expansion",
                    "coefficient": {"bottom": 2e-5, "top": 1e-5},
                    "temperature_change": change,
                }
            ],
            supports=[
                {"region": "x0", "fix": ["x", "z"]},
                {"region": "y0", "fix": ["y"]},
                {"region": "y1", "fix": ["y"]},
            ],
            quantities=[{"name": "rise", "of": "uz", "at": [length / 2, 0.5, 0]}],
        ),
        progress=False,
    )
    stiffness = 3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n))
    curvature = 6 * 1e-5 * change * (1 + m) ** 2 / (thickness * stiffness)
    rise = (1 - np.cos(curvature * length / 2)) / curvature
    assert result.quantities["rise"] == pytest.approx(rise, rel=1e-3)
    assert gap(result) < 1e-10 * length


@pytest.mark.release
@pytest.mark.parametrize(
    ("cells", "thickness", "gravity"), [(8, 0.02, 0.5), pytest.param(16, 0.002, 0.02, marks=pytest.mark.release)]
)
def test_sagging_sheet_rests_on_a_plane(tmp_path: Path, cells: int, thickness: float, gravity: float) -> None:
    """Its lower face touches the plane, half a thickness below the midsurface, and the sheet comes back flat.

    On 16 cells the thin sheet has no solution near the whole update of the pressures.
    """
    plane = {"shape": "plane", "point": [0, 0, -0.1], "normal": [0, 0, 1]}
    result = solve(
        save_sheet(tmp_path / "sheet.msh", cells, 1, flat(1, 0.25)),
        thickness,
        analysis="round_trip",
        first="forward",
        material={"law": "neo-hookean", "mu": 4e5, "lam": 8e5},
        effects=[
            {"effect": "gravity", "density": 1000, "acceleration": [0, 0, -gravity], "density_in": "reference"},
            {"effect": "contact", "region": "inner", "obstacle": plane},
        ],
        supports=[CLAMPED],
        quantities=[{"name": "end", "of": "z", "at": [1, 0.125, 0]}],
    )
    assert result.quantities["end"] == pytest.approx(-0.1 + thickness / 2, abs=1e-2 * thickness)
    assert gap(result) < 1e-6


@pytest.mark.release
def test_known_contact_pressure_gives_the_flat_sheet_back(tmp_path: Path) -> None:
    """The pressure is rounded by the tolerated penetration, which by default follows the size of the given body."""
    path = save_sheet(tmp_path / "sheet.msh", 8, 1, flat(1, 0.25))
    plane = {"shape": "plane", "point": [0, 0, -0.1], "normal": [0, 0, 1]}
    contact = {"effect": "contact", "region": "inner", "obstacle": plane}
    base = job(path, 0.02, material={"law": "neo-hookean", "mu": 4e5, "lam": 8e5}, supports=[CLAMPED])
    output = {"fields": False, "report": False, "mesh": ["msh"]}
    forward = base | {"analysis": "forward", "effects": [weight(-0.5), contact], "output": output}
    [there] = hpcinv.run(forward, progress=False, directory=tmp_path / "run").solutions[0].contacts
    known = {"pressure": {"data": "contact_multiplier", "unit": "Pa"}, "penalty": there.penalty}
    contact |= known | {"penetration": there.tolerance}
    mesh = {"file": str(tmp_path / "run" / "shape.msh"), "shell": {"director": "data"}}
    inverse = base | {"analysis": "inverse", "mesh": mesh, "effects": [weight(-0.5), contact]}
    back = hpcinv.run(inverse, progress=False).solutions[0]
    z = back.other_nodes[:, 2]
    assert np.abs(z - 0.01 * np.rint(z / 0.01)).max() < 1e-8  # 2e-3 without the penetration
