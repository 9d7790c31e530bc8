"""Inverse analyses with a given contact pressure, which acts as the effect `pressure` on both bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError
from hpcinv.output.result import Result

GAP = 1e-3
GIVEN: dict[str, Any] = {
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1, "quadrature": 2},
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -0.2], "density": 1.0}],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0, -0.05]}],
}


def solved(
    comm: MPI.Intracomm,
    cells: tuple[int, int],
    pressure: Any,
    directory: Path | None = None,
    gap: float = GAP,
    **data: Any,
) -> Result:
    """Solve two blocks that stand a millimetre apart, the upper one of which was moved down by 5 cm."""
    parameters = {"lower": cells[0], "upper": cells[1], "gap": gap}
    contact = {"between": ["bottom", "top"], "kind": "contact", "closure": "pressure", "pressure": pressure}
    mesh = {"mesh": {"file": "../meshes/two_blocks.py", "parameters": parameters}}
    contact["touches_within"] = 2 * GAP
    return hpcinv.run(job(**mesh | {"interfaces": [contact]} | GIVEN | data), comm, directory=directory)


@pytest.mark.everyday("cells1")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize(("cells", "pressure"), [((2, 2), 0.05), ((1, 2), "0.04 + 0.02*x - 0.01*y")])
def test_bodies_are_the_ones_under_the_same_pressure_on_both_faces(
    cells: tuple[int, int], pressure: Any, comm: MPI.Intracomm
) -> None:
    """The second face has other facets; a linear pressure is exact on both."""
    there = solved(comm, cells, pressure, analysis="inverse").solutions[0]
    loads = [{"effect": "pressure", "region": name, "pressure": pressure} for name in ("bottom", "top")]
    loaded = GIVEN["effects"] + loads
    mesh = {"file": "../meshes/two_blocks.py", "parameters": {"lower": cells[0], "upper": cells[1], "gap": GAP}}
    apart = hpcinv.run(job(**GIVEN | {"mesh": mesh, "effects": loaded, "analysis": "inverse"}), comm).solutions[0]
    assert comm.allreduce(np.abs(there.u).max(initial=0.0), op=MPI.MAX) > 0.04
    assert np.abs(there.u - apart.u).max(initial=0.0) < 1e-11
    assert there.contacts[0].force[2] == pytest.approx(0.05 if cells == (2, 2) else 0.045, abs=1e-12)


def test_a_body_is_the_one_under_the_same_pressure_on_an_obstacle(comm: MPI.Intracomm) -> None:
    floor = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1]}
    contact = {"effect": "contact", "region": "z0", "obstacle": floor, "closure": "pressure", "pressure": "0.1*(1 + x)"}
    load = {"effect": "pressure", "region": "z0", "pressure": "0.1*(1 + x)"}
    held = {"mesh": box((2, 2, 2), hexahedra=True), "supports": [{"region": "z1", "fix": ["x", "y", "z"]}]}
    first, second = (
        hpcinv.run(job(**GIVEN | held | {"effects": [each], "analysis": "inverse"}), comm).solutions[0]
        for each in (contact, load)
    )
    assert np.abs(first.u).max(initial=0.0) > 0.01
    assert np.abs(first.u - second.u).max(initial=0.0) < 1e-12


def test_the_forward_solve_finds_the_given_pressure(comm: MPI.Intracomm) -> None:
    result = solved(comm, (1, 2), 0.02, gap=0.0, analysis="round_trip", first="inverse")
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert there.distance > 0.001
    assert result.errors["round_trip"]["max"] < 1e-9
    assert back.force == pytest.approx(there.force, abs=1e-9)


def test_the_pressure_of_a_forward_solve_returns_the_original_bodies(comm: MPI.Intracomm, tmp_path: Path) -> None:
    contact = {"between": ["bottom", "top"], "kind": "contact"}
    there = solved(comm, (1, 2), None, tmp_path, analysis="forward", interfaces=[contact])
    known = {"data": "interface_multiplier", "unit": "Pa"}
    again = solved(comm, (1, 2), known, analysis="inverse", mesh={"file": str(tmp_path / "shape.msh")})
    assert np.abs(again.solutions[0].u - there.solutions[0].u).max(initial=0.0) < 1e-9


@pytest.mark.parametrize(
    ("contact", "match"),
    [
        ({"closure": "pressure"}, r"pressure: must be given with 'closure: pressure'"),
        (
            {"closure": "conforming", "pressure": 1.0},
            r"pressure: must be given with 'closure: pressure', and only then",
        ),
        ({"closure": "pressure", "pressure": -1.0}, "must not be negative"),
        ({"closure": "pressure", "pressure": "X*1 Pa/m"}, "must be a formula of x, y and z"),
        ({"closure": "pressure", "pressure": {"lower": 1.0, "elsewhere": 2.0}}, "must be one number"),
        ({"closure": "pressure", "pressure": 1.0, "friction": 0.1}, "'pressure' assumes nothing about friction"),
    ],
)
def test_pressures_that_do_not_fit_are_refused(contact: dict[str, Any], match: str) -> None:
    interface = {"between": ["bottom", "top"], "kind": "contact"} | contact
    with pytest.raises(JobError, match=match):
        job(mesh={"file": "../meshes/two_blocks.py"}, interfaces=[interface], analysis="inverse", **GIVEN)


@pytest.mark.parametrize(
    ("pressure", "text"),
    [("0.1*x - 0.01", r"pressure: is -0.01 Pa at \(0, "), ({"data": "none", "unit": "Pa"}, "no data array 'none'")],
)
def test_pressures_that_the_mesh_shows_to_be_wrong_are_refused(pressure: Any, text: str) -> None:
    with pytest.raises(MeshError, match=text):
        solved(MPI.COMM_SELF, (1, 1), pressure, analysis="inverse")
