"""Supports that leave a body free, or contradict each other, and loads that do nothing: reported before a solve."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.command_line import hpcinv_here as command
from helpers.hard_case import JOBS, job, solve
from helpers.mesh_cases import write_msh22

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import MeshError
from hpcinv.mesh import build_body
from hpcinv.model.rigid_motions import Frame, free_motions, names
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.check import Verdict
from hpcinv.trust.certificate.ineffective_loads import ineffective_loads

NAME = "free-to-turn"
SPRINGS: dict[str, Any] = {"effect": "elastic-foundation", "region": "x1", "normal": "5 kPa/m"}


def model(comm: MPI.Intracomm, **changes: Any) -> Equations:
    """The model of a job, as far as it is made before a solve: equations too, since springs need them."""
    case = job(NAME, **changes)
    body = build_body(case.mesh, case.regions, comm, resolve=case.resolve)
    equations = Equations(case, body, Timings())
    equations.equilibrium(equations.weak_form("inverse")).destroy()
    return equations


def refusal(comm: MPI.Intracomm, **changes: Any) -> str:
    """The message, without the file of the job that it begins with."""
    with pytest.raises(MeshError) as caught:
        model(comm, **changes)
    assert caught.value.exit_code == 2
    assert comm.allreduce(str(caught.value) != comm.bcast(str(caught.value))) == 0  # every rank says the same
    file, message = caught.value.message.split(": ", 1)
    assert file.endswith(f"{NAME}.yaml")
    return message


def held(**faces: str) -> dict[str, Any]:
    return {"supports": [{"region": face, "fix": list(axes)} for face, axes in faces.items()]}


# Rigid motions


@pytest.mark.release
@pytest.mark.parallel(3)
def test_free_rigid_motions_are_named(comm: MPI.Intracomm) -> None:
    about_x = "supports: leave the body free to turn about the axis through (0, 0, 0) m along x"
    assert refusal(comm) == about_x
    faults = refusal(comm, supports=held(x0="x")["supports"], effects=[SPRINGS])
    assert faults == (
        "supports: leave the body free to move along y and z and to turn about the axis through (0, 0.5, 0.5) m along x"
    )
    along_z = refusal(comm, supports=held(x0="x")["supports"], effects=[SPRINGS | {"region": "y1"}])
    assert along_z == "supports: leave the body free to move along z"


HOLDING = {
    "a clamp": held(x0="xyz"),
    "three planes": held(x0="x", y0="y", z0="z"),
    "a plane and a hinge": held(x0="x", x1="yz"),
    "two planes": held(z0="xy", z1="z"),
    "springs in all directions": {"supports": [], "effects": [SPRINGS | {"tangential": "1 Pa/m"}]},
    "springs all around": {"supports": [], "effects": [SPRINGS | {"region": "boundary"}]},
    "a plane and springs": held(x0="x") | {"effects": [SPRINGS | {"tangential": "1 kPa/m"}]},
}


@pytest.mark.parametrize("supports", HOLDING.values(), ids=HOLDING)
def test_sufficient_supports_are_accepted(supports: dict[str, Any], comm: MPI.Intracomm) -> None:
    model(comm, **supports)


@pytest.mark.parallel(2)
def test_every_part_of_a_body_must_be_held(comm: MPI.Intracomm, run_directory: Path) -> None:
    """Two tetrahedra, 2 m apart along x."""
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    if comm.rank == 0:
        write_msh22(
            run_directory / "apart.msh",
            [*corners, *((x + 2, y, z) for x, y, z in corners)],
            [(4, 1, 1, (1, 2, 3, 4)), (4, 1, 1, (5, 6, 7, 8))],
            [(3, 1, "body")],
        )
    comm.barrier()
    apart = {
        "mesh": {"file": str(run_directory / "apart.msh")},
        "regions": {"first": "x < 1e-9 m", "second": "x > 1.999999 m and x < 2.000001 m", "side": "z < 1e-9 m"},
    }
    assert refusal(comm, **apart, **held(first="xyz")) == (
        "supports: leave its part of 1 cell around (2.5, 0.5, 0.5) m free to move and turn in every way"
    )
    assert refusal(comm, **apart, **held(first="xyz", second="xy")) == (
        "supports: leave its part of 1 cell around (2.5, 0.5, 0.5) m free to move along z"
    )
    model(comm, **apart, **held(first="xyz", second="xyz"))
    # Springs on the first only: what they do to the second is rounding errors, which must not be taken for springs.
    springs = {"effects": [SPRINGS | {"region": "first", "tangential": "1 kPa/m"}], "supports": []}
    assert refusal(comm, **apart, **springs) == (
        "supports: leave its part of 1 cell around (2.5, 0.5, 0.5) m free to move and turn in every way"
    )


def test_rigid_motions_against_their_definition() -> None:
    """Random single constraints: the motions that are found do nothing to them, and are as many as there must be."""
    random = np.random.default_rng(4)
    for count in range(7):
        points, axes = random.normal(size=(count, 3)), random.integers(3, size=count)
        frame = Frame(random.normal(size=3), 1.7)
        rows = frame.motions(points)[np.arange(count), axes]
        free = free_motions(rows)
        assert free.shape == (6, 6 - np.linalg.matrix_rank(rows))
        assert np.abs(rows @ free).max(initial=0.0) < 1e-12


def test_the_axis_of_a_turn_is_where_nothing_moves() -> None:
    """Held along z in a line of points and along x and y in one of them: free to turn about that line."""
    line = np.array([[1.0, 2.0, 0.5], [2.0, 4.0, 0.5], [4.0, 8.0, 0.5]])
    frame = Frame(np.array([0.3, -0.2, 0.9]), 2.0)
    motions = frame.motions(line)
    rows = np.concatenate([motions[:, 2], motions[:, 0], motions[:, 1]])
    (text,) = names(free_motions(rows), frame, 10.0)
    assert text == "turn about the axis through (0, 0, 5) m along (0.447214, 0.894427, 0)"


def test_a_free_screw_motion_is_named_screw() -> None:
    """All but a turn about z that takes the body along z with it."""
    screw = np.array([0, 0, 0.5, 0, 0, 1.0])
    rows = np.linalg.svd(screw[None])[2][1:]
    assert names(free_motions(rows), Frame(np.zeros(3), 1.0), 1.0) == [
        "screw about the axis through (0, 0, 0) m along z"
    ]


# Contradictions


@pytest.mark.parallel(3)
def test_a_contradiction_is_reported_with_its_supports_its_place_and_its_values(comm: MPI.Intracomm) -> None:
    contradiction = job("contradicting-supports").supports
    faults = refusal(comm, supports=[s.model_dump(exclude_none=True) for s in contradiction])
    assert re.fullmatch(
        r"supports\[0\].fix and supports\[1\].displacement: 0 m and 0.1 m along x on a node at \(1, [\d.]+, 0\) m",
        faults,
    )


def test_supports_that_agree_where_they_meet_may_overlap(comm: MPI.Intracomm) -> None:
    """By different formulas, up to rounding errors, the displacement being small."""
    shear = ["1e-9*(z - 0.1 m) + 1e-10 m", 0, 0], ["1e-9*z", 0, 0]
    model(comm, supports=[{"region": f, "displacement": d} for f, d in zip(("z0", "x1"), shear, strict=True)])


@pytest.mark.parametrize(("case", "refused"), [("push", False), ("pull", True)])
def test_supports_of_different_load_cases_contradict_each_other_on_the_way(
    case: str, refused: bool, comm: MPI.Intracomm
) -> None:
    moved = {"displacement": ["0.1 m", 0, 0]}
    data = {
        "load_cases": ["push", "pull"],
        "supports": [{"region": "z0", "case": "push", **moved}, {"region": "x1", "case": case, **moved}],
    }
    if refused:
        assert "0.1 m (push) and 0.1 m (pull) along x on a node at (1," in refusal(comm, **data)
    else:
        model(comm, **data)


@pytest.mark.parallel(2)
def test_contradicting_supports_are_reported_once_with_exit_code_2(run_directory: Path) -> None:
    ended = command("run", JOBS / "contradicting-supports.yaml", cwd=run_directory)
    assert ended.returncode == 2
    assert ended.stderr.count("supports[0].fix and supports[1].displacement: 0 m and 0.1 m along x") == 1
    assert "Traceback" not in ended.stderr
    assert not (run_directory / "results").exists()


# Loads that do nothing


def test_a_load_on_a_held_face_moves_nothing_and_is_warned_of(comm: MPI.Intracomm) -> None:
    result = solve("load-on-a-held-face", comm)
    assert result.quantities["largest-displacement"] == 0.0
    assert result.solutions[0].solves[-1].outcome.accepted
    case = job("load-on-a-held-face")
    body = build_body(case.mesh, case.regions, comm, resolve=case.resolve)
    (line,) = ineffective_loads(Equations(case, body, Timings()), result.solutions[0])
    print(line)
    assert (line.value, line.verdict) == (1.0, Verdict.WARN)
    assert "effects[0] pressure on 'z0'" in line.note


def test_a_load_on_a_face_that_is_free_somewhere_is_not_warned_of(comm: MPI.Intracomm) -> None:
    for region in ("x1", "boundary"):
        case = job("load-on-a-held-face", effects=[{"effect": "pressure", "region": region, "pressure": 1e3}])
        body = build_body(case.mesh, case.regions, comm, resolve=case.resolve)
        solution: Any = SimpleNamespace(job=case)
        assert not [*ineffective_loads(Equations(case, body, Timings()), solution)]


@pytest.mark.everyday("no load")
@pytest.mark.parametrize(
    ("analysis", "effects"),
    [("inverse", []), ("round_trip", [{"effect": "pressure", "region": "x1", "pressure": 0}])],
    ids=["no load", "a load of nothing"],
)
def test_without_a_load_the_body_stays_as_it_is(
    analysis: str, effects: list[dict[str, Any]], comm: MPI.Intracomm
) -> None:
    """With the whole certificate, which has nothing to divide by."""
    result = solve("load-on-a-held-face", comm, analysis=analysis, effects=effects, certificate={})
    assert result.quantities["largest-displacement"] == 0.0
    verdicts = {line["name"]: line["verdict"] for line in result.statistics["certificate"]["lines"]}
    print(verdicts)
    assert result.certificate.verdict is Verdict.PASS


# Enclosed bodies

INCOMPRESSIBLE = {"law": "neo-hookean", "mu": "1 MPa", "lam": "incompressible"}
ROLLERS = [{"region": f"{axis}{end}", "fix": [axis]} for axis in "xyz" for end in (0, 1)]


@pytest.mark.release
@pytest.mark.parallel(2)
def test_an_incompressible_body_needs_a_free_surface(comm: MPI.Intracomm) -> None:
    clamped = [{"region": "boundary", "fix": ["x", "y", "z"]}]
    for supports in (clamped, ROLLERS):
        report = refusal(comm, supports=supports, material=INCOMPRESSIBLE)
        assert report.startswith("supports: hold the whole surface of an incompressible body")
    curved = {"file": "../../meshes/box.py", "parameters": {"nx": 2, "ny": 2, "nz": 2}, "geometry_degree": 2}
    assert "whole surface" in refusal(comm, mesh=curved, supports=ROLLERS, material=INCOMPRESSIBLE)
    model(comm, supports=ROLLERS[:-1], material=INCOMPRESSIBLE)
    model(comm, supports=clamped, material=INCOMPRESSIBLE | {"lam": "1 GPa"})
