"""Size, volume, mass and load of what a job describes, and warnings that point at a mistake in a unit."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK, ROOT, hpcinv_here, write_job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.quantity.units import readable
from hpcinv.job.job import parse
from hpcinv.mesh import build_body
from hpcinv.results.totals import Totals, totals_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.workspace import Workspace

GRAVITY = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}


def block(side: float, **changes: Any) -> dict[str, Any]:
    """A cube of soft tissue under its weight."""
    mesh = {"file": str(ROOT / "meshes" / "box.py"), "parameters": {"nx": 2, "ny": 2, "nz": 2}}
    mesh["parameters"] |= dict.fromkeys(("lx", "ly", "lz"), side)  # type: ignore[attr-defined]
    material = {"law": "neo-hookean", "young": "3 kPa", "poisson": 0.4}
    return BLOCK | {"mesh": mesh, "material": material, "effects": [GRAVITY], "quantities": []} | changes


def totals(comm: MPI.Intracomm, **job: Any) -> Totals:
    case = parse(job, Path("job.yaml"))
    body = build_body(case.mesh, case.regions, comm, resolve=case.resolve)
    return totals_of(Equations(case, body, Timings()), case.plan[0])


@pytest.mark.everyday("1000", "2000*X/(10 cm)")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("density", [1000, {"block": 1000}, "2000*X/(10 cm)"])
def test_a_cube_has_the_size_mass_and_weight_it_has(comm: MPI.Intracomm, density: Any) -> None:
    body_totals = totals(comm, **block(0.1, effects=[GRAVITY | {"density": density}]))
    assert body_totals.size == pytest.approx((0.1, 0.1, 0.1), rel=1e-14)
    assert body_totals.volume == pytest.approx(1e-3, rel=1e-13)
    assert body_totals.mass == pytest.approx(1.0, rel=1e-12)
    assert body_totals.load == pytest.approx((0, 0, -9.81), rel=1e-12, abs=0)
    assert body_totals.weight_strain == pytest.approx(1000 * 9.81 * 0.1 / 3e3, rel=1e-12)
    assert body_totals.warnings == ()


@pytest.mark.everyday("False")
@pytest.mark.parametrize("hexahedra", [False, True])
def test_curved_cells_have_their_volume_and_surface_loads_their_resultant(hexahedra: bool) -> None:
    """An octant of a sphere under inner pressure, whose resultant is that on its three plane projections."""
    pressure = {"effect": "pressure", "region": "inner", "pressure": 500.0}
    mesh = {"file": str(ROOT / "meshes" / "thick_sphere.py"), "geometry_degree": 2}
    mesh |= {"parameters": {"hexahedra": hexahedra}}  # type: ignore[dict-item]
    supports = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    body_totals = totals(MPI.COMM_SELF, **block(1, mesh=mesh, effects=[pressure], supports=supports))
    assert body_totals.volume == pytest.approx(math.pi / 6 * (1 - 0.125), rel=2e-4)
    assert (body_totals.mass, body_totals.weight_strain) == (None, None)
    assert body_totals.load == pytest.approx(np.full(3, 500 * math.pi / 4 * 0.25), rel=2e-3)


@pytest.mark.release
def test_a_fluid_has_no_mass_of_the_body() -> None:
    water = {"effect": "hydrostatic-pressure", "region": "x1", "density": 1000, "acceleration": [0, 0, -9.81]}
    water["level"] = [0, 0, 0.2]
    alone = totals(MPI.COMM_SELF, **block(0.1, effects=[water]))
    assert (alone.mass, alone.weight_strain) == (None, None)
    both = totals(MPI.COMM_SELF, **block(0.1, effects=[water, GRAVITY | {"density": 500}]))
    assert both.mass == pytest.approx(0.5, rel=1e-12)
    assert both.warnings == ()


def test_states_have_the_loads_of_the_solved_state() -> None:
    """Several states share equations, which have had the numbers of the last one."""
    side = GRAVITY | {"acceleration": [0, 0, 3]}
    states = [
        {"name": "down", "given": True, "effects": [GRAVITY | {"acceleration": [0, -9.81, 0]}]},
        {"name": "rest"},
        {"name": "side", "effects": [side]},
    ]
    case = parse({k: v for k, v in block(0.1, states=states).items() if k != "effects"}, Path("job.yaml"))
    with Workspace(MPI.COMM_SELF) as workspace:
        equations = workspace.equations(case, workspace.body(case), Timings())
        found = [totals_of(own, step) for own, step in zip(equations, case.plan, strict=True)]
        assert equations[0] is equations[1]
    assert found[0].load == pytest.approx((0, -9.81, 0), rel=1e-12, abs=0)
    assert found[1].load == pytest.approx((0, 0, 3), rel=1e-12, abs=0)
    assert found[0].weight_strain == pytest.approx(1000 * 9.81 * 0.1 / 3e3, rel=1e-12)


def test_loads_that_cancel_have_no_resultant() -> None:
    pull = [
        {"effect": "traction", "region": f"x{i}", "traction": [sign * 100.0, 0, 0], "area_in": "reference"}
        for i, sign in ((0, -1), (1, 1))
    ]
    assert totals(MPI.COMM_SELF, **block(0.1, effects=pull)).load == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("job", "text"),
    [
        (block(0.12e-3), "the body is 120 µm long: is mesh.unit (m) what its mesh is in?"),
        (block(120.0), "the body is 120 m long: is mesh.unit (m)"),
        (block(1.2), "the largest Young's modulus: check units of mesh, density and moduli"),
        (block(0.1, effects=[GRAVITY | {"density": 1.05}]), "the mean density is 1.05 kg/m^3"),
        (block(0.1, effects=[GRAVITY | {"density": 1.05e6}]), "the mean density is 1.05e+06 kg/m^3"),
        (
            block(0.1, effects=[GRAVITY, GRAVITY | {"density": 1100, "case": "b"}], load_cases=["a", "b"]),
            "effects give the body masses of 1 kg to 1.1 kg",
        ),
        (
            block(0.1, regions={"foot": "z < 5"}, supports=[{"region": "foot", "fix": ["x", "y", "z"]}]),
            "region 'foot' is the whole boundary: 'z < 5' holds all over it (numbers without a unit are in m)",
        ),
        (
            block(0.1, material={"law": "isochoric-neo-hookean", "mu": "100 kPa", "kappa": "10 kPa"}),
            "material: Poisson's ratio is -0.65, as the bulk modulus (1e+04 Pa) is below 2/3 of the shear modulus "
            "(1e+05 Pa); kappa: bulk modulus",
        ),
        (
            block(0.1, material={"law": "mooney-rivlin", "c1": "0.9 MPa", "c2": 0, "d1": 2e-10}),
            "material: Poisson's ratio is -1, as the bulk modulus (4e-10 Pa) is below 2/3 of the shear modulus "
            "(1.8e+06 Pa); d1: half the bulk modulus, the coefficient of (J - 1)² (Abaqus's D1 is 1/d1)",
        ),
        (
            block(0.1, effects=[{"effect": "pressure", "region": "boundary", "pressure": "1 MPa"}]),
            "times the bulk modulus of the stiffest part, so that volumes collapse: lam: Lamé's",
        ),
    ],
)
def test_probable_unit_mistakes_are_warned_of(job: dict[str, Any], text: str) -> None:
    assert any(text in warning for warning in totals(MPI.COMM_SELF, **job).warnings)


def test_unit_mistakes_are_not_warned_of_if_units_are_confirmed() -> None:
    confirmed = totals(MPI.COMM_SELF, **block(120.0), output={"unit_warnings": False, "mesh": []})
    assert confirmed.warnings == ()


@pytest.mark.parametrize(
    "material",
    [
        {"law": "neo-hookean", "young": "3 kPa", "poisson": -0.3},
        {"law": "isochoric-neo-hookean", "mu": "3 kPa", "kappa": "1.9999999999 kPa"},
        {"law": "isochoric-neo-hookean", "mu": "3 kPa", "kappa": "incompressible"},
    ],
)
def test_plausible_moduli_cause_no_warning(material: dict[str, Any]) -> None:
    assert totals(MPI.COMM_SELF, **block(0.01, material=material)).warnings == ()


@pytest.mark.parallel([2])
def test_loads_that_vanish_in_floating_point_numbers_are_reported(comm: MPI.Intracomm) -> None:
    def stiff(young: float, **changes: Any) -> dict[str, Any]:
        return block(0.1, material={"law": "neo-hookean", "young": young, "poisson": 0.4}, **changes)

    text = "as little as rounding errors"
    for young, is_told in ((1e300, True), (1e140, False)):
        assert any(text in warning for warning in totals(comm, **stiff(young)).warnings) == is_told
    assert totals(comm, **stiff(1e300, effects=[])).warnings == ()


def test_a_body_without_loads_is_not_told_to_check_its_units() -> None:
    body = Totals(size=(1, 1, 1), volume=1, mass=None, load=None, weight_strain=None)
    assert body.warned(0.0, lambda: 0.0).warnings == (
        "nothing loads the body: state 'effects', or displacements of supports",
    )
    assert "check units" in body.warned(0.0, lambda: 1e-9).warnings[0]


def test_a_body_that_hardly_moves_is_reported_at_the_end(tmp_path: Path) -> None:
    """On screen, quiet or not, in the summary and in the log; it changes neither verdict nor exit code."""
    stiff = {"law": "neo-hookean", "young": 3e9, "poisson": 0.4}
    job = write_job(tmp_path / "stiff.yaml", block(0.1, material=stiff), output={"mesh": []})
    done = hpcinv_here("run", job, "--output", "run", "--strict", "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    warning, last = done.stdout.splitlines()
    assert warning.startswith("warning: the largest displacement is ")
    assert last.startswith("converged, certificate pass, ")
    assert last.endswith("; results in run")
    assert "warning: the largest displacement" in (tmp_path / "run" / "run.log").read_text()
    body = json.loads((tmp_path / "run" / "summary.json").read_text())["body"]
    assert body["weight_strain"] == pytest.approx(3.27e-7)
    assert body["warnings"] == [warning.removeprefix("warning: ")]
    meant = write_job(tmp_path / "stiff.yaml", block(0.1), output={"unit_warnings": False, "mesh": []})
    assert "warning" not in hpcinv_here("run", meant, "--output", "meant", cwd=tmp_path).stdout


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.182, "m", "182 mm"),
        (0.0, "N", "0 N"),
        (1.033e-5, "m^3", "10.3 ml"),
        (-2e3, "kg", "-2 t"),
        (3e-12, "m", "0.003 nm"),
        (0.99999999, "kg", "1 kg"),
    ],
)
def test_values_are_shown_with_a_prefix(value: float, unit: str, text: str) -> None:
    assert readable(value, unit) == text


def test_the_cases_of_a_sweep_end_with_their_warnings(tmp_path: Path) -> None:
    write_job(tmp_path / "job.yaml", block(0.1, output={"fields": False, "mesh": []}))
    axes = [{"grid": {"effects[0].density": ["1000 kg/m^3", "1.05 kg/m^3"]}}]
    (tmp_path / "sweep.yaml").write_text(json.dumps({"sweep": "s", "job": "job.yaml", "axes": axes}))
    done = hpcinv_here("sweep", "run", "sweep.yaml", "--no-isolation", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    cases = [line for line in done.stdout.splitlines() if line.startswith("case ")]
    assert [line.count("; warning: the mean density is 1.05 kg/m^3") for line in cases] == [0, 1]
