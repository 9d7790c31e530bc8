"""Blocks that slide over several cells of another block: forces and pressure at each step, and energy lost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from helpers.verification import job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.contact_reports import ContactReport
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium_path import EquilibriumPath
from hpcinv.solver.load_stepping import AdaptiveSteps

PUSH, FRICTION = 1e-3, 0.3
WIDTH, LONG = 0.5, 1.0  # of the upper block, and by how much the lower one is longer

GIVEN: dict[str, Any] = {
    "analysis": "forward",
    "mesh": {
        "file": "../meshes/two_blocks.py",
        "parameters": {
            "lx": WIDTH,
            "ly": WIDTH,
            "margin": LONG,
            "upper_height": 0.2,
            "lower_height": 0.1,
            "lower": 9,
            "upper": 2,
            "hexahedra": True,
        },
    },
    "material": {
        "lower": {"law": "neo-hookean", "young": 1e4, "poisson": 0.0},
        "upper": {"law": "neo-hookean", "young": 1.0, "poisson": 0.0},
    },
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1},
    "effects": [
        {"effect": "traction", "region": "z1", "traction": [0, 0, -PUSH], "area_in": "reference", "case": "press"}
    ],
    "load_cases": ["press", "drag"],
}
FORCE = PUSH * WIDTH**2


def followed(
    comm: MPI.Intracomm, steps: int, travel: tuple[float, float], friction: float, easy: int = 0
) -> Iterator[tuple[float, ContactReport]]:
    """Yield the share of the travel and the report of contact after each step.

    Args:
        steps: least number; a step that fails is halved.
        easy: iterations up to which the next step is twice as long.
    """
    supports = [
        {"region": "z0", "fix": ["x", "y", "z"]},
        {"region": "z1", "displacement": [*travel, None], "case": "drag"},
    ]
    contact = {"between": ["bottom", "top"], "kind": "contact", "friction": friction}
    posed = job(**GIVEN | {"supports": supports, "interfaces": [contact]})
    body = build_body(posed.mesh, posed.regions, comm, resolve=posed.resolve, degree=1)
    equations = Equations(posed, body, Timings())
    equilibrium = equations.equilibrium(equations.weak_form("forward"))
    path = EquilibriumPath(equilibrium, 1e-12, cases=2)
    contacts = equilibrium.system.weak_form.contacts
    for solve in path.follow(AdaptiveSteps(1 / steps, 1e-3, 1e-12, easy=easy)):
        if solve.outcome.accepted and solve.load > 0.5:
            (report,) = contacts.reports(equations.scales)
            yield 2 * solve.load - 1, report
    equations.destroy()


@pytest.mark.everyday("3")
@pytest.mark.parametrize("steps", [3, 24])
def test_a_block_that_slides_over_cells_has_its_friction_at_each_step(steps: int, comm: MPI.Intracomm) -> None:
    """It slides by 0.5 m, over three cells of 1/6 m and obliquely, in steps that end anywhere within them.

    Directions of slip differ where the block bends: by 1 % at the edge of its shear, by 0.1 % later.
    """
    travel = (0.4, 0.3)
    for share, report in followed(comm, steps, travel, FRICTION, easy=6 if steps < 6 else 0):
        force, lost = np.array(report.force), report.friction
        assert force[2] == pytest.approx(FORCE, rel=1e-8)
        assert force[:2] == pytest.approx(-FRICTION * FORCE * np.array([0.8, 0.6]), rel=5e-2)
        assert np.linalg.norm(force[:2]) == pytest.approx(FRICTION * FORCE, rel=5e-3)
        assert lost is not None
        assert lost.energy_lost == pytest.approx(FRICTION * FORCE * 0.5 * share, rel=1e-2, abs=1e-3 * FRICTION * FORCE)


@pytest.mark.release
def test_pressure_stays_uniform_where_facets_are_crossed(comm: MPI.Intracomm) -> None:
    """The lower block is 10⁴ times as stiff, so that the pressure of the patch test is left, at any place."""
    for _, report in followed(comm, 25, (0.4, 0.3), 0.0):
        assert report.largest_pressure == pytest.approx(PUSH, rel=1e-3)
        assert report.force == pytest.approx((0.0, 0.0, FORCE), rel=1e-5, abs=1e-5 * FORCE)


@pytest.mark.release
@pytest.mark.parametrize("steps", [1, 2, 6])
def test_energy_lost_does_not_depend_on_the_number_of_steps(steps: int, comm: MPI.Intracomm) -> None:
    *_, (_, report) = followed(comm, steps, (0.3, 0.0), FRICTION)
    assert report.friction is not None
    assert report.friction.energy_lost == pytest.approx(FRICTION * FORCE * 0.3, rel=1e-2)
