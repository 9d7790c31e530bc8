"""Pointwise width of the shape between all contact tractions, against closed forms and bodies with known pressures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import create_unit_cube
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.trust.intervals.admissible_tractions import AdmissibleTractions
from hpcinv.trust.intervals.shape_width import shape_width


@pytest.mark.parallel([2, 1])
def test_width_over_a_box_of_pressures_is_the_sum_of_both(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pressures p and q from 0 to 1 move nodes by p x along x, and by p y + 2 q x along y."""
    mesh = create_unit_cube(comm, 2, 2, 2)
    space = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    moves = [fem.Function(space), fem.Function(space)]
    moves[0].interpolate(lambda x: np.array([x[0], x[1], 0 * x[0]]))
    moves[1].interpolate(lambda x: np.array([0 * x[0], 2 * x[0], 0 * x[0]]))
    near = AdmissibleTractions(np.array([0.5, 0.2]), np.zeros(0), np.zeros((0, 2)), np.ones(2), np.zeros(0))
    said = list[str]()
    width = shape_width(near, moves, 3.0, said.append)
    x, y, _ = width.field.function_space.tabulate_dof_coordinates().T
    assert width.field.x.array == pytest.approx(np.maximum(x, y + 2 * x) / 2, abs=1e-12)
    assert width.largest == pytest.approx(1.5, rel=1e-12)
    assert width.place[:2] == pytest.approx((3.0, 3.0))
    assert not width.unbounded
    assert len(said) == 1
    monkeypatch.setattr("hpcinv.trust.intervals.shape_width._MOST", 1)  # as of a body with many tractions
    bound = shape_width(near, moves, 3.0, said.append)
    assert bound.rows == 1
    assert (bound.field.x.array <= width.field.x.array + 1e-12).all()
    assert 0 < bound.largest <= width.largest + 1e-12
    without_end = AdmissibleTractions(np.zeros(2), np.zeros(0), np.zeros((0, 2)), np.array([1.0, np.inf]), np.zeros(0))
    assert shape_width(without_end, moves, 1.0, said.append).unbounded


def blocks(directory: Path | None, closure: dict[str, Any], **data: Any) -> Any:
    given: dict[str, Any] = {
        "analysis": "inverse",
        "mesh": {"file": "../meshes/two_blocks.py", "parameters": {"lower": 1, "upper": 1}},
        "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
        "discretisation": {"displacement": 1},
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0, -0.02]}],
        "interfaces": [{"between": ["bottom", "top"], "kind": "contact", **closure}],
    }
    return hpcinv.run(job(**given | data), MPI.COMM_SELF, directory=directory)


def test_bodies_with_other_pressures_are_within_the_width(run_directory: Path) -> None:
    """Shapes without pressure and with a conforming one differ by at most the width, up to second order."""
    checked = {"certificate": {"level": "quick"}, "uncertainty": "contact"}
    result = blocks(run_directory / "run", {"closure": "conforming"}, **checked)
    shapes = [result.solutions[0].other_nodes, blocks(None, {"closure": "touching"}).solutions[0].other_nodes]
    difference = np.abs(shapes[0] - shapes[1]).max(axis=1)
    (field,) = result.certificate.point_fields("")
    (line,) = (line for line in result.certificate.lines if line.point_field is not None)
    assert difference.max() > 1e-3
    assert line.value == pytest.approx(field.x.array.max(), rel=1e-12)
    assert 2 * line.value >= 0.95 * difference.max()
    assert 2 * line.value < 3 * difference.max()
    written = json.loads((run_directory / "run" / "summary.json").read_text())
    assert any(entry["name"] == line.name for entry in written["certificate"]["lines"])
    assert any(b"contact half width" in path.read_bytes() for path in (run_directory / "run" / "fields").rglob("*.vtu"))
