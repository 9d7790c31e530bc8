"""Gaps of two surfaces at their nodes, and how they change where these move."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.interfaces.node_gaps import NodeGaps
from hpcinv.solver.equations import Equations


def equations_of(comm: MPI.Intracomm, **parameters: Any) -> tuple[Equations, Any]:
    posed = job(
        analysis="inverse",
        mesh={"file": "../meshes/two_blocks.py", "parameters": {"lower": 1, "upper": 2, **parameters}},
        material={"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
        discretisation={"displacement": 1},
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "fix": ["x", "y", "z"]}],
        interfaces=[{"between": ["bottom", "top"], "kind": "contact", "closure": "touching"}],
    )
    body = build_body(posed.mesh, posed.regions, comm, resolve=posed.resolve, degree=1)
    equations = Equations(posed, body, Timings())
    (pair,) = equations.weak_form("inverse").contacts.pairs
    return equations, pair


@pytest.mark.parallel([2, 1])
def test_gaps_at_nodes_and_their_rates_are_exact(comm: MPI.Intracomm) -> None:
    equations, pair = equations_of(comm, gap=0.1)
    unknowns, state = equations.unknowns, equations.unknowns.state.x
    length = equations.body.length_scale
    here: NodeGaps = pair.node_gaps(loaded=False)
    assert len(here.gaps) == 9 + 4
    assert here.gaps * length == pytest.approx(0.1, abs=1e-12)
    assert np.ptp(here.points[:, 2] * length) == pytest.approx(0.1)
    # the unloaded bodies are at x - u: a displacement that grows with z and x opens the gap unevenly
    dofs = unknowns.displacement_dofs_of_nodes
    field = unknowns.displacement()
    field.interpolate(lambda x: np.stack([0 * x[0], 0 * x[0], -1e-3 * x[2] * (1 + x[0])]))
    state.array[dofs] = field.x.array.reshape(-1, 3)[: len(dofs)]
    rates = here.rates(state.petsc_vec)
    there = pair.node_gaps(loaded=False)
    assert there.gaps - here.gaps == pytest.approx(-rates, abs=2e-6)
    assert np.abs(rates).min() > 4e-5
    for gaps in (here, there):
        gaps.destroy()


def test_nodes_overlap_where_the_mean_around_them_does_not(comm: MPI.Intracomm) -> None:
    """The lower face of the upper block is a paraboloid, whose lowest node is 1 mm below the flat face."""
    equations, pair = equations_of(comm, gap=-1e-3, crown=0.4)
    gaps = pair.node_gaps(loaded=False)
    assert gaps.gaps.min() * equations.body.length_scale == pytest.approx(-1e-3, abs=1e-4)
    assert pair._given.gaps.min() > 0
    gaps.destroy()
