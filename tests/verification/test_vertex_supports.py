"""Supports at vertices, as other programs' decks have them: a body whose loads balance, held at three points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import NEO_HOOKEAN, neo_hookean_stress, root, uniaxial
from helpers.homogeneous import solve
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError
from hpcinv.mesh import build_body
from hpcinv.solver import failing_motion
from hpcinv.trust.certificate import Line, Verdict
from hpcinv.trust.certificate.vertex_forces import VERTEX_FORCES

POINTS = {"a": [0, 0, 0], "b": [1, 0, 0], "c": [0, 1, 0]}
REGIONS = {name: {"vertices": [point]} for name, point in POINTS.items()}
SUPPORTS = [{"region": name, "fix": fix} for name, fix in (("a", ["x", "y", "z"]), ("b", ["y", "z"]), ("c", ["z"]))]


def stretched(stretch: float) -> tuple[np.ndarray, float]:
    """Return ``F`` of a bar with free sides, and the traction (Pa, per undeformed area) at its ends."""
    lateral = root(lambda a: neo_hookean_stress(uniaxial(stretch, a))[1, 1], 0.5, 1.5)
    F = uniaxial(stretch, lateral)
    return F, float(neo_hookean_stress(F)[0, 0])


def pulled(traction: float, *ends: str) -> list[dict[str, Any]]:
    """Dead tractions along the outer normal of the ends of a bar along x."""
    signs = {"x0": -1.0, "x1": 1.0}
    return [
        {"effect": "traction", "region": end, "traction": [signs[end] * traction, 0, 0], "area_in": "reference"}
        for end in ends
    ]


def line_of(result: hpcinv.Result) -> Line:
    (line,) = (line for line in result.certificate.lines if line.topic == VERTEX_FORCES)
    return line


@pytest.mark.release
@pytest.mark.parallel(2)
def test_balanced_loads_stretch_a_body_held_at_three_points(comm: MPI.Intracomm) -> None:
    """The closed form, with its rigid motion: the points are where they were, as far as they are held."""
    F, traction = stretched(1.3)
    common: dict[str, Any] = {"mesh": box((2, 2, 2)), "material": NEO_HOOKEAN, "discretisation": {"displacement": 1}}
    common |= {"regions": REGIONS, "supports": SUPPORTS, "effects": pulled(traction, "x0", "x1")}
    result = hpcinv.run(job(analysis="round_trip", first="forward", certificate="quick", **common), comm)
    there, back = result.solutions
    expected = there.reference_nodes @ (F - np.eye(3)).T
    assert np.abs(there.u - expected).max() < 1e-10
    assert np.abs(back.u - there.u).max() < 1e-10
    line = line_of(result)
    assert line.verdict is Verdict.PASS
    assert (line.value or 0.0) < 1e-10


def test_a_force_on_a_vertex_causes_a_warning(comm: MPI.Intracomm) -> None:
    _, traction = stretched(1.05)
    common: dict[str, Any] = {"mesh": box((2, 2, 2)), "material": NEO_HOOKEAN, "discretisation": {"displacement": 1}}
    common |= {"regions": REGIONS, "supports": SUPPORTS, "effects": pulled(traction, "x1")}
    result = hpcinv.run(job(analysis="forward", certificate="quick", **common), comm)
    line = line_of(result)
    assert line.verdict is Verdict.WARN
    # The traction at one end, and the force at the vertex that balances it.
    assert line.value == pytest.approx(1.0, rel=0.7)
    assert line.note == "on a, b, c"
    # On a facet that is held as well, a vertex carries no force of its own.
    common["supports"] = [{"region": "x0", "fix": ["x", "y", "z"]}, {"region": "a", "fix": ["x"]}]
    held = hpcinv.run(job(analysis="forward", certificate="quick", **common), comm)
    assert line_of(held).value == 0.0


@pytest.mark.parallel(2)
def test_an_edge_between_held_vertices_stays_in_place(comm: MPI.Intracomm) -> None:
    """Elements of degree 2 have nodes in the middle of the edges, which sets of other programs contain too."""
    ends = [[0, y, 0] for y in (0, 0.5, 1)]
    common: dict[str, Any] = {"mesh": box((2, 2, 2)), "material": NEO_HOOKEAN, "discretisation": {"displacement": 2}}
    common |= {"regions": {"line": {"vertices": ends}, "b": REGIONS["b"]}}
    common["supports"] = [{"region": "line", "fix": ["x", "y", "z"]}, {"region": "b", "fix": ["z"]}]
    bent = {"effect": "gravity", "acceleration": [0, 0, -1], "density": 0.05, "density_in": "reference"}
    result = hpcinv.run(job(analysis="forward", certificate="quick", effects=[bent], **common), comm)
    (solution,) = result.solutions
    x, _, z = solution.reference_nodes.T
    on_line = (np.abs(x) < 1e-12) & (np.abs(z) < 1e-12)
    count = comm.allreduce(int(on_line.sum()))
    assert count >= 5  # shared nodes count on both ranks
    assert np.abs(solution.u[on_line]).max(initial=0.0) < 1e-15  # 5e-7 in the middle of free edges
    assert comm.allreduce(float(np.abs(solution.u).max()), op=MPI.MAX) > 1e-5


@pytest.mark.fast
def test_vertices_are_for_supports_alone() -> None:
    data: dict[str, Any] = {"mesh": box((2, 2, 2)), "material": NEO_HOOKEAN, "regions": REGIONS}
    with pytest.raises(JobError, match=r"effects\[0\].region: 'a' is a set of vertices, which only supports can hold"):
        job(**data, supports=SUPPORTS, effects=[{"effect": "pressure", "region": "a", "pressure": 1}])
    with pytest.raises(JobError, match=r"regions.both: names 'a', which is a set of vertices"):
        job(**data | {"regions": REGIONS | {"both": ["a", "b"]}}, supports=SUPPORTS)
    with pytest.raises(JobError, match=r"regions.a: must be such as \{vertices: \[\["):
        job(**data | {"regions": {"a": {"vertices": [0, 0, 0]}}}, supports=SUPPORTS)


def test_a_point_without_a_vertex_is_refused_with_the_nearest(comm: MPI.Intracomm) -> None:
    with pytest.raises(MeshError, match=r"region 'a': there is no vertex at \(0.2, 0, 0\) m; the nearest is at \(0, 0"):
        solve("forward", comm, regions=REGIONS | {"a": {"vertices": [[0.2, 0, 0]]}}, supports=SUPPORTS)


def test_a_failed_run_counts_the_vertices_that_hold_it(comm: MPI.Intracomm) -> None:
    given = job(mesh=box((2, 2, 2)), material=NEO_HOOKEAN, regions=REGIONS, supports=SUPPORTS)
    body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
    assert list(failing_motion._supports(given, body))[:2] == [
        "'a' holds x, y, z at 1 vertex",
        "'b' holds y, z at 1 vertex",
    ]
