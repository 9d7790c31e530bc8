"""Derivatives by the thickness of a shell against central differences of whole runs, and what has none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.sheets import flat, save_sheet
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.solver.workspace import Workspace

KEY = "mesh.shell.thickness"
TIP = {"name": "tip", "of": "displacement", "at": [1, 0.25, 0]}
SEEN = {"name": "seen", "quantity": "stress", "value": 1e3, "sd": 1}
STRESS = {"name": "stress", "of": "von_mises", "on": "sheet", "reduce": "mean"}


def sheet(path: Path, thickness: Any = 0.1, **data: Any) -> dict[str, Any]:
    whole = {
        "mesh": {"file": str(path), "shell": {"thickness": thickness}},
        "material": {"law": "neo-hookean", "mu": 3e4, "lam": 1.2e5},
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "quantities": [TIP, STRESS],
        "certificate": "off",
    }
    loads = {} if "states" in data else {"effects": [pushed(30)]}
    return whole | loads | data


def pushed(pressure: float) -> dict[str, Any]:
    return {"effect": "pressure", "region": "inner", "pressure": pressure}


@pytest.mark.release
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("analysis", ["inverse", "forward", "states"])
def test_slopes_are_differences_of_whole_runs(analysis: str, comm: MPI.Intracomm, run_directory: Path) -> None:
    path = run_directory / "sheet.msh"
    if comm.rank == 0:
        save_sheet(path, 3, 1, flat(1, 0.5))
    comm.Barrier()
    states = [{"name": "a", "given": True, "effects": [pushed(30)]}, {"name": "b", "effects": [pushed(-20)]}]
    changes: dict[str, Any] = {"states": states} if analysis == "states" else {"analysis": analysis}
    with Workspace(comm) as workspace:

        def found(thickness: Any, **more: Any) -> Any:
            return hpcinv.run(job(**sheet(path, thickness, **changes, **more)), comm, workspace=workspace)

        result = found("gauge", let={"gauge": "100 mm"}, sensitivities={KEY: "2 mm"})
        ahead, behind = found(0.1001), found(0.0999)
    names = list(result.quantities)
    assert len(names) == (4 if analysis == "states" else 2)
    for name in names:
        expected = (np.array(ahead.quantities[name]) - behind.quantities[name]) / 2e-4
        slope = np.array(result.sensitivities.slopes[name][KEY])
        assert slope == pytest.approx(expected, rel=1e-4, abs=1e-5 * np.abs(expected).max())
        assert np.abs(slope).max() > 0.01
        assert result.sensitivities.deviations[name] == pytest.approx(abs(slope) * 2e-3, rel=1e-12)
    for number, shape in enumerate(result.sensitivities.shapes.values() or [result.sensitivities]):
        later, other = (run.solutions[number].other_nodes for run in (ahead, behind))
        error = np.abs(shape.nodes[KEY] - (later - other) / 2e-4).max(initial=0.0)
        assert error < 1e-4 * shape.shape[KEY]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"thickness": "0.1 m + 0.1*x"}, f"sensitivities.*{KEY} varies over the surface: there is no derivative by it"),
        (
            {"supports": [{"region": "x0", "motion": {"rotate": "10 deg", "axis": [0, 1, 0]}}]},
            f"there is no derivative by {KEY} where 'x0' is moved",
        ),
        (
            {
                "sensitivities": [],
                "identify": {
                    "parameters": {KEY: None},
                    "observations": [SEEN],
                },
            },
            f"{KEY} changes the mesh: vary it in a sweep",
        ),
    ],
)
def test_thickness_sensitivities_without_derivative_are_refused(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    path = save_sheet(tmp_path / "sheet.msh", 1, 1, flat(1, 0.5))
    with pytest.raises(JobError, match=message):
        job(**sheet(path, **{"sensitivities": [KEY]} | changes))


def test_solids_have_no_thickness(tmp_path: Path) -> None:
    path = save_sheet(tmp_path / "sheet.msh", 1, 1, flat(1, 0.5))
    given = sheet(path, sensitivities=[KEY])
    given["mesh"].pop("shell")
    with pytest.raises(
        JobError, match=f"{KEY} is not a number of a law, an effect, fibres, a support, a shell or a cavity"
    ):
        job(**given)
