"""Load steps that keep failing: what moves is said after a few of them, and they end with a budget."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers.sheets import flat, save_sheet
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import SolveError
from hpcinv.mesh import build_body
from hpcinv.output.progress import SilentProgress
from hpcinv.solver.equations import Equations
from hpcinv.solver.failing_motion import failing_motion

SOFT = {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}
PATIENCE = 10


@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_nearly_free_motion_is_named(direction: Any, comm: MPI.Intracomm) -> None:
    """A bar on rails, with soft springs on its end: 1 N on springs of 2 N/m moves it by half a metre along x."""
    rails = [{"region": side, "fix": [side[0]]} for side in ("y0", "z0")]
    given = job(
        analysis=direction,
        mesh=box((2, 1, 1), lx=0.4, ly=0.2, lz=0.1, hexahedra=True),
        material=SOFT,
        effects=[
            {
                "effect": "traction",
                "region": "x1",
                "traction": ["50 Pa*(1 + 0*X/(1 m))", 0, 0],
                "area_in": "reference",
            },
            {"effect": "elastic-foundation", "region": "x0", "normal": "100 Pa/m"},
        ],
        supports=rails,
    )
    body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
    model = Equations(given, body, Timings())
    equilibrium = model.equilibrium(model.weak_form(direction))
    motion, supports, *formulas = failing_motion(given, body, equilibrium, 0.0, 4)
    print(motion, supports, sep="\n")
    assert motion.startswith("After 4 failed steps: to first order the load moves the body by 50")
    assert " mm, most at (0.4, " in motion
    assert "100% of it is rigid: it is nearly free to move along x" in motion
    assert (
        "'y0' holds y on 0.04 m² (14.29% of the surface), 'z0' holds z on 0.08 m² (28.57% of the surface)" in supports
    )
    unknown = "effects[0].traction depends on X, Y or Z, which are unknown until the end of the path"
    expected = [f"{unknown}: write it with x, y, z, or as an array of the mesh"] if direction == "inverse" else []
    assert formulas == expected
    equilibrium.destroy()


def test_flat_membranes_are_given_a_first_step(tmp_path: Path) -> None:
    """A clamped square: w = 0.00126 p a⁴/D, which is 13.8 m for a side of 1 m; 2e-4 m of it first."""
    thickness, young = 1e-3, 1e6
    given = job(
        analysis="forward",
        mesh={"file": str(save_sheet(tmp_path / "sheet.msh", 4, 4, flat(1, 1))), "shell": {"thickness": thickness}},
        material={"law": "st-venant-kirchhoff", "young": young, "poisson": 0.3},
        effects=[{"effect": "pressure", "region": "inner", "pressure": 1e-3 * young * thickness}],
        supports=[{"region": edge, "fix": ["x", "y", "z"]} for edge in ("x0", "x1", "y0", "y1")],
    )
    body = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve)
    model = Equations(given, body, Timings())
    equilibrium = model.equilibrium(model.weak_form("forward"))
    motion, advice = failing_motion(given, body, equilibrium, 0.0, 4)
    assert "moves the body by 13.8 m, most at (0.5, 0.5, 0) m" in motion
    assert advice.endswith("before it is tense: solver: {initial_step: 1e-05, minimum_step: 1e-09}")
    equilibrium.destroy()


def test_hopeless_steps_end_with_a_reason(comm: MPI.Intracomm) -> None:
    """A soft block that hangs from a corner of one face, under far more than its weight."""
    given = job(
        analysis="forward",
        mesh=box((4, 4, 4)),
        regions={"patch": "x < 1e-9 and y > 0.74 and z > 0.74"},
        material=SOFT,
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 8000}],
        supports=[{"region": "patch", "fix": ["x", "y", "z"]}],
        solver={"patience": PATIENCE, "continuation": "steps"},
    )
    progress = SilentProgress(comm)
    with pytest.raises(SolveError) as raised:
        hpcinv.run(given, comm, progress=progress)
    print(raised.value)
    assert f"Given up after {PATIENCE} factorizations in failed solves (solver.patience). " in raised.value.advice
    assert "% of it is rigid: it is nearly free to turn about the axis through (" in raised.value.advice
    assert "supports: 'patch' holds x, y, z on 0.0625 m² (1.04% of the surface)" in raised.value.advice
    (solution,) = progress.statistics["solutions"]
    failed = [solve for solve in solution["solves"] if solve["outcome"] not in ("CONVERGED", "ROUND_OFF")]
    assert sum(solve["factorizations"] for solve in failed[:-1]) <= PATIENCE
    assert raised.value.advice in progress.statistics["advice"]
