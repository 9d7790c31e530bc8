"""A solution taken from one discretisation of a body to another, to begin the next solve with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
from dolfinx import fem

from hpcinv.mesh.moved import placed
from hpcinv.parallel.runtime import MPI

if TYPE_CHECKING:
    from hpcinv.mesh import Body
    from hpcinv.results.solution import Solution
    from hpcinv.solver.problem import Model

# A curved surface of one mesh lies outside of the straight cells of another, by a share of the larger cell.
_PADDING = 0.2


def begin_with(model: Model, solution: Solution, body: Body) -> None:
    """Make ``solution``, on a mesh of ``body``, the present state of ``model``; collective."""
    u, p = model.solution()
    pairs = [(u, solution.displacement)] if p is None else [(u, solution.displacement), (p, solution.pressure)]
    for new, old in pairs:
        assert old is not None
        if model.body is body:
            new.interpolate(old)
        else:
            _across(new, old, body.length_scale / model.body.length_scale)
    model.set_solution(u, p)
    model.unknowns.state.x.scatter_forward()


def _across(new: fem.Function, old: fem.Function, scale: float) -> None:
    """Interpolate between meshes that lie in one place, the old one in lengths ``1/scale`` times those of the new."""
    here, there = new.function_space.mesh, old.function_space.mesh
    cells, owned = (np.arange(m.topology.index_map(3).size_local, dtype=np.int32) for m in (here, there))
    with placed(there, there.geometry.x * scale):
        largest = here.comm.allreduce(float(there.h(3, owned).max(initial=0.0)), op=MPI.MAX)
        data = fem.create_interpolation_data(new.function_space, old.function_space, cells, padding=_PADDING * largest)
        new.interpolate_nonmatching(old, cells, data)
    new.x.scatter_forward()
