"""Parts of a body that share nodes but no facet: what then turns freely is refused before a solve, and nothing else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK, hpcinv_here, write_job
from helpers.hard_case import job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import MeshError
from hpcinv.mesh import build_body
from hpcinv.mesh.mesh_files import SAVERS
from hpcinv.mesh.refine.degree import change_degree
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.mesh.topology import unique_rows
from hpcinv.solver.equations import Equations

type Cube = tuple[int, int, int]
CORNERS = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
# Six tetrahedra around the diagonal of a cube; neighbouring cubes fit together.
TETRAHEDRA = [[0, 1, 3, 7], [0, 1, 7, 5], [0, 5, 7, 4], [0, 3, 2, 7], [0, 6, 4, 7], [0, 2, 6, 7]]
VERTEX: tuple[Cube, ...] = ((0, 0, 0), (1, 1, 1))
EDGE: tuple[Cube, ...] = ((0, 0, 0), (1, 1, 0))
RING: tuple[Cube, ...] = ((1, 0, 0), (0, 1, 0), (1, 2, 0), (2, 1, 0))
PLATE: tuple[Cube, ...] = tuple((i, j, -1) for i in range(3) for j in range(3))
SPRINGS: dict[str, Any] = {"effect": "elastic-foundation", "region": "right", "normal": "5 kPa/m"}


def voxels(cubes: Iterable[Cube], kind: str = "hexahedron", divisions: int = 2) -> MeshSource:
    """Cubes of 1 mm, each divided into some cubes along each axis, which are left whole or cut into tetrahedra."""
    fine = np.stack(np.meshgrid(*[np.arange(divisions)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    places = (np.array(list(cubes))[:, None] * divisions + fine).reshape(-1, 3)
    points, number = unique_rows((places[:, None] + CORNERS).reshape(-1, 3))
    cells = number.reshape(-1, 8)
    if kind == "tetrahedron":
        cells = cells[:, TETRAHEDRA].reshape(-1, 4)
    return MeshSource(
        Path("voxels.msh"),
        kind,
        1,
        points / divisions * 1e-3,
        np.arange(1, len(points) + 1),
        cells,
        np.arange(1, len(cells) + 1),
        np.zeros((0, 3 if kind == "tetrahedron" else 4), dtype=np.int64),
        unit=1e-3,
    )


REGIONS = {
    "left": "x < 1e-9 m",
    "right": "x > 1.999999 mm and x < 2.000001 mm and y > 0.9 mm",
    "top": "z > 0.999999 mm and x > 0.9 mm and y > 0.9 mm",
    "low": "y < 1e-9 m",
    "bottom": "z < -0.999999 mm",
    "far": "y > 2.999999 mm",
}


def model(comm: MPI.Intracomm, source: MeshSource, held: Mapping[str, str], **changes: Any) -> Equations:
    """The model of a body that is held on some regions, as far as it is made before a solve."""
    supports = [{"region": region, "fix": list(axes)} for region, axes in held.items()]
    used = {*held, *(effect["region"] for effect in changes.get("effects", []) if "region" in effect)}
    regions = {name: text for name, text in REGIONS.items() if name in used}
    case = job("free-to-turn", regions=regions, supports=supports, **changes)
    given = source if comm.rank == 0 else source.header()
    body = build_body(case.mesh, case.regions, comm, replacement=given)
    equations = Equations(case, body, Timings())
    equations.equilibrium(equations.weak_form("inverse")).destroy()
    return equations


def refusal(comm: MPI.Intracomm, source: MeshSource, held: Mapping[str, str], **changes: Any) -> str:
    with pytest.raises(MeshError) as caught:
        model(comm, source, held, **changes)
    assert caught.value.exit_code == 2
    assert comm.allreduce(str(caught.value) != comm.bcast(str(caught.value))) == 0  # every rank says the same
    return caught.value.message.split(": ", 1)[1]


def bent(source: MeshSource) -> MeshSource:
    """The same cells with a geometry of degree 2, bent so that straight lines along z are parabolas."""
    curved = change_degree(source, 2)
    x, y, z = curved.points.T
    points: Floats = np.stack([x, y + 0.1e3 * z * (1e-3 - z), z], axis=1)
    return replace(curved, points=points)


@pytest.mark.everyday("hexahedron-1")
@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", ["tetrahedron", "hexahedron"])
def test_a_part_that_hangs_on_a_vertex_or_an_edge_is_refused(kind: str, degree: int, comm: MPI.Intracomm) -> None:
    source = change_degree(voxels(VERTEX, kind), degree)
    cells = 8 if kind == "hexahedron" else 48
    assert refusal(comm, source, {"left": "xyz"}) == (
        f"voxels.msh: a part of {cells} cells around (1.5, 1.5, 1.5) mm touches the rest of the body only at the node"
        " (1, 1, 1) mm, about which it is free to turn in every way"
    )
    source = change_degree(voxels(EDGE, kind), degree)
    assert refusal(comm, source, {"left": "xyz"}) == (
        f"voxels.msh: a part of {cells} cells around (1.5, 1.5, 0.5) mm touches the rest of the body only on the"
        " straight line from (1, 1, 0) to (1, 1, 1) mm, and is free to turn about the axis through (1, 1, 0) mm along z"
    )


def test_a_support_that_leaves_the_turn_about_the_edge_does_not_help(comm: MPI.Intracomm) -> None:
    report = refusal(comm, voxels(EDGE), {"left": "xyz", "top": "z"})
    assert report.endswith("and is free to turn about the axis through (1, 1, 0) mm along z")


HELD: dict[str, tuple[MeshSource, dict[str, str]]] = {
    "a support of each part": (voxels(VERTEX), {"left": "xyz", "right": "xyz"}),
    "a support against the turn about the edge": (voxels(EDGE), {"left": "xyz", "right": "x"}),
    "a support against all turns about the vertex": (voxels(VERTEX), {"left": "xyz", "right": "xy", "top": "z"}),
    "a curved edge": (bent(voxels(EDGE)), {"left": "xyz"}),
    "a curved edge of tetrahedra": (bent(voxels(EDGE, "tetrahedron")), {"left": "xyz"}),
    "three nodes": (voxels([*PLATE, (0, 0, 0), (2, 0, 0), (0, 2, 0), (1, 1, 1)], divisions=1), {"bottom": "xyz"}),
    "two edges": (voxels([(0, 0, 0), (1, 1, 0), (0, 2, 0)]), {"left": "xyz"}),
    "facets": (voxels([*EDGE, (1, 0, 0)]), {"left": "xyz"}),
}


@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize(("source", "held"), HELD.values(), ids=HELD)
def test_held_hinges_are_accepted(source: MeshSource, held: dict[str, str], comm: MPI.Intracomm) -> None:
    model(comm, source, held)


def test_a_curved_edge_is_not_a_hinge_of_displacements_of_degree_1(comm: MPI.Intracomm) -> None:
    """Its vertices are on a straight line, but its cells cannot turn about that line."""
    model(comm, bent(voxels(EDGE, divisions=1)), {"left": "xyz"}, discretisation={"displacement": 1})
    report = refusal(comm, voxels(EDGE, divisions=1), {"left": "xyz"}, discretisation={"displacement": 1})
    assert report.endswith("and is free to turn about the axis through (1, 1, 0) mm along z")


@pytest.mark.parallel(2)
def test_several_nodes_on_one_line_are_a_hinge(comm: MPI.Intracomm) -> None:
    """A cube on two posts, which it touches at a corner each."""
    source = voxels([*PLATE, (0, 0, 0), (2, 0, 0), (1, 1, 1)], divisions=1)
    assert refusal(comm, source, {"bottom": "xyz"}) == (
        "voxels.msh: a part of 1 cell around (1.5, 1.5, 1.5) mm touches the rest of the body only on the straight line"
        " from (1, 1, 1) to (2, 1, 1) mm, and is free to turn about the axis through (0, 1, 1) mm along x"
    )


@pytest.mark.parallel(2)
def test_the_first_hinge_of_a_chain_is_described(comm: MPI.Intracomm) -> None:
    report = refusal(comm, voxels([(i, i, 0) for i in range(5)], divisions=1), {"left": "xyz"})
    assert report == (
        "voxels.msh: a part of 1 cell around (1.5, 1.5, 0.5) mm touches the rest of the body only at nodes between"
        " (1, 1, 0) and (2, 2, 1) mm, and is free to turn about the axis through (1, 1, 0) mm along z; and 3 more"
        " of its parts"
    )


@pytest.mark.parallel(2)
def test_parts_that_move_only_together_are_found(comm: MPI.Intracomm) -> None:
    """Four cubes in a ring, joined by edges: with one held, each other is held if its neighbours are."""
    report = refusal(comm, voxels(RING), {"low": "xyz"})
    assert report.count("a part of 8 cells around") == 3
    model(comm, voxels(RING), {"low": "xyz", "far": "x"})


@pytest.mark.parallel(2)
def test_springs_hold_a_hinge_if_they_resist_its_turn(comm: MPI.Intracomm) -> None:
    held = {"left": "xyz"}
    model(comm, voxels(EDGE), held, effects=[SPRINGS])
    for useless in (SPRINGS | {"region": "top"}, SPRINGS | {"region": "left"}):
        report = refusal(comm, voxels(EDGE), held, effects=[useless])
        assert report.endswith("and is free to turn about the axis through (1, 1, 0) mm along z")


def test_hinges_of_very_many_parts_are_found(comm: MPI.Intracomm) -> None:
    """More parts than have their motions found together: cubes on the corners of four posts each, and of two."""
    plate = [(i, j, -1) for i in range(18) for j in range(18)]
    posts = [(i, j, 0) for i in range(0, 18, 2) for j in range(0, 18, 2)]
    cubes = [(i, j, 1) for i in range(1, 16, 2) for j in range(1, 16, 2)]
    model(comm, voxels([*plate, *posts, *cubes], divisions=1), {"bottom": "xyz"})
    some = [post for post in posts if post[1] % 4 == 0]
    report = refusal(comm, voxels([*plate, *some, *cubes], divisions=1), {"bottom": "xyz"})
    assert "on the straight line from (1, 1, 1) to (2, 1, 1) mm, and is free to turn about" in report
    assert report.endswith("; and 61 more of its parts")


@pytest.mark.parallel(2)
def test_hinges_are_reported_once_before_the_solve(run_directory: Path) -> None:
    source = voxels(EDGE)
    SAVERS[".vtu"](run_directory / "doors.vtu", source, source.points / 1e-3)
    changes = {
        "mesh": {"file": "doors.vtu", "unit": "mm"},
        "regions": {"left": REGIONS["left"]},
        "supports": [{"region": "left", "fix": ["x", "y", "z"]}],
        "quantities": [],
    }
    ended = hpcinv_here("run", write_job(run_directory / "job.yaml", BLOCK, **changes), cwd=run_directory)
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.count("doors.vtu: a part of 8 cells around (1.5, 1.5, 0.5) mm touches the rest of the") == 1
    assert "Traceback" not in ended.stderr
    assert not (run_directory / "results").exists()
