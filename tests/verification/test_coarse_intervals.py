"""Intervals of contact over a coarse field of pressures, and what would bound ends that do not exist."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.trust.certificate import Line
from hpcinv.trust.intervals import varied_tractions
from hpcinv.trust.intervals.admissible_tractions import AdmissibleTractions


def interval_lines() -> dict[str, Line]:
    """Return the intervals of two blocks, whose interface has 16 vertices, by the name of the quantity."""
    posed: dict[str, Any] = {
        "analysis": "inverse",
        "mesh": {"file": "../meshes/two_blocks.py", "parameters": {"lower": 2, "upper": 3, "hexahedra": True}},
        "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
        "discretisation": {"displacement": 1},
        "solver": {"tolerance": 1e-12},
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0, -0.05]}],
        "interfaces": [{"between": ["bottom", "top"], "kind": "contact", "closure": "conforming"}],
        "certificate": {"level": "quick"},
        "uncertainty": "contact",
    }
    certificate = hpcinv.run(job(**posed), MPI.COMM_SELF).certificate
    assert certificate is not None
    return {line.interval["of"]: line for line in certificate.lines if line.interval}


def test_a_coarse_field_has_nearly_the_ends_of_all_pressures(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its pressures are some of all, so that its ends lie inside."""
    fine = interval_lines()["force on bottom"].interval
    assert "16 tractions: each solve takes a factorization" in capsys.readouterr().out
    monkeypatch.setattr(varied_tractions, "MOST", 9)
    line = interval_lines()["force on bottom"]
    assert "over 9 tractions of a coarse field of 16 pressures" in line.note
    coarse = line.interval
    assert fine is not None
    assert coarse is not None
    width = fine["high"] - fine["low"]
    assert fine["low"] - 1e-4 * width <= coarse["low"] <= fine["low"] + 0.1 * width
    assert fine["high"] - 0.1 * width <= coarse["high"] <= fine["high"] + 1e-4 * width


def test_what_bounds_a_quantity_is_named() -> None:
    """Two pressures; the second moves no gap."""
    none = np.full(2, np.inf)
    near = AdmissibleTractions(np.zeros(2), np.ones(1), np.array([[1.0, 0.0]]), none, np.full(1, np.inf))
    assert near.bounding(np.array([0.0, 1.0]), 1.0, [np.ones(2)]) == {"greatest_pressure", "force"}
    assert near.bounding(np.array([1.0, 0.0]), 1.0, [np.ones(2)]) == {"greatest_pressure", "force", "greatest_rest_gap"}
