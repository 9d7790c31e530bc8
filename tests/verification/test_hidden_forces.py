"""Hidden forces that no image shows: found with the rest shape, and zero where nothing is hidden."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE, ROOT
from helpers.verification import box

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job, parse
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.identification.identification_report import describe
from hpcinv.studies.identification.identification_run import Identified, identify

SD = 1e-3  # m, of landmarks; the block has edges of 1 m
CENTRES = [[0.0, 0.5, 1.0], [1.0, 0.5, 1.0]]
ORGAN = (1500.0, -600.0)  # Pa, pressure at the first and traction along x at the second centre
KEYS = ("states[0].effects[1].pressures[0]", "states[0].effects[2].tractions[0][0]")


def block(forces: tuple[float, float], **changes: Any) -> Job:
    """A block that hangs by one end in two states, one of them with an organ that presses and pulls on its side."""

    def state(name: str, acceleration: float, *, given: bool) -> dict[str, Any]:
        weight = {"effect": "gravity", "acceleration": [acceleration, 0, 0], "density": 150.0, "density_in": "current"}
        first, second = ({"region": "z1", "centres": [centre], "width": 0.4} for centre in CENTRES)
        hidden = [
            first | {"effect": "smooth-pressure", "pressures": [forces[0]]},
            second | {"effect": "smooth-traction", "tractions": [[forces[1], 0, 0]]},
        ]
        return {"name": name, "given": given, "effects": [weight, *hidden] if given else [weight]}

    data = {
        "mesh": box((2, 1, 1)) | {"file": str(ROOT / "meshes" / "box.py"), "geometry_degree": 2},
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "discretisation": {"displacement": 2, "formulation": "displacement"},
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "states": [state("seen", -9.81, given=True), state("turned", 9.81, given=False)],
        "certificate": NO_CERTIFICATE,
    }
    return parse(data | changes, ROOT / "tests" / "job.yaml")


def observed(truth: hpcinv.Result, random: np.random.Generator) -> dict[str, Any]:
    """Every corner of the other state, with errors; both are sought as hidden forces."""
    shape = truth.shapes["turned"]
    corners = np.flatnonzero((np.abs(2 * truth.body.given_nodes - 1) > 0.99).all(axis=1))
    marks = [
        {"at": truth.body.given_nodes[i].tolist(), "observed": (shape[i] + SD * random.standard_normal(3)).tolist()}
        for i in corners
    ]
    prior = {"prior": {"mean": 0, "sd": "1 kPa", "strength": "evidence"}}
    observations = [{"name": "corners", "state": "turned", "landmarks": marks, "sd": SD}]
    return {"parameters": dict.fromkeys(KEYS, prior), "observations": observations}


def test_a_hidden_organ_is_found_and_none_where_there_is_none() -> None:
    comm, random = MPI.COMM_SELF, np.random.default_rng(4)

    def found(forces: tuple[float, float]) -> tuple[hpcinv.Result, Identified]:
        truth = hpcinv.run(block(forces), comm, workspace=workspace)
        return truth, identify(block((0.0, 0.0), identify=observed(truth, random)), comm, workspace=workspace)

    with Workspace(comm) as workspace:
        plain = hpcinv.run(block((0.0, 0.0)), comm, workspace=workspace)
        truth, identified = found(ORGAN)
        estimated, hidden = identified.estimate, identified.estimate.hidden
        assert hidden is not None
        errors = [np.abs(run.shapes["rest"] - truth.shapes["rest"]).max() for run in (identified.result, plain)]
        print(f"{estimated.values}, {hidden}, chi² {estimated.chi_squared}, errors {errors}, {len(estimated.history)}")
        assert errors[0] < 0.1 * errors[1]
        assert hidden.numbers == 24
        assert hidden.without > 100
        assert estimated.probability is not None
        assert estimated.probability > 0.01
        assert estimated.values == pytest.approx(ORGAN, rel=0.2)
        assert any(line.startswith("hidden forces: found with") for line in describe(estimated))
        _, quiet = found((0.0, 0.0))
        assert quiet.estimate.hidden is not None
        assert quiet.estimate.hidden.strength == 0.0
        assert quiet.estimate.combinations == []  # no other number is sought
        assert quiet.estimate.values.tolist() == [0.0, 0.0]
        np.testing.assert_allclose(quiet.result.shapes["rest"], plain.shapes["rest"], atol=1e-12)
