"""The silicone beam at loads, stiffness ratios, units, sizes and slendernesses far from its own, against theory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import LinearProblem
from helpers.beam_theory import curled_axis, sagging_tip
from helpers.hard_case import FINE, effort, solve
from helpers.silicone_beam import C1, C2, DENSITY, DIAMETER, GRAVITY, LENGTH

from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.spaces import Unknowns
from hpcinv.output.result import Result

MU = 2 * (C1 + C2)
PER_LENGTH = DENSITY * GRAVITY * np.pi * DIAMETER**2 / 4  # N/m
BENDING = np.pi * DIAMETER**4 / 64  # second moment of the section
HELD = (0.25, 0.5, 0.75, 1.0)  # points of the axis


def weight(factor: float) -> dict[str, Any]:
    return {"effects": [{"effect": "gravity", "acceleration": [0, -GRAVITY * factor, 0], "density": DENSITY}]}


def tip(result: Result) -> np.ndarray:
    return np.array(result.quantities["tip"])


# Bulk modulus


@pytest.mark.everyday("10.0")  # an incompressible one is in test_pdms_beam.py
@pytest.mark.parametrize(
    "ratio",
    [
        pytest.param(1.0, marks=pytest.mark.release),
        10.0,
        10.1,
        pytest.param(1e3, marks=pytest.mark.release),
        1e6,
        pytest.param(1e9, marks=pytest.mark.release),
        np.inf,
    ],
)
def test_no_ratio_of_bulk_to_shear_modulus_locks(ratio: float, comm: MPI.Intracomm) -> None:
    """The tip is within 1 % of beam theory's with Young's modulus ``E = 9 K mu/(3 K + mu)``."""
    d1 = "incompressible" if ratio == np.inf else ratio * MU / 2
    young = 3 * MU if ratio == np.inf else 9 * ratio * MU / (3 * ratio + 1)
    law = {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": d1}
    result = solve("nearly-incompressible-beam", comm, material=law, **FINE)
    theory = sagging_tip(PER_LENGTH * LENGTH**3 / (young * BENDING)) * LENGTH
    error = np.linalg.norm(tip(result)[:2] - theory) / np.linalg.norm(theory)
    print(f"K/mu = {ratio:g}: tip {tip(result)[:2]} m, theory {theory} m, {100 * error:.2f} % apart; {effort(result)}")
    assert error < 0.01


@pytest.mark.release
def test_the_beam_does_not_stiffen_on_the_way_to_incompressible(comm: MPI.Intracomm) -> None:
    tips = (
        solve("nearly-incompressible-beam", comm),
        solve(
            "nearly-incompressible-beam",
            comm,
            material={"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": "incompressible"},
        ),
    )
    difference = np.linalg.norm(tip(tips[0]) - tip(tips[1])) / np.linalg.norm(tip(tips[1]))
    print(f"K/mu = 1e9 against incompressible: {difference:.1e}")
    assert difference < 1e-8


# Loads


@pytest.mark.release
@pytest.mark.parametrize("factor", [pytest.param(2.0, marks=pytest.mark.release), 8.0])
def test_sagging_under_up_to_eight_times_its_weight(factor: float, comm: MPI.Intracomm) -> None:
    result = solve("eightfold-gravity", comm, **weight(factor))
    theory = sagging_tip(factor * PER_LENGTH * LENGTH**3 / (3 * MU * BENDING)) * LENGTH
    error = np.linalg.norm(tip(result)[:2] - theory) / np.linalg.norm(theory)
    print(f"{factor:g} times: tip {tip(result)[:2]} m, theory {theory} m, {100 * error:.2f} % apart; {effort(result)}")
    assert error < 0.02  # 1.0 % with twice the weight on cells of this size, half of it on cells half as long


@pytest.mark.release
@pytest.mark.parametrize(
    "factor", [pytest.param(1.0, marks=pytest.mark.release), pytest.param(4.0, marks=pytest.mark.release), 8.0]
)
def test_the_coil_that_is_straight_under_up_to_eight_times_its_weight(factor: float, comm: MPI.Intracomm) -> None:
    """Distances between points of the axis agree with the theory, whatever the clamp does at its end."""
    points = [{"name": f"at-{s:.0%}"[:-1], "of": "displacement", "at": [s * LENGTH, 0, 0]} for s in HELD]
    result = solve("coil-through-itself", comm, **weight(factor), quantities=points, **FINE)
    u = np.array(list(result.quantities.values()))
    axis_points = np.outer(HELD, [LENGTH, 0, 0]) - u
    q = factor * PER_LENGTH
    axis = curled_axis(lambda s: (q * (LENGTH - s) ** 2 / 2, q * (LENGTH - s)), DIAMETER / 2, LENGTH, C1, C2, steps=400)
    theory = axis[(400 * np.array(HELD)).astype(int)]
    pairs = np.triu_indices(len(HELD), 1)

    def distances(points: np.ndarray) -> np.ndarray:
        apart: np.ndarray = np.linalg.norm(points[:, None] - points, axis=2)[pairs] / LENGTH
        return apart

    error = np.abs(distances(axis_points) - distances(theory)).max()
    print(
        f"{factor:g} times: distances {distances(axis_points).round(5)}, {error:.1e} of the length off;"
        f" {effort(result)}"
    )
    assert error < 2e-5 * factor**2
    assert np.abs(axis_points[:, 2]).max() < 1e-3 * LENGTH


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
def test_strains_of_1e_10_agree_with_linear_elasticity(analysis: str, comm: MPI.Intracomm) -> None:
    result = solve("featherweight-beam", comm, analysis=analysis)
    linear = linear_elasticity(result)
    difference = np.abs(result.solutions[0].displacement.x.array - linear).max() / np.abs(linear).max()
    print(f"{analysis}: largest displacement {np.abs(linear).max():.6e} m, {difference:.1e} from linear elasticity")
    assert difference < 1e-7


def linear_elasticity(result: Result) -> np.ndarray:
    """Displacement (m) of the featherweight beam: ``2 mu dev ε - p I`` balances the weight, ``tr ε = -p/K``."""
    mesh, length = result.body.mesh, result.body.length_scale
    unknowns = Unknowns(mesh, 2, 1)
    (u, p), (v, q) = ufl.TrialFunctions(unknowns.space), (unknowns.v, unknowns.q)
    dx = ufl.dx(metadata={"quadrature_degree": 2})
    bulk = 2 * 7.965272689e8 / MU  # stresses are in units of mu
    strain = ufl.sym(ufl.grad(u))
    a = ufl.inner(2 * ufl.dev(strain), ufl.grad(v)) - p * ufl.div(v) - q * (ufl.tr(strain) + p / bulk)
    force = fem.Constant(mesh, (0.0, -1e-10 * DENSITY * GRAVITY * length / MU, 0.0))
    held = [
        fem.dirichletbc(0.0, fem.locate_dofs_topological(part, 2, result.body.facets("clamp")), part)
        for part in map(unknowns.displacement_component, range(3))
    ]
    options = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    problem = LinearProblem(
        a * dx,
        ufl.inner(force, v) * dx,
        bcs=held,
        u=unknowns.state,
        petsc_options_prefix="linear_",
        petsc_options=options,
    )
    problem.solve()
    displacement: np.ndarray = unknowns.displacement().x.array * length
    return displacement


def test_the_displacement_is_proportional_to_a_small_load(comm: MPI.Intracomm) -> None:
    slopes = [tip(solve("featherweight-beam", comm, **weight(f)))[1] / f for f in (1e-10, 1e-6)]
    print(f"tip displacement per load: {slopes} m")
    assert np.ptp(slopes) < 1e-9 * abs(slopes[0])


# Units and sizes

PLAIN = {
    "mesh": {"length": "0.182 m", "diameter": "0.0085 m", "size": "0.004 m"},
    "material": {"law": "mooney-rivlin", "c1": "101709.668 Pa", "c2": "151065.460 Pa", "d1": "7.965272689e8 Pa"},
    "weight": ("9.81 m/s^2", "963 kg/m^3"),
    "tip": "0.182 m",
}
MICROMETRES = {
    "mesh": {"length": "182000 um", "diameter": "8500 um", "size": "4000 um"},
    "material": {"law": "mooney-rivlin", "c1": "101.709668 kPa", "c2": "151.065460 kPa", "d1": "7.965272689e5 kPa"},
    "weight": ("9.81e6 um/s^2", "9.63e-16 kg/um^3"),
    "tip": "182000 um",
}


def told_in(units: dict[str, Any], analysis: str) -> dict[str, Any]:
    g, density = units["weight"]
    return {
        "analysis": analysis,
        "mesh": {"file": "../../meshes/pdms_beam.py", "parameters": units["mesh"], "geometry_degree": 2},
        "material": units["material"],
        "effects": [{"effect": "gravity", "acceleration": [0, f"-{g}", 0], "density": density}],
        "quantities": [{"name": "tip", "of": "displacement", "at": [units["tip"], 0, 0]}],
    }


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
def test_units_change_neither_digits_nor_iterations(analysis: str, comm: MPI.Intracomm) -> None:
    results = [solve("micrometre-beam", comm, **told_in(u, analysis)) for u in (PLAIN, MICROMETRES)]
    same_digits_and_iterations(results, [1.0, 1.0], analysis)


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
def test_bodies_of_a_micrometre_and_a_kilometre_are_alike(analysis: str, comm: MPI.Intracomm) -> None:
    """The load is ``ρ g L/mu`` and the same for all, the mesh is made in units of the body."""
    lengths = [1.82e-6, 1.82e3]
    results = [
        solve(
            "micrometre-beam",
            comm,
            analysis=analysis,
            mesh={
                "file": "../../meshes/pdms_beam.py",
                "parameters": {"length": L, "diameter": L * DIAMETER / LENGTH, "size": L * 4e-3 / LENGTH},
                "unit": L / 1.82,
                "geometry_degree": 2,
            },
            effects=[{"effect": "gravity", "acceleration": [0, -GRAVITY, 0], "density": DENSITY * LENGTH / L}],
            quantities=[{"name": "tip", "of": "displacement", "at": [L, 0, 0]}],
        )
        for L in lengths
    ]
    same_digits_and_iterations(results, lengths, analysis)


def same_digits_and_iterations(results: list[Result], lengths: list[float], what: str) -> None:
    tips = np.array([tip(result) / length for result, length in zip(results, lengths, strict=True)])
    difference = np.abs(tips - tips[0]).max() / np.abs(tips[0]).max()
    efforts = [effort(result) for result in results]
    print(f"{what}: {difference:.1e} apart, iterations and factorizations {efforts}")
    assert difference < 1e-9
    assert efforts[1:] == efforts[:-1]


# Slenderness


@pytest.mark.everyday("200")
@pytest.mark.parametrize("slenderness", [20, 200])
def test_slender_beams_recovered(slenderness: int, comm: MPI.Intracomm) -> None:
    """``θ = K/6 (1 - (1 - s)³)`` before, so that the beam is straight under its weight."""
    s = np.linspace(0, 1, 2001)
    angle = 8.3 / 6 * (1 - (1 - s) ** 3)
    theory = [1 - np.trapezoid(np.cos(angle), s), -np.trapezoid(np.sin(angle), s)]
    compare_slender(solve("slender-beam", comm, **slender(slenderness)), np.array(theory), slenderness)


@pytest.mark.release
@pytest.mark.parametrize("slenderness", [20, 200])
def test_slender_beams_sagging(slenderness: int, comm: MPI.Intracomm) -> None:
    result = solve("sagging-slender-beam", comm, **slender(slenderness))
    compare_slender(result, sagging_tip(8.3), slenderness)


def slender(slenderness: int) -> dict[str, Any]:
    """Beams of one length and the load of one sag, ``q L³/(E I) = 8.3``."""
    length, thickness = 0.2, 0.2 / slenderness
    sides = dict.fromkeys(("ly", "lz"), thickness)
    parameters = {"lx": length, **sides, "nx": 40, "ny": 1, "nz": 1, "hexahedra": True}
    density = 8.3 * 3e5 * thickness**2 / 12 / length**3 / GRAVITY
    return {
        "mesh": {"file": "../../meshes/box.py", "parameters": parameters, "geometry_degree": 2},
        "effects": [{"effect": "gravity", "acceleration": [0, -GRAVITY, 0], "density": density}],
        "quantities": [{"name": "tip", "of": "displacement", "at": [length, thickness / 2, thickness / 2]}],
    }


def compare_slender(result: Result, theory: np.ndarray, slenderness: int) -> None:
    error = np.linalg.norm(tip(result)[:2] / 0.2 - theory) / np.linalg.norm(theory)
    print(f"L/d = {slenderness}: {100 * error:.2f} % from theory; {effort(result)}")
    assert error < (0.003 if slenderness == 200 else 0.02)
