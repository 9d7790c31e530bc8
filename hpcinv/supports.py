"""Supports: components of the displacement that are fixed or prescribed on regions of the boundary."""

from __future__ import annotations

from typing import TYPE_CHECKING

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.errors import MeshError, told_with
from hpcinv.parameters import load_factor
from hpcinv.runtime import MPI
from hpcinv.sections import AXES

if TYPE_CHECKING:
    from hpcinv.job import Job
    from hpcinv.mesh import Body
    from hpcinv.unknowns import Unknowns


class Supports:
    """Dirichlet conditions ``u_i = λ ū_i``, with the load factor λ of each support's load case.

    ``ū`` is evaluated once, at the coordinates of the mesh as the job gives it (m): in a round trip the second leg
    prescribes the same displacement of the same material points.
    """

    def __init__(self, job: Job, body: Body, unknowns: Unknowns) -> None:
        self.conditions: list[fem.DirichletBC] = []
        self._case_count, self._cases = job.case_count, list[int]()
        self._full: list[npt.NDArray[np.float64]] = []
        self._now: list[fem.Function] = []
        for number, spec in enumerate(job.supports):
            with told_with(f"supports[{number}].region"):
                facets = body.facets(spec.region)
            for i, axis in enumerate(AXES):
                if axis not in spec.held:
                    continue
                formula = spec.displacement[i] if spec.displacement else None
                part = unknowns.displacement_component(i)
                scalar, _ = part.collapse()
                dofs = fem.locate_dofs_topological((part, scalar), body.mesh.topology.dim - 1, facets)
                now = fem.Function(scalar)
                full = np.zeros_like(now.x.array)
                held = dofs[1]
                if formula is not None:
                    x, y, z = scalar.tabulate_dof_coordinates().T * body.length_scale
                    with np.errstate(all="ignore"):  # what is not finite is told below, once
                        values = formula.evaluate(x=x[held], y=y[held], z=z[held], **spec.constants)
                    full[held] = np.asarray(values) / body.length_scale
                if not body.mesh.comm.allreduce(bool(np.isfinite(full).all()), op=MPI.LAND):
                    raise MeshError(
                        f"supports[{number}].displacement: '{formula}' is not finite somewhere on '{spec.region}'",
                        "Check it for divisions by zero, and for roots and logarithms of negative numbers.",
                    )
                self.conditions.append(fem.dirichletbc(now, dofs, part))
                self._full.append(full)
                self._cases.append(job.case_of(spec))
                self._now.append(now)
        moves = any(bool(full.any()) for full in self._full)
        self.prescribe_motion: bool = body.mesh.comm.allreduce(moves, op=MPI.LOR)

    def scale(self, load: float) -> None:
        """Prescribe the displacements that belong to a share of the whole load."""
        for now, full, case in zip(self._now, self._full, self._cases, strict=True):
            now.x.array[:] = load_factor(load, case, self._case_count) * full
