"""How wrong a discrete solution may be: the correction that spaces of one degree more make to it.

A two-level estimate: ``u_h`` is put in the spaces of degree ``k + 1`` on the same mesh, and one Newton correction
``K δ = -R(u_h)`` there gives ``u_h + δ``, whose own error is of higher order. Then ``Q(u_h + δ) - Q(u_h)`` estimates
the error of any quantity ``Q``, that of the quadrature included. What the mesh lacks of the body's true geometry is not
seen.

Source: Bank & Weiser, "Some a posteriori error estimators for elliptic partial differential equations" (1985),
doi:10.1090/S0025-5718-1985-0777265-X; Ainsworth & Oden, *A Posteriori Error Estimation in Finite Element Analysis*
(2000), ch. 5, doi:10.1002/9781118032824.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from hpcinv.interest import Value, evaluate
from hpcinv.kernels import JIT_OPTIONS
from hpcinv.legs import leg_of
from hpcinv.model import Model
from hpcinv.runtime import MPI

if TYPE_CHECKING:
    from hpcinv.job import Job
    from hpcinv.result import Leg


@dataclass(frozen=True)
class Estimate:
    """Estimated discretisation errors of one leg.

    Attributes:
        quantities: corrected less computed value of each quantity of interest (SI), a list of 3 for a vector.
        corrected: the corrected values.
        shape: largest correction of the displacement at a geometry node, in m.
        cells: ``∫ |∇δ|² dx`` of each owned cell, in scaled lengths: where the error is.
        unknowns: number of unknowns of the finer spaces.
    """

    quantities: Mapping[str, Value]
    corrected: Mapping[str, Value]
    shape: float
    cells: npt.NDArray[np.float64]
    unknowns: int

    def as_data(self) -> dict[str, Any]:
        """The estimate as JSON data, without the cells."""
        return {
            "quantities": dict(self.quantities),
            "corrected": dict(self.corrected),
            "shape": self.shape,
            "unknowns": self.unknowns,
        }


def estimate(model: Model, leg: Leg, computed: Mapping[str, Value]) -> Estimate:
    """Estimate the errors of a leg, whose mesh must lie as the leg was solved; collective.

    Args:
        model: that of the leg.
        computed: values of the job's quantities of interest.
    """
    finer = Model(one_degree_more(model.job), model.body, model.timings)
    u, p = finer.solution()
    u.interpolate(leg.displacement)
    if p is not None:
        p.interpolate(leg.pressure)
    finer.set_solution(u, p)
    finer.unknowns.state.x.scatter_forward()
    scene = finer.scene(leg.direction)
    equilibrium = finer.equilibrium(scene, lambda: False)
    equilibrium.correct(1.0)
    equilibrium.destroy()
    better = leg_of(finer, leg.direction, scene, ())
    corrected = evaluate(model.job.quantities, model.body, better, finer)
    comm = model.body.mesh.comm
    largest = float(np.linalg.norm(better.u - leg.u, axis=1).max(initial=0.0))
    delta = better.displacement
    delta.x.array[:] -= u.x.array
    return Estimate(
        quantities={name: _difference(corrected[name], value) for name, value in computed.items()},
        corrected=corrected,
        shape=comm.allreduce(largest, op=MPI.MAX),
        cells=_by_cell(delta, model.body.length_scale),
        unknowns=finer.unknowns.size,
    )


def one_degree_more(job: Job) -> Job:
    """The same job in spaces of one degree more, with the quadrature that these need."""
    spaces = job.discretisation
    finer: dict[str, int] = {"displacement": spaces.displacement + 1}
    if spaces.pressure is not None:
        finer["pressure"] = spaces.pressure + 1
    if spaces.quadrature is not None:
        finer["quadrature"] = spaces.quadrature + 2
    return job.model_copy(update={"discretisation": spaces.model_copy(update=finer)})


def _difference(corrected: Value, computed: Value) -> Value:
    if isinstance(corrected, list):
        assert isinstance(computed, list)
        return [a - b for a, b in zip(corrected, computed, strict=True)]
    assert not isinstance(computed, list)
    return corrected - computed


def _by_cell(delta: fem.Function, length: float) -> npt.NDArray[np.float64]:
    mesh = delta.function_space.mesh
    constant = fem.functionspace(mesh, ("DG", 0))
    gradient = ufl.grad(delta) / length
    degree = 2 * delta.function_space.ufl_element().degree - 2
    form = ufl.inner(gradient, gradient) * ufl.TestFunction(constant) * ufl.dx(metadata={"quadrature_degree": degree})
    vector = fem.assemble_vector(fem.form(form, jit_options=JIT_OPTIONS))
    owned = mesh.topology.index_map(3).size_local
    return np.asarray(vector.array[constant.dofmap.list[:owned, 0]])
