"""Inverse analyses of bodies in contact: what closures assume, and the intervals that a shape leaves open."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError, SolveError
from hpcinv.output.result import Result
from hpcinv.trust.certificate import Verdict

BLOCKS: dict[str, Any] = {"file": "../meshes/two_blocks.py", "parameters": {"lower": 1, "upper": 2}}
GIVEN: dict[str, Any] = {
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1},
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -0.2], "density": 1.0}],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0, -0.05]}],
    "quantities": [{"name": "gap", "of": "Z", "on": "bottom", "reduce": "mean"}],
}


def solved(comm: MPI.Intracomm, contact: dict[str, Any], directory: Path | None = None, **data: Any) -> Result:
    """Solve two blocks, the upper one of which was moved down by 5 cm."""
    interface = {"between": ["bottom", "top"], "kind": "contact", **contact}
    return hpcinv.run(job(**{"mesh": BLOCKS, "interfaces": [interface]} | GIVEN | data), comm, directory=directory)


@pytest.mark.release
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("gap", [0.0, 0.002])
def test_unloaded_bodies_have_the_assumed_gap_and_close(gap: float, comm: MPI.Intracomm) -> None:
    closure = {"closure": "gap", "rest_gap": gap} if gap else {"closure": "conforming"}
    result = solved(comm, closure, analysis="round_trip", first="inverse")
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert result.errors["round_trip"]["max"] < 1e-10
    assert there.largest_pressure > 0.1
    assert there.distance < 1e-10
    assert back.force == pytest.approx(there.force, abs=1e-9)
    assert "assumed" in there.assumption


@pytest.mark.release
def test_certificate_judges_gaps_pressures_and_forces(comm: MPI.Intracomm) -> None:
    checked: dict[str, Any] = {"certificate": {"level": "quick"}, "analysis": "round_trip", "first": "inverse"}
    results = [solved(comm, {"closure": closure}, **checked) for closure in ("touching", "conforming")]
    touching, conforming = ({line.name: line for line in result.certificate.lines} for result in results)
    for lines in (touching, conforming):
        assert lines["overlap of the loaded bodies at 'bottom'"].verdict is Verdict.PASS
        assert lines["least contact pressure at 'bottom'"].value == 0.0
        assert lines["forces on both bodies at 'bottom'"].value == pytest.approx(0.0, abs=1e-12)
        assert "does not confirm" in lines["round trip, relative to the displacement"].note
    name = "overlap of the unloaded bodies at 'bottom'"
    assert touching[name].value == 0.0
    assert "smallest gap 4" in touching[name].note
    assert conforming[name].value == pytest.approx(0.0, abs=1e-3)


def test_bodies_with_too_much_pressure_overlap_unloaded(comm: MPI.Intracomm) -> None:
    """Unloaded bodies that were to be 2 cm into each other; the certificate finds where.

    The interval holds bodies that do not overlap, and says that these are not among them. An error of the given gaps
    by 0.5 mm changes them as much as a gap that is wanted to be 0.5 mm wider.
    """
    contact = {"closure": "gap", "touches_within": 5e-4}
    checked: dict[str, Any] = {"certificate": {"level": "quick"}, "uncertainty": "contact"}
    result = solved(comm, contact | {"rest_gap": -0.02}, analysis="inverse", **checked)
    assert result.certificate is not None
    lines = {line.name: line for line in result.certificate.lines}
    interval = lines["interval of 'gap' over all contact pressures that the shape admits"]
    assert interval.interval is not None
    assert result.quantities["gap"] < interval.interval["low"]
    assert "lies outside" in interval.note
    overlap = lines["overlap of the unloaded bodies at 'bottom'"]
    assert overlap.verdict is Verdict.WARN
    assert overlap.value == pytest.approx(0.02, rel=0.1)
    other = solved(comm, contact | {"rest_gap": -0.0195}, analysis="inverse", certificate={"level": "off"})
    moved = np.linalg.norm(other.solutions[0].u - result.solutions[0].u, axis=1).max()
    line = lines["change of the shape by an error of the given gaps"]
    assert line.value == pytest.approx(moved, rel=0.02)
    touching = solved(comm, {"closure": "touching"}, analysis="inverse", certificate={"level": "quick"})
    moved = np.linalg.norm(touching.solutions[0].u - result.solutions[0].u, axis=1).max()
    distance = "distance of the shape from another closure"
    assert lines[distance].value == pytest.approx(moved, rel=0.2)  # to first order: bodies are pressed by a tenth
    assert touching.certificate is not None
    (line,) = (line for line in touching.certificate.lines if line.name == distance)
    assert line.verdict is Verdict.SKIPPED
    line = lines["change of the shape by an error of the given gaps"]
    change = other.quantities["gap"] - result.quantities["gap"]
    assert float(re.findall(r"'gap' by (\d+) µm", line.note)[0]) == pytest.approx(1e6 * abs(change), rel=0.02)


@pytest.mark.parametrize(
    ("contact", "verdict"),
    [({"closure": "touching"}, Verdict.PASS), ({"closure": "stick", "friction": 0.3}, Verdict.UNDECIDED)],
)
@pytest.mark.release
def test_gaps_change_no_given_pressure_and_tractions_of_friction_are_not_decided(
    contact: dict[str, Any], verdict: Verdict, comm: MPI.Intracomm
) -> None:
    result = solved(comm, contact, analysis="inverse", certificate={"level": "quick"})
    assert result.certificate is not None
    (line,) = (line for line in result.certificate.lines if line.name.endswith("error of the given gaps"))
    assert line.verdict is verdict
    assert line.value == (0.0 if verdict is Verdict.PASS else None)


@pytest.mark.release
def test_bodies_with_the_pressure_of_a_forward_solve_have_its_gap(comm: MPI.Intracomm) -> None:
    apart = BLOCKS | {"parameters": BLOCKS["parameters"] | {"gap": 0.01}}
    result = solved(comm, {"closure": "given"}, mesh=apart, analysis="round_trip", first="forward")
    assert result.errors["round_trip"]["max"] < 1e-10
    assert result.solutions[1].contacts[0].distance == pytest.approx(0.01, abs=1e-9)
    assert result.solutions[1].contacts[0].penetration < 1e-9


def test_bodies_that_touch_without_pressure_are_apart_unloaded_and_close(comm: MPI.Intracomm) -> None:
    result = solved(comm, {"closure": "touching"}, analysis="round_trip", first="inverse")
    assert result.errors["round_trip"]["max"] < 1e-6
    assert result.solutions[0].contacts[0].largest_pressure == 0.0
    assert result.solutions[0].contacts[0].penetration == 0.0
    assert result.quantities["gap"] > 0.54


@pytest.mark.parallel([2, 1])
def test_truth_and_parts_of_a_pressure_are_in_the_interval(comm: MPI.Intracomm, run_directory: Path) -> None:
    """The truth is the body of a forward solve; its pressure is not uniform."""
    apart = BLOCKS | {"parameters": {"lower": 1, "upper": 1, "gap": 0.01}}
    energy = {"name": "energy", "of": "energy", "on": "upper", "reduce": "integral", "over": "reference"}
    there = solved(comm, {}, run_directory / "there", mesh=apart, analysis="forward", quantities=[energy])
    back: dict[str, Any] = {"mesh": {"file": str(run_directory / "there" / "shape.msh")}, "analysis": "inverse"}
    wanted = [*GIVEN["quantities"], energy]
    checked: dict[str, Any] = {"certificate": {"level": "quick"}, "uncertainty": "contact", "quantities": wanted}
    result = solved(comm, {"closure": "conforming"}, **back, **checked)
    assert result.certificate is not None
    intervals = {line.interval["of"]: line.interval for line in result.certificate.lines if line.interval}
    low, high = (intervals["gap"][end] for end in ("low", "high"))
    assert low < 0.51 < high
    assert intervals["energy"]["unit"] == "N m"
    least, most = (intervals["energy"][end] for end in ("low", "high"))  # whose ends are not where p = 0 or conforming
    assert least < there.quantities["energy"] < most
    assert least < 0.9 * result.quantities["energy"]
    assert intervals["force on bottom"]["low"] == pytest.approx(0.0, abs=1e-9)
    assert intervals["mean rest gap at bottom"]["low"] == pytest.approx(0.0, abs=1e-6)
    assert high - low < 0.03
    shares = [solved(comm, {"closure": "gap", "rest_gap": gap}, **back).quantities["gap"] for gap in (5e-3,)]
    for value in (result.quantities["gap"], *shares):
        assert low - 1e-9 <= value <= high + 1e-9
    known = {"greatest_rest_gap": 0.02, "rest_surface": rest_surface(run_directory, comm, height=0.5)}
    narrowed = solved(comm, {"closure": "conforming", "known": known}, **back, **checked)
    assert narrowed.certificate is not None
    (line,) = (line.interval for line in narrowed.certificate.lines if line.name.startswith("interval of 'gap'"))
    assert line is not None
    assert line["low"] < 0.51 < line["high"]
    assert line["high"] - line["low"] < 0.5 * (high - low)


def rest_surface(directory: Path, comm: MPI.Intracomm, height: float, region: str = "top") -> dict[str, Any]:
    """Return what is known of the upper face of the unloaded lower block: within 1 mm it lies at a height."""
    file = directory / f"plane_{height}.stl"
    if comm.rank == 0:
        plane = pyvista.Plane(center=(0.5, 0.5, height), direction=(0, 0, 1), i_size=3, j_size=3, i_resolution=1)
        plane.triangulate().save(file)
    comm.barrier()
    return {"region": region, "file": str(file), "within": 1e-3}


@pytest.mark.release
def test_rest_surface_that_no_pressure_reaches_is_missed_by_a_distance(
    comm: MPI.Intracomm, run_directory: Path
) -> None:
    """The lower block, which was 5 cm too high with the pressure of the travel, is at most 0.5 + 0.05 m high."""
    known = {"rest_surface": rest_surface(run_directory, comm, height=0.7)}
    checked: dict[str, Any] = {"certificate": {"level": "quick"}, "uncertainty": "contact", "analysis": "inverse"}
    result = solved(comm, {"closure": "conforming", "known": known}, **checked)
    assert result.certificate is not None
    (line,) = (line for line in result.certificate.lines if line.name.startswith("contact pressures that"))
    assert line.verdict is Verdict.WARN
    assert "miss the known 'rest_surface'" in line.note
    assert line.value is not None
    assert 0.1 < line.value < 0.2
    with pytest.raises(SolveError, match="agree with what is 'known'"):
        solved(comm, {"closure": "least-energy", "known": known}, analysis="inverse")


@pytest.mark.release
def test_least_energy_is_searched_among_bodies_with_the_known_surface(comm: MPI.Intracomm, run_directory: Path) -> None:
    """Without it, the pressure is nearly 0, and the lower block is higher."""
    heights = [{"name": "height", "of": "Z", "on": "top", "reduce": "mean"}]
    data: dict[str, Any] = {"analysis": "inverse", "quantities": heights, "closure": "least-energy"}
    contact = {"closure": data.pop("closure")}
    free = solved(comm, contact, **data).quantities["height"]
    known = {"rest_surface": rest_surface(run_directory, comm, height=0.52)}
    narrowed = solved(comm, contact | {"known": known}, **data).quantities["height"]
    assert abs(narrowed - 0.52) < 1.1e-3
    assert abs(free - 0.52) > 5e-3


@pytest.mark.release
def test_rest_surface_of_a_body_that_does_not_touch_is_refused(comm: MPI.Intracomm, run_directory: Path) -> None:
    """The upper block touches an obstacle, the lower one nothing."""
    apart = BLOCKS | {"parameters": BLOCKS["parameters"] | {"gap": 0.1}}
    known = {"rest_surface": rest_surface(run_directory, comm, height=0.5)}
    wall = {"shape": "plane", "point": [1, 0, 0], "normal": [-1, 0, 0]}
    contact = {"effect": "contact", "region": "side", "obstacle": wall, "closure": "conforming", "known": known}
    data: dict[str, Any] = {"regions": {"side": "x > 0.999 and z > 0.55"}, "mesh": apart, "analysis": "inverse"}
    given = GIVEN | {"effects": [contact], "uncertainty": "contact", "certificate": {"level": "quick"}}
    with pytest.raises(MeshError, match="'top' is not on the bodies that touch at 'side'"):
        hpcinv.run(job(**given | data), comm)


@pytest.mark.parametrize(
    ("contact", "analysis", "match"),
    [
        ({}, "inverse", "closure: is missing"),
        ({"closure": "touching"}, "forward", "leave it out"),
        ({"closure": "given"}, "inverse", "is for a round trip that begins with the forward solve: use 'conf"),
        ({"closure": "gap"}, "inverse", "rest_gap: must be given"),
        ({"closure": "conforming", "known": {"greatest_pressure": -1.0}}, "inverse", "must be positive"),
        ({"closure": "conforming", "kind": "tied"}, "inverse", "is not valid with 'kind: tied'"),
        ({"kind": "tied", "known": {"greatest_pressure": 1.0}}, "inverse", "known: is not valid without a 'closure'"),
        ({"closure": "touching", "known": {"greatest_pressure": 1.0}}, "inverse", "known: bounds an interval"),
        (
            {"closure": "least-energy", "known": {"rest_surface": {"region": "top", "file": "no.stl", "within": 1.0}}},
            "inverse",
            r"known\.rest_surface\.file: there is no file",
        ),
    ],
)
def test_closures_that_do_not_fit_are_refused(contact: dict[str, Any], analysis: str, match: str) -> None:
    interface = {"between": ["bottom", "top"], "kind": "contact"} | contact
    with pytest.raises(JobError, match=match):
        job(**{"mesh": BLOCKS, "interfaces": [interface], "analysis": analysis} | GIVEN)


def test_interval_without_a_closure_is_refused() -> None:
    with pytest.raises(JobError, match="uncertainty: needs an interface"):
        job(**{"mesh": BLOCKS, "analysis": "inverse", "uncertainty": "contact"} | GIVEN)
