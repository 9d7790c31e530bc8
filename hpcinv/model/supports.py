"""Supports: components of the displacement that are fixed or prescribed on regions of the boundary."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.errors import MeshError, naming_field
from hpcinv.job.job import Job
from hpcinv.job.sections import AXES, Support
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.model.parameters import load_factor
from hpcinv.model.spaces import Unknowns
from hpcinv.parallel.runtime import MPI
from hpcinv.quantity.expressions import Expression
from hpcinv.quantity.parameter_paths import POINTS, central_difference, step_at


@dataclass(frozen=True)
class Prescribed:
    """One component of the displacement on one support, on this rank.

    Attributes:
        field: key of the job, such as ``supports[2].fix``.
        support: number of the support.
        axis: number of the component.
        dofs: its degrees of freedom among all unknowns.
        nodes: the same degrees of freedom in the space of ``now``, which is the space of this component.
        full: values at full load (scaled lengths) at every node of that space, zero at free nodes.
        now: values at the present load.
    """

    field: str
    support: int
    region: str
    axis: int
    case: int
    dofs: npt.NDArray[np.int32]
    nodes: npt.NDArray[np.int32]
    full: npt.NDArray[np.float64]
    now: fem.Function

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """Present positions of ``nodes``, (n, 3) in scaled lengths."""
        points: npt.NDArray[np.float64] = self.now.function_space.tabulate_dof_coordinates()[self.nodes]
        return points


class Supports:
    """Dirichlet conditions ``u_i = λ ū_i``, with the load factor λ of each support's load case.

    ``ū`` is evaluated once, at the coordinates of the mesh of the job (m): in a round trip both directions prescribe
    the same displacement of the same material points.
    """

    def __init__(self, job: Job, body: Body, unknowns: Unknowns) -> None:
        self.conditions: list[fem.DirichletBC] = []
        self.prescribed: list[Prescribed] = []
        self.prescribe_motion = False
        self._path: list[npt.NDArray[np.float64]] | None = None  # displacements at the beginning of a path
        self._case_count, self._length, self._comm = job.case_count, body.length_scale, body.mesh.comm
        for number, spec in enumerate(job.supports):
            place = f"{job.place('supports')}[{number}]"
            with naming_field(f"{place}.region"):
                facets = body.facets(spec.region)
            for axis, name in enumerate(AXES):
                if name not in spec.held:
                    continue
                part = unknowns.displacement_component(axis)
                scalar, _ = part.collapse()
                dofs = fem.locate_dofs_topological((part, scalar), body.mesh.topology.dim - 1, facets)
                now = fem.Function(scalar)
                full = np.zeros_like(now.x.array)
                self.conditions.append(fem.dirichletbc(now, dofs, part))
                field = f"{place}.{'displacement' if spec.displacement else 'fix'}"
                self.prescribed.append(
                    Prescribed(field, number, spec.region, axis, job.case_of(spec), dofs[0], dofs[1], full, now)
                )
        self.update_parameters(job)

    def update_parameters(self, job: Job) -> None:
        """Set the displacements of a job with supports on the same regions, on the mesh at its given coordinates.

        Raises:
            MeshError: on all ranks, if a formula has no finite value somewhere.
        """
        for entry in self.prescribed:
            spec = job.supports[entry.support]
            if spec.displacement and (formula := spec.displacement[entry.axis]) is not None:
                entry.full[entry.nodes] = _values(spec, formula, entry.points * self._length) / self._length
                if not self._comm.allreduce(bool(np.isfinite(entry.full).all()), op=MPI.LAND):
                    raise MeshError(
                        f"{entry.field}: '{formula}' is not finite somewhere on '{spec.region}'",
                        "Check it for divisions by zero, and for roots and logarithms of negative numbers.",
                    )
        self.end_path()

    def rates(self, number: int, variant: Callable[[float], Support], value: float) -> list[Floats]:
        """Return derivatives of the displacements at full load, on the mesh at its given coordinates.

        Args:
            variant: the support of this number as a function of a parameter.
            value: value of the parameter at which to differentiate.
        """
        step, changes = step_at(value), []
        specs = [variant(value + k * step) for k in POINTS]
        for entry in self.prescribed:
            rate = np.zeros_like(entry.full)
            formulas = [spec.displacement and spec.displacement[entry.axis] for spec in specs]
            if entry.support == number and formulas[0] is not None:
                points = entry.points * self._length
                values = [_values(spec, f, points) for spec, f in zip(specs, formulas, strict=True) if f is not None]
                rate[entry.nodes] = central_difference(values, step) / self._length
            changes.append(rate)
        return changes

    def prescribe(self, values: Sequence[Floats]) -> None:
        """Prescribe what `rates` returned, until `scale` is called."""
        for entry, entry_values in zip(self.prescribed, values, strict=True):
            entry.now.x.array[:] = entry_values

    def scale(self, load: float) -> None:
        """Prescribe the displacements at a share of the whole load, or of the path from another state."""
        for number, entry in enumerate(self.prescribed):
            if self._path is None:
                entry.now.x.array[:] = load_factor(load, entry.case, self._case_count) * entry.full
            else:
                entry.now.x.array[entry.nodes] = (1 - load) * self._path[number] + load * entry.full[entry.nodes]

    def scale_rates(self, rates: Sequence[float]) -> None:
        """Prescribe rates of the displacements, until `scale` is called, for rates of the load factors of all cases."""
        for one in self.prescribed:
            one.now.x.array[:] = rates[one.case] * one.full

    def begin_path(self, x: npt.NDArray[np.float64]) -> None:
        """Let the displacements lead from the values in a state ``x`` (all local unknowns) to the prescribed ones."""
        self._path = [x[entry.dofs] for entry in self.prescribed]
        moves = any(
            bool((start != entry.full[entry.nodes]).any())
            for start, entry in zip(self._path, self.prescribed, strict=True)
        )
        self.prescribe_motion = self._comm.allreduce(moves, op=MPI.LOR)

    def end_path(self) -> None:
        """Let the displacements lead from the unloaded body again; collective."""
        self._path = None
        moves = any(bool(entry.full.any()) for entry in self.prescribed)
        self.prescribe_motion = self._comm.allreduce(moves, op=MPI.LOR)


def _values(spec: Support, formula: Expression, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return prescribed displacements by a formula of the support at ``points`` (n, 3) m, in m."""
    x, y, z = points.T
    with np.errstate(all="ignore"):  # the caller reports values that are not finite
        return np.asarray(formula.evaluate(x=x, y=y, z=z, **spec.constants))
