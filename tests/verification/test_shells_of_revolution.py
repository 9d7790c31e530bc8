"""Cylinders, spheres and discs of a shell: closed forms and published benchmarks, and back."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.sheets import flat, save_sheet, save_sphere_octant
from helpers.shell_cases import YOUNG, cylinder, gap, solve

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError, SolveError
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.readers import read_surface
from hpcinv.output.result import Result
from hpcinv.results.cell_fields import face_arrays

HALVED = [{"region": "x0", "fix": ["x"]}, {"region": "y0", "fix": ["y"]}]


@pytest.mark.release
@pytest.mark.parallel([2])
@pytest.mark.parametrize("face", ["inner", pytest.param("outer", marks=pytest.mark.release)])
def test_pressure_acts_on_the_faces_of_a_thick_cylinder(tmp_path: Path, comm: MPI.Intracomm, face: str) -> None:
    """Lamé's solution in plane strain, which a pressure on the midsurface misses by 10 %, and its hoop stress.

    One end slides on a plane that is not normal to an axis.
    """
    radius, thickness, pressure, poisson, angle = 1.0, 0.1, 20.0, 0.3, 1.2
    path = comm.bcast(tmp_path / "sheet.msh")
    if comm.rank == 0:
        save_sheet(path, 4, 1, cylinder(radius, 1.2, angle))
    comm.barrier()
    result = solve(
        path,
        thickness,
        comm,
        analysis="round_trip",
        first="forward",
        material={"law": "st-venant-kirchhoff", "young": YOUNG, "poisson": poisson},
        effects=[{"effect": "pressure", "region": face, "pressure": pressure}],
        supports=[
            {"region": "x0", "fix": ["y"]},
            {"region": "x1", "fix": ["normal"], "normal": [-np.sin(angle), np.cos(angle), 0]},
            {"region": "y0", "fix": ["z"]},
            {"region": "y1", "fix": ["z"]},
        ],
        quantities=[{"name": "ur", "of": "ux", "at": [radius, 0, 0.6]}],
    )
    a, b = radius - thickness / 2, radius + thickness / 2
    inside, outside = (pressure, 0.0) if face == "inner" else (0.0, pressure)
    A, B = (inside * a**2 - outside * b**2) / (b**2 - a**2), (inside - outside) * (a * b) ** 2 / (b**2 - a**2)
    exact = (1 + poisson) / YOUNG * ((1 - 2 * poisson) * A * radius + B / radius)
    assert result.quantities["ur"] == pytest.approx(exact, rel=2e-3)
    for solution in result.solutions:
        nodes, stress = solution.mesh_nodes, face_arrays(result.body, solution)["cauchy_stress"].reshape(-1, 3, 3)
        distance, errors = np.hypot(nodes[:, 0], nodes[:, 1]), [0.0]
        for place in (a, b):
            here = np.abs(distance - place) < 1e-2 * thickness
            hoop = np.stack([-nodes[:, 1], nodes[:, 0], 0 * distance], axis=1) / distance[:, None]
            found = np.einsum("ni,nij,nj->n", hoop, stress, hoop)[here]
            errors.extend(np.abs(found / (A + B / place**2) - 1))
        assert comm.allreduce(max(errors), op=MPI.MAX) < 4e-2  # 1.8 % on four cells, 0.6 % on eight
    assert comm.allreduce(gap(result), op=MPI.MAX) < 1e-12


@pytest.mark.release
def test_incompressible_cylinder_inflates_as_in_closed_form(tmp_path: Path) -> None:
    """Neo-Hooke in plane strain: ``p = μ [ln(R/r) - c/(2 r²)]`` between the radii ``r² = R² + c``."""
    mu, thickness, inner = 1e5, 0.1, 0.95
    outer, c = inner + thickness, (1.3**2 - 1) * inner**2

    def pressure(radius: float) -> float:
        place = radius**2 + c
        return float(mu * (np.log(radius / np.sqrt(place)) - c / (2 * place)))

    result = solve(
        save_sheet(tmp_path / "sheet.msh", 8, 1, cylinder(1, 0.6, np.pi / 2)),
        thickness,
        analysis="round_trip",
        first="forward",
        material={"law": "isochoric-neo-hookean", "mu": mu, "kappa": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": pressure(outer) - pressure(inner)}],
        supports=[
            {"region": "x0", "fix": ["y"]},
            {"region": "x1", "fix": ["x"]},
            {"region": "y0", "fix": ["z"]},
            {"region": "y1", "fix": ["z"]},
        ],
        quantities=[{"name": "inner", "of": "norm(x, y)", "on": "inner", "reduce": "mean", "over": "reference"}],
    )
    assert result.quantities["inner"] == pytest.approx(1.3 * inner, rel=1e-3)
    assert result.certificate.verdict.value == "pass"
    assert gap(result) < 1e-10


@pytest.mark.release
def test_balloon_beyond_its_largest_pressure_comes_back(tmp_path: Path) -> None:
    """Incompressible neo-Hooke: ``p = μ [1/(2 s⁴) + 2/s]`` between the stretches of the faces; largest near 1.38."""
    mu, thickness, stretch = 1e5, 0.05, 1.8
    inner, outer = 1 - thickness / 2, 1 + thickness / 2
    ends = stretch, (outer**3 + (stretch**3 - 1) * inner**3) ** (1 / 3) / outer
    there, back = (1 / (2 * s**4) + 2 / s for s in ends)
    result = solve(
        save_sphere_octant(tmp_path / "octant.msh", 2),
        thickness,
        analysis="round_trip",
        first="forward",
        material={"law": "isochoric-neo-hookean", "mu": mu, "kappa": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": mu * (back - there)}],
        supports=[*HALVED, {"region": "z0", "fix": ["z"]}],
        solver={"strategy": "arc-length", "limit_points": 1, "initial_step": 0.25},
        quantities=[
            {"name": name, "of": f"norm({place})", "on": "inner", "reduce": "mean", "over": "reference"}
            for name, place in (("r", "x, y, z"), ("R", "X, Y, Z"))
        ],
    )
    assert result.quantities["r"] / result.quantities["R"] == pytest.approx(stretch, rel=3e-4)
    assert gap(result) < 1e-11


@pytest.mark.parametrize(
    ("cells", "thickness", "error"), [(2, 0.05, 2e-4), pytest.param(8, 0.005, 1e-6, marks=pytest.mark.release)]
)
def test_balloon_by_volume_past_its_largest_pressure(
    cells: int, thickness: float, error: float, tmp_path: Path
) -> None:
    """The pressure of the closed form falls beyond a stretch of 1.38, and the volume brings the balloon there and back.

    Incompressible neo-Hooke: ``p = μ [1/(2 s⁴) + 2/s]`` between the stretches of the faces.
    """
    mu, inner, outer = 1e5, 1 - thickness / 2, 1 + thickness / 2
    path = save_sphere_octant(tmp_path / "octant.msh", cells)
    for stretch in (1.4, 1.8) if cells == 8 else (1.8,):
        volume = np.pi / 6 * (stretch * inner) ** 3
        result = solve(
            path,
            thickness,
            analysis="round_trip",
            first="forward",
            material={"law": "isochoric-neo-hookean", "mu": mu, "kappa": "incompressible"},
            cavities={"hole": {"surface": "inner", "lid": {"apex": [0, 0, 0]}, "volume": volume}},
            supports=[*HALVED, {"region": "z0", "fix": ["z"]}],
            quantities=[
                {"name": "p", "of": "pressure", "cavity": "hole"},
                {"name": "r", "of": "norm(x, y, z)", "on": "inner", "reduce": "mean", "over": "reference"},
            ],
        )
        ends = stretch, (outer**3 + (stretch**3 - 1) * inner**3) ** (1 / 3) / outer
        there, back = (1 / (2 * s**4) + 2 / s for s in ends)
        assert result.quantities["p"] == pytest.approx(mu * (back - there), rel=error)
        assert result.quantities["r"] == pytest.approx(stretch * inner, rel=error)
        assert gap(result) < 1e-10


def test_a_flat_pouch_is_filled(tmp_path: Path) -> None:
    """A sheet between two edges encloses nothing at first: its equation is relative to the volume that it reaches."""
    path = save_sheet(tmp_path / "sheet.msh", 2, 1, flat(0.05, 0.02))
    pouch: dict[str, Any] = {
        "material": {"law": "neo-hookean", "mu": 1e6, "lam": 2e6},
        "supports": [{"region": name, "fix": ["x", "y", "z"]} for name in ("x0", "x1")],
    }
    result = solve(path, 1e-3, analysis="forward", cavities={"c": {"surface": "inner", "volume": 5e-7}}, **pouch)
    (cavity,) = result.solutions[-1].cavities
    assert cavity.volume == pytest.approx(5e-7, rel=1e-9)
    assert cavity.residual < 1e-9
    with pytest.raises(MeshError, match=r"cavities\.c\.gas: its surface encloses no volume"):
        solve(
            path,
            1e-3,
            analysis="forward",
            cavities={"c": {"surface": "inner", "gas": {"ambient": 1e5, "amount": 1.2}}},
            **pouch,
        )


@pytest.mark.release
def test_hemisphere_hangs_from_its_rim_as_a_membrane(tmp_path: Path) -> None:
    """Under its weight w per area: ``N_φ = w R/(1 + cos φ)``, ``N_θ = w R cos φ - N_φ``, and back.

    Source: Flügge, Stresses in Shells, 1973, ch. 2. The rest is bending at the rim, of order t/R.
    """
    thickness, young, poisson = 0.01, 1e4, 0.3
    result = solve(
        save_sphere_octant(tmp_path / "octant.msh", 4),
        thickness,
        analysis="round_trip",
        material={"law": "neo-hookean", "young": young, "poisson": poisson},
        effects=[{"effect": "gravity", "density": 1, "acceleration": [0, 0, 1], "density_in": "reference"}],
        supports=[*HALVED, {"region": "z0", "fix": ["z"], "hinge": True}],
        quantities=[
            {"name": "pole", "of": "sxx", "at": [0, 0, 1]},
            {"name": "largest", "of": "sxx", "on": "outer", "reduce": "max"},
            {"name": "area", "of": "nx**2 + ny**2 + nz**2", "on": "outer", "reduce": "integral", "over": "reference"},
        ],
    )
    # energy of an eighth of the sphere, by Gauss points in cos φ
    points, weights = np.polynomial.legendre.leggauss(8)
    cosine = (points + 1) / 2
    meridian = 1 / (1 + cosine)
    hoop = cosine - meridian
    energy = np.pi / 4 * thickness / young * weights / 2 @ (meridian**2 + hoop**2 - 2 * poisson * meridian * hoop)
    assert result.solutions[0].strain_energy == pytest.approx(energy, rel=thickness)
    # at a node other parts of the layer's stress would add 0.9 to this 0.5
    assert result.quantities["pole"] == pytest.approx(0.5, rel=0.02)
    assert result.quantities["largest"] == pytest.approx(0.5, rel=0.06)  # the cells' quadrature would find 1.8
    assert result.quantities["area"] == pytest.approx(np.pi / 2 * (1 + thickness / 2) ** 2, rel=1e-3)
    assert gap(result) < 1e-12


@pytest.mark.release
def test_flat_disc_is_inflated_as_a_membrane(tmp_path: Path) -> None:
    """From unstressed, ``w = 0.6534 q^(1/3) R`` for ``q = p R/(E t)`` and ν = 0.3, and back.

    Source: Hencky, Z. Math. Phys. 63, 1915, for small strains; these are 0.01.
    """
    thickness, young, q = 2e-4, 1e6, 1e-3
    octant = read_surface(save_sphere_octant(tmp_path / "octant.msh", 4))
    x, y, z = octant.points.T
    from_pole = np.arccos(np.clip(z, 0, 1)) / np.maximum(np.hypot(x, y), 1e-300) / (np.pi / 2)
    path = tmp_path / "disc.msh"
    save_msh(path, octant, np.column_stack([from_pole * x, from_pole * y, 0 * z]))
    result = solve(
        path,
        thickness,
        analysis="round_trip",
        first="forward",
        material={"law": "st-venant-kirchhoff", "young": young, "poisson": 0.3},
        effects=[{"effect": "pressure", "region": "inner", "pressure": q * young * thickness}],
        supports=[*HALVED, {"region": "z0", "fix": ["x", "y", "z"], "hinge": True}],
        solver={"initial_step": 1e-8, "minimum_step": 1e-12},
        quantities=[{"name": "rise", "of": "uz", "at": [0, 0, 0]}],
    )
    assert abs(result.quantities["rise"]) / q ** (1 / 3) == pytest.approx(0.6534, rel=2e-3)
    assert gap(result) < 1e-6


def point_load(region: str, force: float, band: float, share: str) -> dict[str, Any]:
    """Return the traction whose work is a force along z times the displacement of the first node of an edge.

    Args:
        band: area of the facet of that edge.
        share: formula of the distance from that node by the length of the facet.
    """
    dual = f"(9 - 36*{share} + 30*({share})**2)"  # to the node's quadratic shape function
    traction = [0, 0, f"({force / band} Pa)*{dual}"]
    return {"effect": "traction", "region": region, "traction": traction, "area_in": "reference"}


@pytest.mark.release
def test_slit_ring_is_lifted_and_comes_back(tmp_path: Path) -> None:
    """Sze, Liu & Lo 2004, §3.3, and zanoni-mbdyn/MBDyn, sze33_ref.dat: 13.891 and 17.528 at 0.8 N/m."""

    def ring(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        radius, angle = 6 + 4 * s, 2 * np.pi * t
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * s])

    result = solve(
        save_sheet(tmp_path / "ring.msh", 4, 24, ring),
        0.03,
        analysis="round_trip",
        first="forward",
        material={"law": "st-venant-kirchhoff", "young": 21e6, "poisson": 0},
        effects=[{"effect": "traction", "region": "y1", "traction": [0, 0, 0.8 / 0.03], "area_in": "reference"}],
        supports=[{"region": "y0", "fix": ["x", "y", "z"]}],
        quantities=[{"name": f"r{r}", "of": "uz", "at": [r, -1e-5, 0]} for r in (6, 10)],
        certificate={"level": "quick", "overlap": False},
    )
    assert result.quantities["r6"] == pytest.approx(13.891, rel=0.01)
    assert result.quantities["r10"] == pytest.approx(17.528, rel=0.01)
    assert gap(result) < 1e-6 * 20


@pytest.mark.release
def test_open_cylinder_is_pulled_out_and_comes_back(tmp_path: Path) -> None:
    """Sze, Liu & Lo 2004, §3.5, and zanoni-mbdyn/MBDyn, sze35_ref.dat: 1.707, -2.217, -2.293 at 10 % of 40 kN."""
    radius, length, thickness, divisions = 4.953, 10.35, 0.094, 12
    angle = np.pi / 2 / divisions

    def eighth(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.column_stack([radius * np.sin(np.pi / 2 * s), length / 2 * t, radius * np.cos(np.pi / 2 * s)])

    result = solve(
        save_sheet(tmp_path / "cylinder.msh", divisions, 8, eighth),
        thickness,
        analysis="round_trip",
        first="forward",
        material={"law": "st-venant-kirchhoff", "young": 10.5e6, "poisson": 0.3125},
        regions={"pulled": f"y < 1e-6 and x < {1.02 * radius * np.sin(angle)}"},
        effects=[point_load("pulled", 4000 / 4, thickness * radius * angle, f"(atan2(X, Z)/{angle})")],
        supports=[{"region": "x0", "fix": ["x"]}, {"region": "x1", "fix": ["z"]}, {"region": "y0", "fix": ["y"]}],
        quantities=[
            {"name": "A", "of": "uz", "at": [0, 0, radius]},
            {"name": "B", "of": "ux", "at": [radius, 0, 0]},
            {"name": "C", "of": "ux", "at": [radius, length / 2, 0]},
        ],
    )
    found = [result.quantities[name] for name in "ABC"]
    assert found == pytest.approx([1.707, -2.217, -2.293], rel=0.01)
    assert gap(result) < 1e-6 * length


@pytest.mark.release
def test_hinged_roof_snaps_at_its_limit_load(tmp_path: Path) -> None:
    """Sze, Liu & Lo 2004, §3.8, and fenics-dolfiny/dolfiny, tdc_shell_naghdi_cylindrical_roof_sze2004.csv.

    The roof of 6.35 mm carries 585.9 N at most; a roof of 12.7 mm has gone through at 0.9643 of 3 kN, by 28.663 mm
    (sze38_ref_a.dat).
    """
    radius, length, angle, divisions = 2540.0, 254.0, 0.1, 8

    def quarter(s: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.column_stack([radius * np.sin(angle * s), length * t, radius * np.cos(angle * s)])

    path, step = save_sheet(tmp_path / "roof.msh", divisions, 8, quarter), angle / divisions

    def roof(thickness: float, force: float, **data: Any) -> Result:
        return solve(
            path,
            thickness,
            **data,
            analysis="forward",
            material={"law": "st-venant-kirchhoff", "young": 3102.75, "poisson": 0.3},
            regions={"crown": f"y < 1e-6 and x < {1.02 * radius * np.sin(step)}"},
            effects=[point_load("crown", -force / 4, thickness * radius * step, f"(atan2(X, Z)/{step})")],
            supports=[
                {"region": "x0", "fix": ["x"]},
                {"region": "x1", "fix": ["x", "y", "z"], "hinge": True},
                {"region": "y0", "fix": ["y"]},
            ],
            quantities=[{"name": "crown", "of": "uz", "at": [0, 0, radius]}],
        )

    beyond = {"strategy": "arc-length", "limit_points": 2}
    assert roof(12.7, 0.9643 * 3000, solver=beyond).quantities["crown"] == pytest.approx(-28.663, rel=0.01)
    assert roof(6.35, 0.98 * 585.9).quantities["crown"] > -13
    with pytest.raises(SolveError, match="reaches its maximum"):
        roof(6.35, 1.01 * 585.9)
