"""Pattern of a tangent, against DOLFINx's own of a form on the same space."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from dolfinx.mesh import CellType, create_unit_cube

from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.assembly.pattern import pattern_of
from hpcinv.model.spaces import Unknowns


@pytest.mark.everyday("(2, 1)-tetrahedron", "(1, None)-hexahedron")
@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("cell", [CellType.tetrahedron, CellType.hexahedron], ids=lambda cell: cell.name)
@pytest.mark.parametrize("degrees", [(2, 1), (1, None), (3, 2)], ids=str)
def test_rows_have_the_columns_that_a_compiled_form_has(
    cell: CellType, degrees: tuple[int, int | None], comm: MPI.Intracomm
) -> None:
    unknowns = Unknowns(create_unit_cube(comm, 2, 2, 3, cell), *degrees)
    assert unknowns.has_whole_nodes
    (pattern, all_columns), space = pattern_of(unknowns), unknowns.space
    mass: Any = ufl.TrialFunction(space)[0] * ufl.TestFunction(space)[0] * ufl.dx
    theirs = fem.create_sparsity_pattern(fem.form(mass))
    theirs.finalize()
    graph, bs = la.matrix_csr(theirs), space.dofmap.index_map_bs
    known = graph.index_map(1)
    names = known.local_to_global(np.arange(known.size_local + known.num_ghosts, dtype=np.int32))
    rows = len(graph.indptr) - 1
    assert len(pattern.starts) - 1 == bs * rows
    for row in range(bs * rows):
        blocks = names[graph.indices[graph.indptr[row // bs] : graph.indptr[row // bs + 1]]]
        columns = all_columns[pattern.starts[row] : pattern.starts[row + 1]]
        assert (np.diff(columns) > 0).all()
        assert sorted(pattern.names[columns]) == sorted((bs * blocks[:, None] + np.arange(bs)).ravel())
    assert np.array_equal(pattern.names[: bs * rows], (bs * names[:rows, None] + np.arange(bs)).ravel())
