"""Effects and constraints of size zero, each alone: the body stays as it is, found at once, in both directions.

The registries drive the tests: a new effect, kind of support or control of a cavity needs its size zero here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers.hollow_block import hollow_block
from helpers.sheets import flat, save_sheet
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.cavities import CONTROLS
from hpcinv.job.support import Support
from hpcinv.mesh import build_body
from hpcinv.mesh.source import MeshSource
from hpcinv.physics.effects import effects
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED
from hpcinv.solver.observer import SILENT

EFFECTS: dict[str, dict[str, Any]] = {
    "active-stress": {"stress": 0},
    "centrifugal": {"angular_velocity": 0},
    "contact": {"obstacle": {"shape": "plane", "point": [1.5, 0, 0], "normal": [-1, 0, 0]}},
    "edge-moment": {"moment": [0, 0, 0]},
    "elastic-foundation": {},  # without a load
    "gravity": {"acceleration": [0, 0, 0]},
    "growth": {"stretch": 1},
    "hydrostatic-pressure": {"level": [0, 0, -1]},  # below the body
    "pressure": {"pressure": 0},
    "prestrain": {"tensor": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]},
    "smooth-pressure": {"pressures": [0, 0]},
    "smooth-traction": {"tractions": [[0, 0, 0], [0, 0, 0]]},
    "thermal-expansion": {"temperature_change": 0},
    "traction": {"traction": [0, 0, 0]},
}
"""changes of each effect's example that leave nothing of it"""
SUPPORTS: dict[str, dict[str, Any]] = {
    "fix": {"fix": ["x", "y", "z"]},
    "displacement": {"displacement": [0, "0*y", 0]},
    "motion": {"motion": {"about": [1.2, 0.2, 0.2]}},
    "remote": {"remote": {"force": [0, 0, 0], "about": [1.2, 0.2, 0.2]}},
}
CAVITIES: dict[str, Any] = {
    "volume": 1.0,
    "unloaded_volume": 1.0,
    "gas": {"ambient": 1e3, "amount": 1},
    "windkessel": {"compliance": 1e-3, "volume": 1.0, "pressure": 0},
}
"""controls of a hole of 1 m³ that leave it as it is"""
CLAMP = {"region": "x0", "fix": ["x", "y", "z"]}


def check_still(comm: MPI.Intracomm, source: MeshSource | None = None, **data: Any) -> None:
    """Solve a job, and check that one factorization finds that nothing moves."""
    case = job(**{"mesh": box((1, 1, 1)), "material": {"law": "neo-hookean", "mu": 1e4, "lam": 4e4}, **data})
    degree = case.discretisation.displacement
    body = build_body(case.mesh, case.regions, comm, resolve=case.resolve, degree=degree, replacement=source)
    equations = Equations(case, body, Timings())
    solved = solve_direction(equations, case.directions[0], UNLOADED, SILENT)
    assert solved.load == 1.0, solved.solves[-1].outcome
    assert equations.largest_displacement() < 1e-14
    assert sum(solve.factorizations for solve in solved.solves) <= 2


def test_every_effect_and_constraint_has_a_size_zero_here() -> None:
    own = {name for name, kind in effects().items() if kind.__module__.startswith("hpcinv.")}  # not of other tests
    assert own == set(EFFECTS)
    assert set(Support.alternatives) == set(SUPPORTS)
    assert set(CONTROLS) == set(CAVITIES)


@pytest.mark.everyday("inverse-gravity", "forward-pressure", "inverse-pressure", "forward-contact")
@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
def test_an_effect_of_size_zero_moves_nothing(
    analysis: str, name: str, comm: MPI.Intracomm, run_directory: Path
) -> None:
    kind = effects()[name]
    effect = {**kind.example, **EFFECTS[name]}
    if name == "contact" and analysis == "inverse":
        pytest.skip("an elastic layer that a given body does not touch is refused")
    families = {f: {"direction": [1, 0, 0], "given_on": "reference"} for f in kind.model_validate(effect).families}
    mesh: dict[str, Any] = box((1, 1, 1))
    if kind.only_of_kind:
        run_directory.mkdir(exist_ok=True)
        file = save_sheet(run_directory / "sheet.msh", 1, 1, flat(1.0, 1.0))
        mesh = {"file": str(file), "shell": {"thickness": "1 cm"}}
    check_still(comm, mesh=mesh, analysis=analysis, effects=[effect], fibres=families, supports=[CLAMP])


@pytest.mark.everyday("forward-fix", "inverse-displacement", "forward-motion", "inverse-remote")
@pytest.mark.parametrize("name", SUPPORTS)
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
def test_a_support_of_size_zero_moves_nothing(analysis: str, name: str, comm: MPI.Intracomm) -> None:
    check_still(comm, analysis=analysis, supports=[CLAMP, {"region": "x1", **SUPPORTS[name]}])


@pytest.mark.everyday("forward-volume", "inverse-unloaded", "forward-windkessel", "inverse-gas")
@pytest.mark.parametrize("name", CAVITIES)
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
def test_a_cavity_that_keeps_its_volume_moves_nothing(analysis: str, name: str, comm: MPI.Intracomm) -> None:
    if name in ("volume", "unloaded_volume") and (analysis == "forward") != (name == "volume"):
        pytest.skip("the volume of the given body is known")
    check_still(
        comm,
        hollow_block([(1, 1, 1)], divisions=(3, 3, 3)),
        analysis=analysis,
        regions={"side": "x < 0.1 m", "hole": "cavity > 0"},
        supports=[{"region": "side", "fix": ["x", "y", "z"]}],
        cavities={"hole": {"surface": "hole", name: CAVITIES[name]}},
        discretisation={"displacement": 1, "formulation": "displacement"},
    )
