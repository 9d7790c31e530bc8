"""Supports: components of the displacement that are fixed or prescribed on regions of the boundary."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.parameter_paths import POINTS, central_difference, step_at
from hpcinv.errors import MeshError, naming_field
from hpcinv.job.job import Job
from hpcinv.job.support import Motion, Support
from hpcinv.job.vocabulary import AXES
from hpcinv.mesh import Body
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.source import Floats
from hpcinv.model.parameters import load_factor
from hpcinv.model.spaces import Unknowns
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import Direction

_TOUCHING = 1e-12
"""Distance (scaled) of a node from its slide that is a rounding error; raised, a path may begin off the slide."""
_STEP = 2.0**-10
"""Length of differences of formulas over the body's; raised, their error grows with its fourth power; lowered, rounding
errors grow."""
_PROJECTIONS = 4
"""Newton steps that put nodes back on curved surfaces; with fewer, interpolated displacements leave them."""


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
    def space(self) -> fem.FunctionSpace:
        """The space of which ``nodes`` are numbers."""
        return self.now.function_space

    def component_of(self, vectors: Floats) -> Floats:
        """Return the held component of vectors (n, 3, …) at ``nodes``."""
        component: Floats = vectors[:, self.axis]
        return component

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """Present positions of ``nodes``, (n, 3) in scaled lengths."""
        points: npt.NDArray[np.float64] = self.now.function_space.tabulate_dof_coordinates()[self.nodes]
        return points


class Holder(Protocol):
    """What holds nodes along a direction: a component of a support, or a slide (`hpcinv.model.sliding`)."""

    @property
    def nodes(self) -> npt.NDArray[np.int32]:
        """Local nodes of ``space``, (n,)."""

    @property
    def space(self) -> fem.FunctionSpace:
        """The space of which ``nodes`` are numbers."""

    @property
    def points(self) -> Floats:
        """Present positions of ``nodes``, (n, 3) in scaled lengths."""

    def component_of(self, vectors: Floats) -> Floats:
        """Return the held component of vectors (n, 3, …) at ``nodes``."""


class Supports:
    """Dirichlet conditions ``u_i = λ ū_i``, with the load factor λ of each support's load case.

    ``ū`` is evaluated once, at the coordinates of the mesh of the job (m): in a round trip both directions prescribe
    the same displacement of the same material points. The normals of slides are on that mesh, too.

    Attributes:
        conditions: Dirichlet conditions of components along axes.
        prescribed: these components, support by support.
        slides: nodes that are held along their normals, support by support.
        remote_faces: regions that move rigidly under remote loads, by the number of the support.
        sliding: the constraints of ``slides``; ``None`` without any.
    """

    def __init__(self, job: Job, body: Body, unknowns: Unknowns) -> None:
        self.conditions: list[fem.DirichletBC] = []
        self.prescribed: list[Prescribed] = []
        self.prescribe_motion = False
        self._path: list[npt.NDArray[np.float64]] | None = None  # displacements at the beginning of a path
        self.slides: list[Any] = []
        self.remote_faces: dict[int, Any] = {}
        self._with_unknown_motion: frozenset[int] = frozenset()  # numbers of supports whose motion is an unknown
        self._first_gap: Floats | float = 0.0  # distance of slides' nodes from them at the beginning of a path
        self._gap: Floats | float = 0.0  # now
        self._unknowns = unknowns
        self._case_count, self._length, self._comm = job.case_count, body.length_scale, body.mesh.comm
        for number, spec in enumerate(job.supports):
            place = f"{job.place('supports')}[{number}]"
            with naming_field(f"{place}.region"):
                held = body.held_entities(spec.region)
            if spec.remote is not None:
                space = unknowns.displacement_space
                nodes = fem.locate_dofs_topological(space, 2, body.facets(spec.region))
                self.remote_faces[number] = on_demand("region of a remote load")(spec.region, space, nodes, unknowns)
            if spec.slides:
                slide = on_demand("slide of a support")(spec, place, body, unknowns)
                kept = self._kept(spec, place, slide.nodes, slide.space, body)
                self.slides.append(replace(slide, nodes=slide.nodes[kept], normals=slide.normals[kept]))
            for axis, name in enumerate(AXES):
                if name not in spec.held:
                    continue
                part = unknowns.displacement_component(axis)
                scalar, _ = part.collapse()
                dofs = list(dofs_on((part, scalar), held))
                kept = self._kept(spec, place, dofs[1], scalar, body)
                dofs = [part_dofs[kept] for part_dofs in dofs]
                now = fem.Function(scalar)
                full = np.zeros_like(now.x.array)
                self.conditions.append(fem.dirichletbc(now, dofs, part))
                field = f"{place}.{next(key for key in Support.alternatives if getattr(spec, key))}"
                self.prescribed.append(
                    Prescribed(field, number, spec.region, axis, job.case_of(spec), dofs[0], dofs[1], full, now)
                )
        fixed = np.zeros(len(unknowns.state.x.array), dtype=bool)
        fixed[self._dofs] = True
        sign = 1 if job.directions[0] == "forward" else -1
        self.sliding: Any = None
        if self.slides:
            self.sliding = on_demand("slides")(self.slides, unknowns, fixed, body.length_scale, sign)
        self._check_remote_faces(job)
        self.update_parameters(job)

    def _kept(self, spec: Support, place: str, nodes: LocalIndices, space: fem.FunctionSpace, body: Body) -> Any:
        """Return which nodes of a region a support holds, of a hinge those on the surface; collective.

        Raises:
            MeshError: on all ranks, if there are none, as on a face.
        """
        if not spec.hinge:
            return slice(None)
        kept = np.isin(nodes, _surface_nodes(space, body))
        if not self._comm.allreduce(bool(kept.any()), op=MPI.LOR):
            raise MeshError(
                f"{place}.hinge: '{spec.region}' has no nodes of the midsurface, about which the shell may turn",
                "Name an edge of the shell, or leave 'hinge' out.",
            )
        return kept

    def _check_remote_faces(self, job: Job) -> None:
        """Refuse remote loads on nodes that other supports hold; collective."""
        for number, face in self.remote_faces.items():
            held = [entry.dofs for entry in self.prescribed if entry.support != number]
            if self.sliding is not None:
                held.append(self.sliding.dofs.ravel())
            shares = bool(np.isin(face.dofs, np.concatenate(held)).any()) if held else False
            if self._comm.allreduce(shares, op=MPI.LOR):
                raise MeshError(
                    f"{job.place('supports')}[{number}].remote: other supports hold nodes of '{face.region}'",
                    "Let the regions share no node.",
                )

    @property
    def _dofs(self) -> npt.NDArray[np.int32]:
        return np.concatenate([np.zeros(0, dtype=np.int32), *(entry.dofs for entry in self.prescribed)])

    @property
    def is_curved(self) -> bool:
        """True if a region slides on a curved surface, so that held directions depend on the state."""
        return self.sliding is not None and bool(self.sliding.is_curved)

    @property
    def holders(self) -> list[Holder]:
        """Supports and their regions, component by component; regions under remote loads are left out."""
        return [*(entry for entry in self.prescribed if entry.support not in self._with_unknown_motion), *self.slides]

    def move_region(self, number: int, displacement: Callable[[Floats], Floats]) -> None:
        """Prescribe displacements (n, 3) of points of the present mesh (scaled) by one support at any load."""
        for entry in self.prescribed:
            if entry.support == number:
                entry.full[entry.nodes] = displacement(entry.points)[:, entry.axis]

    def prescribe_on(self, number: int, displacement: Callable[[Floats], Floats]) -> None:
        """Prescribe displacements (n, 3) by one support, and none by the others, until `scale` is called."""
        for entry in self.prescribed:
            entry.now.x.array[:] = 0.0
            if entry.support == number:
                entry.now.x.array[entry.nodes] = displacement(entry.points)[:, entry.axis]

    def update_parameters(self, job: Job) -> None:
        """Set the displacements of a job with supports on the same regions, on the mesh at its given coordinates.

        Raises:
            MeshError: on all ranks, if a formula has no finite value somewhere.
        """
        self._with_unknown_motion = frozenset(job.remote_loads)
        for entry in self.prescribed:
            spec = job.supports[entry.support]
            if spec.remote is not None:
                entry.full[:] = 0.0
            elif spec.motion is not None:
                moved = _moved(spec.motion, entry.points * self._length, job.directions[0])
                entry.full[entry.nodes] = moved[:, entry.axis] / self._length
            elif spec.displacement and (formula := spec.displacement[entry.axis]) is not None:
                entry.full[entry.nodes] = _values(spec, formula, entry.points * self._length) / self._length
                if not self._comm.allreduce(bool(np.isfinite(entry.full).all()), op=MPI.LAND):
                    raise MeshError(
                        f"{entry.field}: '{formula}' is not finite somewhere on '{spec.region}'",
                        "Check it for divisions by zero, and for roots and logarithms of negative numbers.",
                    )
        self.end_path()
        self._check_slides()

    def _check_slides(self) -> None:
        """Refuse displacements that would leave a slide; collective."""
        if self.sliding is None:
            return
        full = np.zeros(len(self._unknowns.state.x.array))
        for entry in self.prescribed:
            full[entry.dofs] = entry.full[entry.nodes]
        off = float(self.sliding.disagreement(full).max(initial=0.0))
        size = max((float(np.abs(entry.full).max(initial=0.0)) for entry in self.prescribed), default=0.0)
        off, size = (self._comm.allreduce(value, op=MPI.MAX) for value in (off, size))
        if off > 1e-9 * size:
            raise MeshError(
                f"{', '.join(slide.field for slide in self.slides)}: other supports move nodes of"
                f" {', '.join(repr(slide.region) for slide in self.slides)} along the normal by"
                f" {off * self._length:.6g} m",
                "Let the regions share no node, or prescribe a motion along the surface.",
            )

    def rates(
        self, number: int, variant: Callable[[float], Support], value: float, direction: Direction
    ) -> list[Floats]:
        """Return derivatives of the displacements at full load, on the mesh at its given coordinates.

        Args:
            variant: the support of this number as a function of a parameter.
            value: value of the parameter at which to differentiate.
            direction: of the solve.
        """
        step, changes = step_at(value), []
        specs = [variant(value + k * step) for k in POINTS]
        for entry in self.prescribed:
            rate = np.zeros_like(entry.full)
            if entry.support == number:
                points = entry.points * self._length
                values = [_prescribed(spec, entry.axis, points, direction) for spec in specs]
                rate[entry.nodes] = central_difference(values, step) / self._length
            changes.append(rate)
        return changes

    def position_rates(self, axis: int, job: Job) -> list[Floats]:
        """Return derivatives of the displacements at full load by a coordinate (m) of their points, as `rates`."""
        changes, step = list[Floats](), _STEP * self._length
        for entry in self.prescribed:
            rate = np.zeros_like(entry.full)
            spec, points = job.supports[entry.support], entry.points * self._length
            if spec.remote is None and len(points):
                e = step * np.eye(3)[axis]
                values = [_prescribed(spec, entry.axis, points + k * e, job.directions[0]) for k in POINTS]
                rate[entry.nodes] = central_difference(values, step) / self._length
            changes.append(rate)
        return changes

    def prescribe(self, values: Sequence[Floats]) -> None:
        """Prescribe what `rates` returned, until `scale` is called."""
        for entry, entry_values in zip(self.prescribed, values, strict=True):
            entry.now.x.array[:] = entry_values

    def scale(self, load: float, sign: int | None = None) -> None:
        """Prescribe the displacements at a share of the whole load, or of the path from another state.

        Args:
            sign: of displacements from the mesh to the other body, as in `Kinematics`; by default as before.
        """
        if self.sliding is not None and sign is not None:
            self.sliding.sign = sign
        self._gap = (1 - load) * self._first_gap
        for number, entry in enumerate(self.prescribed):
            if entry.support in self._with_unknown_motion:
                entry.now.x.array[:] = entry.full
            elif self._path is None:
                entry.now.x.array[:] = load_factor(load, entry.case, self._case_count) * entry.full
            else:
                entry.now.x.array[entry.nodes] = (1 - load) * self._path[number] + load * entry.full[entry.nodes]

    def scale_rates(self, rates: Sequence[float]) -> None:
        """Prescribe rates of the displacements along the path, until `scale` is called.

        Args:
            rates: rates of the load factors of all cases, which count on a path from the unloaded body.
        """
        self._gap = -np.asarray(self._first_gap)
        for number, entry in enumerate(self.prescribed):
            if self._path is None:
                entry.now.x.array[:] = rates[entry.case] * entry.full
            else:
                entry.now.x.array[entry.nodes] = entry.full[entry.nodes] - self._path[number]

    def held_part[T: np.floating[Any]](
        self, values: npt.NDArray[T], regions: Collection[str] | None = None
    ) -> npt.NDArray[T]:
        """Return the part of vectors at nodes along which they are held, zero elsewhere.

        Args:
            values: of the local unknowns, or of the owned ones.
            regions: of the supports that count; by default all.
        """
        part = np.zeros_like(values)
        for entry in self.prescribed:
            if regions is None or entry.region in regions:
                dofs = entry.dofs[entry.dofs < len(values)]
                part[dofs] = values[dofs]
        if self.sliding is not None:
            dofs, held = self.sliding.held(values, regions)
            np.add.at(part, dofs, held)
        return part

    def free(self, values: npt.NDArray[np.floating[Any]], *, displacements: bool = False) -> None:
        """Set to zero the held part of forces or displacements at nodes; of local unknowns or of owned ones."""
        dofs = self._dofs
        values[dofs[dofs < len(values)]] = 0.0
        if self.sliding is not None:
            dofs, held = self.sliding.held(values, displacements=displacements)
            values[dofs] -= held

    def row_values(self, missing: Floats) -> Floats:
        """Return the right-hand side in the rows of held nodes for what displacements lack (local unknowns)."""
        if self.sliding is None or not self.sliding.is_curved:
            return missing
        values = missing.copy()
        dofs, rows = self.sliding.row_values(missing)
        values[dofs] = rows
        return values

    def impose(self, x: Floats) -> None:
        """Set the held part of displacements among all local unknowns ``x`` to what is prescribed now."""
        for _ in range(_PROJECTIONS if self.is_curved else 1):
            x += self.missing(x)

    def missing(self, x: Floats | None) -> Floats:
        """Return what displacements among all local unknowns lack of what is prescribed now, zero if free.

        On curved surfaces this is to first order.

        Args:
            x: the displacements, ``None`` for none.
        """
        missing = np.zeros(len(self._unknowns.state.x.array))
        for condition in self.conditions:
            condition.set(missing)
        if x is not None:
            dofs = self._dofs
            missing[dofs] -= x[dofs]
        if self.sliding is not None:
            missing[self.sliding.dofs] += self.sliding.missing(missing, self.sliding.values(x) - self._gap)
        return missing

    def begin_path(self, x: npt.NDArray[np.float64]) -> None:
        """Let the displacements lead from the values in a state ``x`` (all local unknowns) to the prescribed ones."""
        self._path = [x[entry.dofs] for entry in self.prescribed]
        if self.sliding is not None:
            self._first_gap = self.sliding.values(x)
        moves = any(
            bool((start != entry.full[entry.nodes]).any())
            for start, entry in zip(self._path, self.prescribed, strict=True)
        )
        moves |= self.is_curved or bool(np.abs(self._first_gap).max(initial=0.0) > _TOUCHING)
        self.prescribe_motion = self._comm.allreduce(moves, op=MPI.LOR)

    def end_path(self) -> None:
        """Let the displacements lead from the unloaded body again; collective."""
        self._path, self._first_gap, self._gap = None, 0.0, 0.0
        moves = self.is_curved
        moves |= any(bool(entry.full.any()) or entry.support in self._with_unknown_motion for entry in self.prescribed)
        self.prescribe_motion = self._comm.allreduce(moves, op=MPI.LOR)


def dofs_on(spaces: Any, held: Mapping[int, LocalIndices]) -> Any:
    """Return the unknowns of a space, or of a part and its collapsed space, on entities by dimension; collective."""
    found = [np.asarray(fem.locate_dofs_topological(spaces, *entities)) for entities in held.items()]
    return np.ascontiguousarray(np.unique(np.concatenate(found, axis=-1), axis=-1))


def _surface_nodes(space: fem.FunctionSpace, body: Body) -> npt.NDArray[np.int32]:
    """Return local degrees of freedom on the given surface, which crosses the third axis of cells."""
    source, points = body.source, space.element.basix_element.points
    rows, count = np.asarray(body.mesh.topology.original_cell_index), sum(body.partition.cells)
    heights = source_of(source.body_kind).surface_heights(source, rows, count)
    is_there = np.abs(points[None, :, 2] - heights[:, None]) < 1e-9
    return np.unique(space.dofmap.list[is_there])


def _prescribed(spec: Support, axis: int, points: Floats, direction: Direction) -> Floats:
    """Return a component of the displacement (m) that a support prescribes at ``points`` (n, 3) m."""
    if spec.motion is not None:
        return np.asarray(_moved(spec.motion, points, direction)[:, axis])
    formula = spec.displacement and spec.displacement[axis]
    return np.zeros(len(points)) if formula is None else np.broadcast_to(_values(spec, formula, points), len(points))


def _moved(motion: Motion, points: Floats, direction: Direction) -> Floats:
    """Return the displacements (n, 3) m of a rigid motion at ``points`` (n, 3) m."""
    rigid = on_demand("rigid motion")(motion.rotate, motion.axis, motion.about, motion.move)
    displacement: Floats = rigid.displacement(points, direction)
    return displacement


def _values(spec: Support, formula: Expression, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return prescribed displacements by a formula of the support at ``points`` (n, 3) m, in m."""
    x, y, z = points.T
    with np.errstate(all="ignore"):  # the caller reports values that are not finite
        return np.asarray(formula.evaluate(x=x, y=y, z=z, **spec.constants))
