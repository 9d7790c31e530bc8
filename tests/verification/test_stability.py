"""The certificate's stability line on both sides of exact limits: what is stable never fails, what is not does."""

from __future__ import annotations

import json
from math import pi, tanh
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE, ROOT, hpcinv_here, write_job
from helpers.verification import box, job
from petsc4py import PETSc

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations
from hpcinv.studies.batch.status import Status, lines
from hpcinv.trust.certificate import Line, Verdict
from hpcinv.trust.certificate.stability import _unstable, stability
from hpcinv.trust.stability.confirmation import Confirmed
from hpcinv.trust.stability.forward_factors import ForwardFactors
from hpcinv.trust.stability.inertia import inertia

STABILITY = NO_CERTIFICATE | {"stability": True}
NEO_HOOKEAN = {"law": "isochoric-neo-hookean", "mu": 1.0, "kappa": "incompressible"}
PLANE = [{"region": "z0", "fix": ["z"]}, {"region": "z1", "fix": ["z"]}]
"""Plane strain."""


def line_of(case_job: Job, comm: MPI.Intracomm) -> Line:
    (line,) = (line for line in hpcinv.run(case_job, comm).certificate.lines if line.name.startswith("stability"))
    print(f"{line.verdict.value}: {line.value} ({line.note})")
    return line


# A block between smooth plates, free above and below, in plane strain. With s = λ² and k over the current length it
# barrels where 4s tanh(kh) = (1 + s²)² tanh(ksh), and buckles where 4s tanh(ksh) = (1 + s²)² tanh(kh).

SURFACE = root(lambda stretch: 4 * stretch**2 - (1 + stretch**4) ** 2, 0.3, 0.8)  # of either for short waves


def half_block(stretch: float, divisions: int, *, hexahedra: bool, **changes: Any) -> Job:
    """On a plane of symmetry, so that it can barrel alone."""
    data = {
        "analysis": "forward",
        "mesh": box((divisions, divisions, 1), lz=0.2, hexahedra=hexahedra),
        "material": NEO_HOOKEAN,
        "supports": [
            {"region": "x0", "fix": ["x"]},
            {"region": "x1", "displacement": [stretch - 1, None, None]},
            {"region": "y0", "fix": ["y"]},
            *PLANE,
        ],
        "certificate": STABILITY,
    }
    return job(**data | changes)


@pytest.mark.everyday("4")
@pytest.mark.parametrize("divisions", [4, 6])
def test_spurious_modes_of_hexahedra_are_not_taken_for_instabilities(divisions: int, comm: MPI.Intracomm) -> None:
    line = line_of(half_block(0.75, divisions, hexahedra=True), comm)
    assert line.verdict is Verdict.UNDECIDED
    assert line.value is not None
    assert line.value > 0
    assert "spurious" in line.note


@pytest.mark.everyday("0.65-False")
@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("share", [0.65, 0.97])
def test_a_block_short_of_its_surface_instability_does_not_fail(
    share: float, hexahedra: bool, comm: MPI.Intracomm
) -> None:
    """``share`` of the critical strain, where some 3 to 12 eigenvalues of the mixed tangent are negative at last."""
    line = line_of(half_block(1 - share * (1 - SURFACE), 8, hexahedra=hexahedra), comm)
    assert line.verdict is not Verdict.FAIL
    if share == 0.65 and not hexahedra:
        assert line.verdict is Verdict.PASS


@pytest.mark.everyday("False")
@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_block_beyond_its_surface_instability_fails(hexahedra: bool, comm: MPI.Intracomm) -> None:
    line = line_of(half_block(1 - 1.12 * (1 - SURFACE), 8, hexahedra=hexahedra), comm)
    assert line.verdict is Verdict.FAIL
    assert line.value is not None
    assert 1 <= line.value <= 3


@pytest.mark.everyday("displacement-Verdict.PASS")
@pytest.mark.parametrize(("formulation", "verdict"), [("displacement", Verdict.PASS), ("mixed", Verdict.UNDECIDED)])
def test_a_compressible_block_short_of_its_limit(formulation: str, verdict: Verdict, comm: MPI.Intracomm) -> None:
    material = NEO_HOOKEAN | {"kappa": 20.0}
    spaces = {"formulation": formulation}
    assert (
        line_of(half_block(0.75, 6, hexahedra=True, material=material, discretisation=spaces), comm).verdict is verdict
    )


@pytest.mark.everyday("False-1.5", "True-4.0")
@pytest.mark.parametrize("stretch", [1.5, 4.0])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_block_under_tension_is_stable(stretch: float, hexahedra: bool, comm: MPI.Intracomm) -> None:
    line = line_of(half_block(stretch, 3, hexahedra=hexahedra), comm)
    assert (line.value, line.verdict) == (0.0, Verdict.PASS)
    assert line.note.startswith("no negative eigenvalue of the forward tangent")


def buckling(kh: float) -> float:
    """The stretch; no other root lies between it and 1, which is not a mode."""
    return root(lambda s: 4 * s**2 * tanh(kh * s**2) - (1 + s**4) ** 2 * tanh(kh), 0.6, 1 - 1e-4)


@pytest.mark.everyday(
    "incompressible-True-0.3-divisions0-0.98-0",
    "incompressible-True-1.0-divisions1-1.1-1",
    "incompressible-False-0.3-divisions0-1.1-1",
    "200.0-True-0.3-divisions0-0.98-0",
)
@pytest.mark.parametrize(("share", "unstable"), [(0.98, 0), (1.1, 1)])
@pytest.mark.parametrize(("kh", "divisions"), [(0.3, (8, 2, 1)), (1.0, (8, 4, 1))])
@pytest.mark.parametrize(
    ("kappa", "hexahedra"), [("incompressible", True), ("incompressible", False), (200.0, True), (100.0, False)]
)
def test_a_block_buckles_where_theory_has_it(
    kappa: Any, hexahedra: bool, kh: float, divisions: tuple[int, int, int], share: float, unstable: int, comm: Any
) -> None:
    """Of finite bulk modulus in the displacement form; the critical strain changes by about μ/3κ."""
    critical = buckling(kh)
    assert critical == pytest.approx({0.3: 0.9730312, 1.0: 0.8358313}[kh], abs=1e-7)  # two roots known from elsewhere
    case_job = job(
        analysis="forward",
        mesh=box(divisions, ly=2 * kh * critical**2 / pi, lz=0.1, hexahedra=hexahedra),
        material=NEO_HOOKEAN | {"kappa": kappa},
        # Soft springs keep it from moving up and down as a whole.
        effects=[{"effect": "elastic-foundation", "region": "x0", "tangential": 1e-5}],
        supports=[
            {"region": "x0", "fix": ["x"]},
            {"region": "x1", "displacement": [-share * (1 - critical), None, None]},
            *PLANE,
        ],
        discretisation={"formulation": "mixed" if kappa == "incompressible" else "displacement"},
        certificate=STABILITY,
    )
    line = line_of(case_job, comm)
    if unstable:
        assert (line.value, line.verdict) == (1.0, Verdict.FAIL)
    else:
        assert line.verdict is not Verdict.FAIL


# Bending: a straight block to a sector of radii 1 and 2 (Rivlin); its inner face is pressed to 0.71, short of its limit


@pytest.mark.everyday("False")  # hexahedra have spurious modes, as above
@pytest.mark.parametrize(
    ("hexahedra", "divisions", "verdict"), [(True, 4, Verdict.UNDECIDED), (False, 4, Verdict.PASS)]
)
def test_a_block_bent_to_a_sector_does_not_fail(
    hexahedra: bool, divisions: int, verdict: Verdict, comm: MPI.Intracomm
) -> None:
    a = 2**0.5
    thickness, length = 3 / (2 * a), a * pi / 4
    turned = [f"sqrt(1 + {2 * a}*x/(1 m))*{f}(y/({a}*1 m))*(1 m) - {x}" for f, x in (("cos", "x"), ("sin", "y"))]
    mesh = box((divisions, divisions, 1), lx=thickness, ly=length, lz=0.3, hexahedra=hexahedra)
    bent = job(
        analysis="forward",
        mesh=mesh | {"geometry_degree": 2},
        material=NEO_HOOKEAN,
        supports=[{"region": "y0", "fix": ["y"]}, {"region": "y1", "displacement": [*turned, None]}, *PLANE],
        certificate=STABILITY,
    )
    assert line_of(bent, comm).verdict is verdict


# A sphere under inner pressure


def pressure(stretch: float, ratio: float) -> float:
    """Of an incompressible neo-Hookean sphere of μ = 1 and of radii 1 and ``ratio``, by the stretch within."""
    outer = (ratio**3 - 1 + stretch**3) ** (1 / 3) / ratio
    return (4 / outer + outer**-4 - 4 / stretch - stretch**-4) / 2


def slope(stretch: float, ratio: float) -> float:
    outer = (ratio**3 - 1 + stretch**3) ** (1 / 3) / ratio
    by = stretch**2 / (outer**2 * ratio**3)
    return ((-4 * outer**-2 - 4 * outer**-5) * by + 4 * stretch**-2 + 4 * stretch**-5) / 2


@pytest.mark.everyday("False-0.9-0", "False-1.1-1")
@pytest.mark.parametrize(("share", "unstable"), [(0.9, 0), (1.1, 1)])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_sphere_beyond_its_largest_pressure_is_unstable(
    share: float, unstable: int, hexahedra: bool, comm: MPI.Intracomm
) -> None:
    """Of its equilibria the one with ``share`` of the limit point's strain, on the way down too."""
    limit = root(lambda stretch: slope(stretch, 1.5), 1.1, 3.0)
    stretch = 1 + share * (limit - 1)
    mesh = {"inner": 1.0, "outer": 1.5, "radial": 2, "along": 2, "hexahedra": hexahedra}
    sphere_job = job(
        analysis="forward",
        mesh={"file": "../meshes/thick_sphere.py", "parameters": mesh, "geometry_degree": 2},
        material=NEO_HOOKEAN,
        effects=[{"effect": "pressure", "region": "inner", "pressure": pressure(stretch, 1.5)}],
        supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        certificate=STABILITY,
    )
    body = build_body(sphere_job.mesh, sphere_job.regions, comm, resolve=sphere_job.resolve)
    model = Equations(sphere_job, body, Timings())
    u, p = model.state().fields
    length = body.length_scale

    def exact(x: np.ndarray) -> np.ndarray:
        radius = length * np.linalg.norm(x, axis=0)
        moved: np.ndarray = (np.cbrt(radius**3 - 1 + stretch**3) / radius - 1) * x * length
        return moved

    u.interpolate(exact)
    model.put_fields((u, p))
    equilibrium = model.equilibrium(model.weak_form("forward"))
    assert equilibrium.solve(1.0, 1e-10).outcome.accepted
    model.release(equilibrium)
    displacement, p = model.state().fields
    moved = np.abs(displacement.x.array - u.x.array).max() / np.abs(u.x.array).max()
    assert moved < 0.08  # it is that equilibrium, and not the one beyond the limit point, about 0.2 away
    nodes = body.mesh.geometry.x * length
    solution: Any = SimpleNamespace(
        job=sphere_job,
        direction="forward",
        fields=(displacement, p),
        displacement=displacement,
        pressure=p,
        mesh_nodes=nodes,
        reference_nodes=nodes,
        moved_to=lambda _: model.state(),
        solves=(),
        cavities=(),
        linear=None,
    )
    (line,) = stability(model, ForwardFactors(model, solution))
    print(line)
    assert (line.value, line.verdict) == (unstable, Verdict.FAIL if unstable else Verdict.PASS)
    model.destroy()


# Where the mesh shows less than the body


def cantilever(density: float, **changes: Any) -> Job:
    """Sags under its weight by about its length."""
    return job(
        mesh=box((6, 2, 2), lx=1.0, ly=0.3, lz=0.3, hexahedra=True) | changes.pop("mesh", {}),
        material={"law": "neo-hookean", "young": 1e5, "poisson": 0.3},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": density}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        **({"certificate": STABILITY | {"round_trip": "near"}} | changes),
    )


@pytest.mark.everyday("1-850.0", "2-300.0")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize(("density", "unstable"), [(300.0, 0), (850.0, 1)])
@pytest.mark.parametrize("geometry_degree", [1, 2])
def test_stability_does_not_depend_on_the_degree_of_the_given_cells(
    geometry_degree: int, density: float, unstable: int, comm: MPI.Intracomm
) -> None:
    line = line_of(cantilever(density, mesh={"geometry_degree": geometry_degree}), comm)
    assert (line.value, line.verdict) == (unstable, Verdict.FAIL if unstable else Verdict.PASS)


def test_without_factors_straight_cells_are_judged_too(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in bodies that are too large for factors."""
    monkeypatch.setattr(ForwardFactors, "affordable", False)
    line = line_of(cantilever(200.0), comm)
    assert (line.value, line.verdict) == (0.0, Verdict.PASS)
    assert "estimated" in line.note


@pytest.mark.parametrize("is_half", [False, True])
def test_a_half_of_a_column_says_that_it_cannot_buckle_sideways(is_half: bool, comm: MPI.Intracomm) -> None:
    """Under about twice Euler's load, about the axis that the plane of symmetry y0 excludes."""
    half = [{"region": "y0", "fix": ["y"]}] if is_half else []
    column_job = job(
        analysis="forward",
        mesh=box((10, 1 if is_half else 2, 2), lx=1.0, ly=0.05 if is_half else 0.1, lz=0.2, hexahedra=True),
        material={"law": "neo-hookean", "young": 1e6, "poisson": 0.0},
        effects=[{"effect": "traction", "region": "x1", "traction": [-4e3, 0, 0], "area_in": "reference"}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}, *half],
        certificate=STABILITY,
    )
    line = line_of(column_job, comm)
    assert line.verdict is (Verdict.PASS if is_half else Verdict.FAIL)
    assert ("motions that are not symmetric about 'y0' are left out" in line.note) == is_half


# Laws, effects and fibres together


@pytest.mark.everyday("1.5-2")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize(("share", "unstable"), [(0.7, 0), (1.5, 2)])
def test_a_column_of_two_laws_fibres_and_growth_buckles_at_eulers_load(
    share: float, unstable: int, comm: MPI.Intracomm
) -> None:
    """Euler's column, clamped below, of equal small-strain stiffness throughout.

    It is incompressible above and compressible below, with weak fibres seen on the loaded body, and it has shrunk.
    """
    length, side, young, shrunk = 1.0, 0.05, 1e6, 0.98
    euler = pi**2 * young * side**4 / 12 / (4 * length**2) * shrunk**2
    fibred = {
        "law": "holzapfel-gasser-ogden",
        "mu": young / 3,
        "k1": 1.0,
        "k2": 1.0,
        "dispersion": 0.1,
        "kappa": "incompressible",
        "fibres": ["axial"],
    }
    column_job = job(
        analysis="forward",
        mesh=box((1, 1, 4), lx=side, ly=side, lz=length, hexahedra=True),
        regions={"top": "z > 0.49", "bottom": "z < 0.51"},
        material={"top": fibred, "bottom": {"law": "neo-hookean", "young": young, "poisson": 0.3}},
        fibres={"axial": {"direction": [0, 0, 1], "given_on": "current"}},
        effects=[
            {
                "effect": "traction",
                "region": "z1",
                "area_in": "reference",
                "traction": [0, 0, -share * euler / side**2],
            },
            {"effect": "growth", "stretch": shrunk},
        ],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
        certificate=STABILITY,
    )
    line = line_of(column_job, comm)
    assert (line.value, line.verdict) == (unstable, Verdict.FAIL if unstable else Verdict.PASS)


# What cannot be decided, and what it does


def test_unconfirmed_instability_is_not_decided() -> None:
    lines = [
        _unstable(2, confirmed, is_mixed=mixed) for confirmed in (None, Confirmed(0, 0.0)) for mixed in (True, False)
    ]
    assert {(line.value, line.verdict) for line in lines} == {(2.0, Verdict.UNDECIDED)}
    assert len({line.note for line in lines}) == 3
    # Without a potential the symmetric part proves no instability.
    assert _unstable(2, Confirmed(2, 1e-3), is_mixed=True).verdict is Verdict.WARN
    some = _unstable(4, Confirmed(2, 0.0), is_mixed=True)
    assert (some.value, some.verdict) == (2.0, Verdict.FAIL)
    assert "of the 4" in some.note


def test_a_tangent_that_is_not_finite_has_no_inertia(comm: MPI.Intracomm) -> None:
    matrix = PETSc.Mat().createAIJ((3, 3), comm=comm)
    matrix.setUp()
    begin, end = matrix.getOwnershipRange()
    for i in range(begin, end):
        matrix.setValue(i, i, float("nan") if i == 1 else 1.0)
    matrix.assemble()
    assert inertia(matrix) is None


def test_undecided_verdict_on_screen_in_the_summary_and_in_the_exit_code(tmp_path: Path) -> None:
    block = half_block(0.75, 4, hexahedra=True)
    data: dict[str, Any] = {
        "analysis": "forward",
        "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": dict(block.mesh.parameters)},
        "material": NEO_HOOKEAN,
        "supports": [s.model_dump(exclude_none=True, mode="json") for s in block.supports],
        "certificate": STABILITY,
    }
    path = write_job(tmp_path / "block.yaml", data)
    ended = hpcinv_here("run", path, "--output", tmp_path / "out", "--strict", cwd=tmp_path)
    assert ended.returncode == 7, ended.stdout + ended.stderr
    assert "certificate: not decided" in ended.stdout
    assert "  not decided: stability: unstable directions 1 (" in ended.stdout
    paths = json.loads((tmp_path / "out" / "summary.json").read_text())["certificate"]
    assert paths["verdict"] == "not decided"
    undecided = [line["name"] for line in paths["lines"] if line["verdict"] == "not decided"]
    assert undecided == [
        "stability: unstable directions",
        "limit points of the path",
    ]  # the spurious mode changes the determinant's sign too


@pytest.mark.parametrize(("verdict", "strict"), [("pass", 0), ("not decided", 7), ("warning", 7), ("fail", 6)])
def test_a_sweep_counts_what_is_not_decided_like_a_warning(verdict: str, strict: int) -> None:
    status = Status("sweep", "cases", "sweep retry --failed", 1, {verdict: 1}, 0, {}, {}, None)
    assert status.exit_code(strict=True) == strict
    assert status.exit_code(strict=False) == (6 if verdict == "fail" else 0)
    assert f"    1 × certificate {verdict}" in lines(status)
