"""Reactions of supports against the loads that they balance, and against closed forms, in either direction and form."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, neo_hookean_stress, root, uniaxial
from helpers.command_line import BLOCK, hpcinv_here, write_job
from helpers.verification import box, job

from hpcinv import run
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import load
from hpcinv.output.text_report import report
from hpcinv.studies.batch.tables import unit_of

ABOUT = [0.3, -0.2, 0.4]
REACTIONS = [
    {"name": "grip", "of": "reaction", "on": "z0"},
    {"name": "torque", "of": "reaction_moment", "on": "z0"},
    {"name": "torque_about", "of": "reaction_moment", "on": "z0", "about": ABOUT},
]
CLAMPED = [{"region": "z0", "fix": ["x", "y", "z"]}]
FORMS = [{"formulation": "displacement", "displacement": 1}, {"formulation": "mixed", "displacement": 2}]
IDS = ["displacement", "mixed"]


def solved(comm: MPI.Intracomm, direction: str, **settings: Any) -> dict[str, Any]:
    # Round-off: the forces on the free nodes are what the reactions lack.
    solver = {"tolerance": 1e-12}
    quantities = run(job(analysis=direction, material=NEO_HOOKEAN, solver=solver, **settings), comm).quantities
    assert comm.allgather(quantities) == [quantities] * comm.size
    return dict(quantities)


def integral(name: str, formula: str, region: str) -> dict[str, str]:
    return {"name": name, "of": formula, "on": region, "reduce": "integral", "over": "reference"}


@pytest.mark.everyday("displacement")
@pytest.mark.parametrize("form", FORMS, ids=IDS)
@pytest.mark.parallel([1, 2])
def test_a_clamp_carries_the_weight_of_the_body(comm: MPI.Intracomm, form: dict[str, Any]) -> None:
    density, g = 60.0, np.array([3.0, 1.0, -10.0])
    gravity = {"effect": "gravity", "acceleration": g.tolist(), "density": density}
    # Volume and moments of the undeformed body's mass at its current place.
    volumes = [integral("V", "1", "block"), *(integral(f"V{axis}", axis, "block") for axis in "xyz")]
    for direction in ("forward", "inverse"):
        quantities = solved(
            comm,
            direction,
            mesh=box((2, 1, 2)),
            effects=[gravity],
            supports=CLAMPED,
            # Exact for the products of positions and the volume ratio of quadratic displacements.
            discretisation=form | {"quadrature": 6},
            quantities=REACTIONS + volumes,
        )
        mass, centre = density * quantities["V"], np.array([quantities[f"V{axis}"] for axis in "xyz"]) / quantities["V"]
        if direction == "forward":
            assert mass == pytest.approx(density, rel=1e-12)
            assert abs(centre[0] - 0.5) > 5e-3  # the body leans, and so the current and the given arms differ
        assert quantities["grip"] == pytest.approx(-mass * g, rel=1e-9)
        assert quantities["torque"] == pytest.approx(-np.cross(centre, mass * g), rel=1e-9, abs=1e-9 * mass)
        assert quantities["torque_about"] == pytest.approx(
            -np.cross(centre - ABOUT, mass * g), rel=1e-9, abs=1e-9 * mass
        )


@pytest.mark.release
@pytest.mark.parallel([3])
def test_a_clamp_carries_the_traction_on_the_opposite_face(comm: MPI.Intracomm) -> None:
    t = np.array([200.0, 0.0, 500.0])
    for direction, form in zip(("forward", "inverse"), FORMS, strict=True):
        quantities = solved(
            comm,
            direction,
            # Lengths in mm: the scales of force and moment are not 1.
            mesh=box((1, 1, 3), lx="10 mm", ly="10 mm", lz="20 mm"),
            effects=[{"effect": "traction", "region": "z1", "traction": t.tolist(), "area_in": "reference"}],
            supports=CLAMPED,
            discretisation=form | {"quadrature": 6},
            quantities=[*REACTIONS, integral("A", "1", "z1"), *(integral(f"A{axis}", axis, "z1") for axis in "xyz")],
        )
        force = t * quantities["A"]
        assert quantities["grip"] == pytest.approx(-force, rel=1e-9, abs=1e-9 * np.linalg.norm(force))
        moment = np.cross([quantities[f"A{axis}"] for axis in "xyz"], t)
        assert quantities["torque"] == pytest.approx(-moment, rel=1e-9, abs=1e-9 * np.linalg.norm(moment))


@pytest.mark.everyday("displacement")
@pytest.mark.parametrize("form", FORMS, ids=IDS)
@pytest.mark.parallel([2, 1])
def test_prescribed_tension_takes_the_force_of_the_closed_form(comm: MPI.Intracomm, form: dict[str, Any]) -> None:
    stretch = 1.25
    lateral = root(lambda s: float(neo_hookean_stress(uniaxial(stretch, s))[1, 1]), 0.8, 1.0)
    P = float(neo_hookean_stress(uniaxial(stretch, lateral), MU, LAM)[0, 0])
    faces = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    names = ("x1", "x0", "y0")
    for direction, pull, force in (
        ("forward", stretch - 1, P),
        ("inverse", 1 - 1 / stretch, P / lateral**2),  # the current cross-section has unit area
    ):
        quantities = solved(
            comm,
            direction,
            mesh=box((2, 1, 1)),
            supports=[*faces, {"region": "x1", "displacement": [str(pull), None, None]}],
            discretisation=form,
            quantities=[{"name": name, "of": "reaction", "on": name} for name in names]
            + [{"name": "moment", "of": "reaction_moment", "on": "x1"}],
        )
        side = lateral if direction == "forward" else 1.0
        near = {"rel": 1e-9, "abs": 1e-9 * force}
        assert quantities["x1"] == pytest.approx([force, 0, 0], **near)
        # Nodes at the edges of x0 belong to the sum of y0 as well, but only with what y0 prescribes.
        assert quantities["x0"] == pytest.approx([-force, 0, 0], **near)
        assert quantities["y0"] == pytest.approx([0, 0, 0], **near)
        assert quantities["moment"] == pytest.approx([0, force * side / 2, -force * side / 2], **near)


def test_a_node_of_two_supports_belongs_to_both_sums(comm: MPI.Intracomm) -> None:
    supports = [
        {"region": "boundary", "displacement": ["0.2*x", 0, 0]},
        {"region": "x1", "fix": ["y"]},
        {"region": "x1", "displacement": ["0.2*x", None, 0]},
    ]
    quantities = solved(
        comm,
        "forward",
        mesh=box((1, 1, 1)),
        supports=supports,
        discretisation={"displacement": 1},
        quantities=[{"name": name, "of": "reaction", "on": name} for name in ("x1", "boundary")],
    )
    P = neo_hookean_stress(uniaxial(1.2))
    assert quantities["boundary"] == pytest.approx([0, 0, 0], abs=1e-9 * P[0, 0])
    # The test functions of the nodes of x1 add up to x, with the virtual work of P in the whole cube.
    assert quantities["x1"][0] == pytest.approx(P[0, 0], rel=1e-9)


def test_reactions_that_vanish_by_balance_or_symmetry_are_zero(comm: MPI.Intracomm) -> None:
    supports = [
        {"region": "z0", "fix": ["z"]},
        {"region": "o", "fix": ["x", "y"]},
        {"region": "a", "fix": ["y"]},
    ]
    regions = {"o": {"vertices": [[0, 0, 0]]}, "a": {"vertices": [[1, 0, 0]]}}
    pull = {"effect": "traction", "region": "z1", "traction": [0, 0, 500.0], "area_in": "reference"}
    for direction in ("forward", "inverse"):
        quantities = solved(
            comm,
            direction,
            mesh=box((3, 2, 3)),
            regions=regions,
            supports=supports,
            effects=[pull],
            quantities=[
                *({"name": name, "of": "reaction", "on": name} for name in ("z0", "o", "a")),
                {"name": "about_o", "of": "reaction_moment", "on": "o"},
            ],
        )
        assert quantities["z0"][:2] == [0, 0]
        assert quantities["z0"][2] < -400
        assert quantities["o"] == quantities["a"] == quantities["about_o"] == [0, 0, 0]


def test_a_run_prints_reactions_and_what_is_unknown(tmp_path: Path) -> None:
    quantities = [{"name": "top", "of": "uz", "at": [0.5, 0.5, 1]}, *REACTIONS]
    changes = {
        "quantities": quantities,
        "sensitivities": {"material.mu": "1 kPa"},
        "certificate": BLOCK["certificate"] | {"estimate": True},
        "discretisation": {"displacement": 1},
        "mesh": BLOCK["mesh"] | {"parameters": {"nx": 1, "ny": 1, "nz": 1}},
    }
    path = write_job(tmp_path / "block.yaml", BLOCK, **changes)
    done = hpcinv_here("run", path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    content = json.loads(next(tmp_path.rglob("summary.json")).read_text())
    assert list(content["quantities"]) == ["top", "grip", "torque", "torque_about"]
    assert list(content["certificate"]["estimate"]["quantities"]) == ["top"]
    assert list(content["sensitivities"]["quantities"]) == ["top"]
    lines = {line.partition(":")[0]: line for line in report(content)}
    for name in ("grip", "torque", "torque_about"):
        assert "(no error estimate for reactions, no sensitivities of reactions)" in lines[name]
    assert "for reactions" not in lines["top"]
    for name, unit, printed in (("grip", "N", "kN"), ("torque", "N m", "N m")):
        assert f") {printed} (" in lines[name]
        assert lines[name] in done.stdout + done.stderr
        assert unit_of(f"quantities.{name}[0]", load(path)) == unit
