"""A mesh or region that cannot be used is a clear error, the same on every rank, and never a hang."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import gmsh
import pytest
from helpers.mesh_cases import TETRAHEDRON, conditions, spec, write_msh22

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError, SystemPartMissing
from hpcinv.mesh import build_body
from hpcinv.mesh.io import gmsh_model

pytestmark = pytest.mark.slow

# Two tetrahedra on one facet, and the facets of the first.
TWO = (*TETRAHEDRON, (1.0, 1.0, 1.0))
FIRST, SECOND = (4, 1, 1, (1, 2, 3, 4)), (4, 1, 1, (2, 3, 4, 5))
BODY = (3, 1, "body")

PAIRS = ((0, 1), (1, 2), (2, 0), (0, 3), (2, 3), (1, 3))  # edges of gmsh's 10-node tetrahedron
MIDDLES = tuple(tuple((TETRAHEDRON[i][c] + TETRAHEDRON[j][c]) / 2 for c in range(3)) for i, j in PAIRS)


@dataclasses.dataclass(frozen=True)
class Bad:
    """A mesh that must be refused with ``message``."""

    message: str
    nodes: tuple[tuple[float, ...], ...]
    elements: tuple[tuple[int, int, int, tuple[int, ...]], ...]
    names: tuple[tuple[int, int, str], ...] = (BODY,)


BAD_MESHES = {
    "flat": Bad(
        r"1 cells have no volume \(cell 2\)", (*TETRAHEDRON, (0.5, 0.5, 0.0)), (FIRST, (4, 1, 1, (1, 2, 3, 5)))
    ),
    "inverted": Bad(r"1 cells are inverted.*\(cell 3\)", TWO, (FIRST, SECOND, (4, 1, 1, (1, 3, 2, 5)))),
    "curved too far": Bad(
        r"1 cells are inverted.*\(cell 1\)",
        (*TETRAHEDRON, *MIDDLES[:5], (-1.0, 0.0, 0.5)),
        ((11, 1, 1, tuple(range(1, 11))),),
    ),
    "double node": Bad(
        r"1 nodes coincide with another \(first: 1 and 6\)",
        (*TWO, TWO[0]),
        (FIRST, SECOND, (4, 1, 1, (2, 3, 6, 5))),
    ),
    "collapsed": Bad(
        r"1 cells are collapsed: they have a vertex twice \(cell 1\)",
        (*TETRAHEDRON, (1.0, 0.0, 1.0), (0.0, 1.0, 1.0)),
        ((5, 1, 1, (1, 2, 3, 3, 4, 5, 6, 6)),),
    ),
    "double cell": Bad("facets have more than two cells", TWO, (FIRST, SECOND, FIRST)),
    "facet of no cell": Bad(
        "1 facets of physical group 'clamp' belong to no cell",
        TWO,
        (FIRST, SECOND, (2, 1, 1, (1, 2, 5))),
        (BODY, (2, 1, "clamp")),
    ),
    "facet on a stray node": Bad(
        "1 facets of physical group 'clamp' belong to no cell",
        (*TWO, (9.0, 9.0, 9.0)),
        (FIRST, SECOND, (2, 1, 1, (1, 2, 6))),
        (BODY, (2, 1, "clamp")),
    ),
    "surface only": Bad("no solid cells", TWO, ((2, 1, 1, (1, 2, 3)),), ((2, 1, "skin"),)),
    "mixed cells": Bad(
        "cells are Pyramid 5 and Tetrahedron 4",
        (*TWO, (0.5, 0.5, -1.0), (2.0, 2.0, 0.0)),
        (FIRST, (7, 1, 2, (1, 2, 7, 3, 6))),
    ),
    "prism": Bad("cells are Prism 6", (*TWO, (2.0, 2.0, 0.0)), ((6, 1, 1, (1, 2, 3, 4, 5, 6)),)),
    "not finite": Bad("not finite", (*TETRAHEDRON, (1.0, 1.0, float("nan"))), (FIRST, SECOND)),
}


def fails_everywhere(comm: MPI.Intracomm, message: str, function: Callable[[], object]) -> MeshError:
    """The error that ``function`` raises on all ranks alike."""
    with pytest.raises(MeshError, match=message) as caught:
        function()
    error = caught.value
    assert error.advice
    assert comm.allgather((error.message, error.advice)) == [(error.message, error.advice)] * comm.size
    return error


@pytest.mark.parallel([1, 2, 3])
def test_every_bad_mesh_is_refused_on_all_ranks(comm: MPI.Intracomm, run_directory: Path) -> None:
    for name, bad in BAD_MESHES.items():
        path = run_directory / f"{name}.msh"
        if comm.rank == 0:
            write_msh22(path, bad.nodes, bad.elements, bad.names)
        comm.barrier()
        error = fails_everywhere(comm, bad.message, lambda path=path: build_body(spec(path), {}, comm))
        assert str(path) in error.message


@pytest.mark.parallel([1, 3])
def test_every_bad_region_is_refused_on_all_ranks(comm: MPI.Intracomm, run_directory: Path, meshes: Path) -> None:
    bare, curve, part = (run_directory / f"{name}.msh" for name in ("bare", "curve", "part"))
    if comm.rank == 0:
        write_msh22(bare, TWO, [(4, 0, 1, FIRST[3]), (4, 0, 1, SECOND[3])])
        write_msh22(curve, TWO, [FIRST, SECOND, (1, 1, 1, (1, 2))], [BODY, (1, 1, "edge")])
        write_msh22(part, TWO, [FIRST, SECOND, (2, 1, 1, (1, 2, 3))], [BODY, (2, 1, "boundary")])
    comm.barrier()

    def build(file: Path, **texts: str) -> Callable[[], object]:
        return lambda: build_body(spec(file), conditions(**texts), comm)

    error = fails_everywhere(
        comm, "region 'tip': no boundary facet and no cell satisfies 'x > 2'", build(bare, tip="x > 2")
    )
    assert "from (0, 0, 0) to (1, 1, 1) m" in error.advice
    both = build(bare, tip="x > 2", top="z > 3")
    assert fails_everywhere(comm, "region 'tip'", both).message.count("satisfies") == 2
    fails_everywhere(comm, "is a number, not a condition", build(bare, tip="x + 1"))
    fails_everywhere(comm, "region 'body' is also a physical group of the mesh", build(curve, body="x > 0"))

    body = build_body(spec(bare), conditions(clamp="z <= 0"), comm)
    assert (
        "The mesh has no physical groups."
        in fails_everywhere(comm, "no region 'skin'", lambda: body.facets("skin")).advice
    )
    fails_everywhere(comm, "no region 'clmp'. Did you mean 'clamp'", lambda: body.facets("clmp"))
    fails_everywhere(comm, "region 'clamp' has facets but no cells", lambda: body.cells("clamp"))
    fails_everywhere(comm, "'boundary' is not the whole boundary", build(part))
    body = build_body(spec(curve), {}, comm)
    fails_everywhere(comm, "region 'body' has cells but no facets", lambda: body.facets("body"))
    fails_everywhere(comm, "no region 'edge': it has points or lines only", lambda: body.facets("edge"))


def test_an_empty_physical_group_is_refused(comm: MPI.Intracomm, tmp_path: Path) -> None:
    generator = tmp_path / "empty.py"
    generator.write_text(
        "def build(gmsh):\n"
        "    box = gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)\n"
        "    gmsh.model.occ.synchronize()\n"
        "    gmsh.model.addPhysicalGroup(3, [box], name='body')\n"
        "    gmsh.model.addPhysicalGroup(2, [gmsh.model.addDiscreteEntity(2)], name='nothing')\n"
        "    gmsh.model.mesh.generate(3)\n"
    )
    fails_everywhere(comm, "physical group 'nothing' is empty", lambda: build_body(spec(generator), {}, comm))


def test_all_problems_of_a_mesh_are_reported_at_once(comm: MPI.Intracomm, tmp_path: Path) -> None:
    nodes, stray = (*TETRAHEDRON, (0.5, 0.5, 0.0)), (2, 1, 1, (1, 4, 5))
    path = write_msh22(tmp_path / "bad.msh", nodes, [FIRST, (4, 1, 1, (1, 2, 3, 5)), stray], [BODY, (2, 1, "clamp")])
    message = fails_everywhere(comm, "no volume", lambda: build_body(spec(path), {}, comm)).message
    assert len(message.splitlines()) == 2
    assert "1 facets of physical group 'clamp' belong to no cell" in message


@pytest.mark.release
def test_a_mesh_that_is_left_handed_throughout_is_accepted(comm: MPI.Intracomm, tmp_path: Path) -> None:
    path = write_msh22(tmp_path / "left.msh", TWO, [(4, 1, 1, (2, 1, 3, 4)), (4, 1, 1, (3, 2, 4, 5))], [BODY])
    assert build_body(spec(path), {}, comm).partition.cells == (2,)


def test_a_second_use_of_gmsh_is_refused_with_what_to_do(comm: MPI.Intracomm, meshes: Path) -> None:
    gmsh.initialize(interruptible=False)
    try:
        fails_everywhere(comm, "gmsh is already initialized", lambda: build_body(spec(meshes / "box.py"), {}, comm))
    finally:
        gmsh.finalize()


def test_missing_x_libraries_name_the_packages(
    comm: MPI.Intracomm, meshes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_library(_name: str) -> None:
        raise OSError("libGLU.so.1: cannot open shared object file: No such file or directory")

    monkeypatch.setattr(gmsh_model.importlib, "import_module", no_library)
    with pytest.raises(SystemPartMissing, match="libGLU") as caught:
        build_body(spec(meshes / "box.py"), {}, comm)
    assert "apt-get install libgl1 libglu1-mesa" in caught.value.advice
