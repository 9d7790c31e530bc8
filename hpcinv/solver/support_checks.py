"""Checks that supports do not contradict each other, hold the body and leave it its volume, before it is solved."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import entities_to_geometry, exterior_facet_indices

from hpcinv.base.parallel.runtime import MPI, agree, on_root
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.errors import MeshError
from hpcinv.job.interfaces import Interface
from hpcinv.job.job import Job
from hpcinv.job.vocabulary import AXES
from hpcinv.mesh import Body
from hpcinv.mesh.boundary_shells import cells_of_facets, outer_facets
from hpcinv.mesh.extent import extent
from hpcinv.mesh.parts import parts_of
from hpcinv.mesh.regions import sides_of
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import connected
from hpcinv.model.assembly.system import System
from hpcinv.model.rigid_motions import Frame, free_motions, largest_stiffness, names, nearest_name, unsprung_basis
from hpcinv.model.supports import Holder, Prescribed, Supports
from hpcinv.solver.spring_stiffness import stiffness_of

_MOST_DESCRIBED = 3  # parts of a body in one message
_BARELY = 0.02
"""Share of the best held motion below which slides barely hold one: the normals of a coarse mesh are known to about a
degree. Raised, bodies that slightly oblique planes hold are named too."""
_FLAT = 1e-9  # component of a facet's normal that counts as zero


def check_agreement(job: Job, body: Body, supports: Supports) -> None:
    """Check that supports which share nodes prescribe the same there; collective.

    Raises:
        MeshError: on all ranks, with two supports that do not, a point, and the values.
    """
    error = next(_contradictions(job, body, supports), None)
    agree(body.mesh.comm, error)


def _contradictions(job: Job, body: Body, supports: Supports) -> Iterator[MeshError]:
    """Yield an error for each pair of supports that prescribe one component of a node of this rank differently."""
    farthest = np.abs(body.mesh.geometry.x).max(initial=0.0)
    for later, second in enumerate(supports.prescribed):
        for first in supports.prescribed[:later]:
            if first.axis != second.axis:
                continue
            shared, a, b = np.intersect1d(first.dofs, second.dofs, return_indices=True)
            if not len(shared):
                continue
            ua, ub = first.full[first.nodes[a]], second.full[second.nodes[b]]
            # Formulas that agree on paper differ by rounding errors, of their values and of the coordinates in them.
            size = max(np.abs(first.full).max(), np.abs(second.full).max())
            tolerance = 1e-9 * size + 8 * np.finfo(float).eps * (farthest if size else 0.0)
            differ = np.abs(ua - ub) > tolerance
            apart = (first.case != second.case) & (np.minimum(np.abs(ua), np.abs(ub)) > tolerance)
            if (differ | apart).any():
                worst = int(np.argmax(np.abs(ua - ub) + apart * np.abs(ua)))
                values = (float(u[worst]) * body.length_scale for u in (ua, ub))
                place = np.round(first.points[a[worst]] / farthest, 9) * farthest * body.length_scale
                point = ", ".join(f"{c:.6g}" for c in place + 0.0)
                yield _contradiction(job, first, second, values, point)


def _contradiction(job: Job, first: Prescribed, second: Prescribed, values: Iterator[float], point: str) -> MeshError:
    said = [
        f"{u:.9g} m" + (f" ({job.load_cases[p.case]})" if job.load_cases else "")
        for p, u in zip((first, second), values, strict=True)
    ]
    axis = AXES[first.axis]
    return MeshError(
        f"{first.field} and {second.field}: {said[0]} and {said[1]} along {axis} on a node at ({point}) m",
        f"Prescribe the same in both, leave {axis} free in one, or separate their regions.",
    )


@dataclass(frozen=True)
class _ConnectedPart:
    """Connected part of the body: number of its cells, middle of its nodes, and frame of its motions."""

    label: int
    cells: int
    middle: Floats
    frame: Frame


def check_held(
    body: Body, supports: Supports, system: System | None = None, interfaces: Sequence[Interface] = ()
) -> None:
    """Check that supports, and springs, hold every part of the body; collective.

    Args:
        system: equations, if there are springs.
        interfaces: which join parts.

    Raises:
        MeshError: on all ranks, with the rigid motions that are left.
    """
    comm = body.mesh.comm
    count, labels = parts_of(body)
    if interfaces:
        count, labels = joined_parts(body, interfaces, count, labels)
    parts = [_part(body, supports, labels, label, system is not None) for label in range(count)]
    stiffness = _stiffness(system, labels, parts) if system is not None else [np.zeros((6, 6))] * count
    # Of all parts: on one that no spring holds, rounding errors would be measured by themselves.
    stiffest = max(map(largest_stiffness, stiffness))
    faults = []
    for part, springs in zip(parts, stiffness, strict=True):
        motions = _free(comm, supports, labels, part, springs, stiffest)
        if motions.shape[1]:
            middle = ", ".join(f"{c:.4g}" for c in part.middle * body.length_scale)
            cells = f"{part.cells} cell{'' if part.cells == 1 else 's'}"
            what = "the body" if count == 1 else f"its part of {cells} around ({middle}) m"
            faults.append(f"{what} free to {' and to '.join(names(motions, part.frame, body.length_scale))}")
    if faults:
        more = f"; and {len(faults) - _MOST_DESCRIBED} more of its parts" if len(faults) > _MOST_DESCRIBED else ""
        apart = "" if count == 1 else f" The mesh has {count} parts that share no node: hold each, or join them."
        raise MeshError(
            f"supports: leave {'; '.join(faults[:_MOST_DESCRIBED])}{more}",
            f"Fix more components or regions: one facet in x, y and z holds a body, and so do springs.{apart}",
        )


def barely_held(body: Body, supports: Supports) -> str:
    """Return the rigid motion that only small differences between the normals of slides hold, else ""; collective.

    A round bore alone does not hold a body against turning in it, but the normals of its mesh are not quite radial.
    Springs are not regarded.
    """
    if not supports.slides:
        return ""
    comm = body.mesh.comm
    count, labels = parts_of(body)
    for label in range(count):
        part = _part(body, supports, labels, label, whole=False)
        rows = _constraints(comm, supports.holders, labels, part)
        others = _constraints(comm, [s for s in supports.holders if isinstance(s, Prescribed)], labels, part)

        def found(rows: Floats = rows, others: Floats = others, frame: Frame = part.frame) -> str:
            _, singular, motions = np.linalg.svd(np.vstack([rows, np.zeros((6, 6))]), full_matrices=False)
            weakest, motion = singular[-1], motions[-1]
            resisted = float(np.linalg.norm(others @ motion)) if len(others) else 0.0
            if weakest > _BARELY * singular[0] or resisted > weakest / 2:
                return ""
            return nearest_name(motion, frame, body.length_scale)

        if name := on_root(comm, found):
            return name
    return ""


def may_turn(body: Body) -> bool:
    """Return whether parts of the body are joined by nodes alone, about which they may turn; collective."""
    count, _ = parts_of(body, joined_by_facets=True)
    return count > 1 and count != parts_of(body)[0]


def _part(body: Body, supports: Supports, labels: Ints, label: int, whole: bool) -> _ConnectedPart:
    """Return a part; its frame is around the held nodes, or around all nodes if ``whole``; collective."""
    comm = body.mesh.comm
    owned = body.mesh.topology.index_map(3).size_local
    cells = np.flatnonzero(labels[:owned] == label)
    nodes = body.mesh.geometry.x[np.unique(body.mesh.geometry.dofmaps[0][cells])]
    held = [_points(support, labels, label) for support in supports.holders]
    middle, extent = _box(comm, nodes)
    held_box = _box(comm, np.vstack([np.zeros((0, 3)), *held]))
    centre, size = held_box if held_box[1] > 0 and not whole else (middle, extent)
    return _ConnectedPart(label, comm.allreduce(len(cells)), middle, Frame(centre, size))


def _box(comm: MPI.Intracomm, points: Floats) -> tuple[Floats, float]:
    """Return middle and half the diagonal of the bounding box of points (n, 3) of all ranks; 0 without any."""
    low, high = extent(comm, points)
    if not np.isfinite(low).all():
        return np.zeros(3), 0.0
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2


def node_labels(space: fem.FunctionSpace, labels: Ints) -> Ints:
    """Return the label of a cell of this rank at each node of a space; -1 at nodes of cells of other ranks only."""
    labels_there = np.full(space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts, -1, dtype=np.int64)
    labels_there[space.dofmap.list] = labels[:, None]
    return labels_there


def _points(support: Holder, labels: Ints, label: int) -> Floats:
    points: Floats = support.points[node_labels(support.space, labels)[support.nodes] == label]
    return points


def _free(
    comm: MPI.Intracomm, supports: Supports, labels: Ints, part: _ConnectedPart, springs: Floats, stiffest: float
) -> Floats:
    """Return a basis (6, k) of the free rigid motions of a part; collective."""
    rows = _constraints(comm, supports.holders, labels, part)
    return on_root(comm, lambda: unsprung_basis(free_motions(rows), springs, stiffest))


def _constraints(comm: MPI.Intracomm, holders: Iterable[Holder], labels: Ints, part: _ConnectedPart) -> Floats:
    """Return rows (n, 6) of the held components of a part for its six motions, on rank 0 (0 rows elsewhere)."""
    rows = []
    for support in holders:
        components = support.component_of(part.frame.motions(support.points))
        rows.append(components[node_labels(support.space, labels)[support.nodes] == part.label])
    # The triangle of a QR factorization constrains what its many rows do.
    triangles = comm.gather(np.linalg.qr(np.vstack([np.zeros((0, 6)), *rows]), mode="r"))
    return np.vstack([np.zeros((0, 6)), *(triangles or [])])


def _stiffness(system: System, labels: Ints, parts: list[_ConnectedPart]) -> list[Floats]:
    """Return the stiffness (6, 6) of each part against its rigid motions, which strain nothing but springs."""
    space = system.weak_form.unknowns.displacement_space
    points, node_parts = space.tabulate_dof_coordinates(), node_labels(space, labels)

    def field(motion: int) -> Floats:
        moved: Floats = np.zeros_like(points)
        for part in parts:
            here = node_parts == part.label
            moved[here] = part.frame.moved(points[here], np.eye(6)[motion])
        return moved

    return stiffness_of(system, 6, field, [node_parts == part.label for part in parts])


def check_not_enclosed(job: Job, body: Body) -> None:
    """Check that the supports of an incompressible body leave a facet free to move along its normal; collective.

    Where that motion is prescribed on the whole surface, the volume is prescribed twice, and the pressure is known up
    to a constant only: the tangent is singular.

    Raises:
        MeshError: on all ranks, if they do not.
    """
    if not all(law.is_incompressible for law in job.laws.values()):
        return
    topology = body.mesh.topology
    facets = exterior_facet_indices(topology)
    facets = facets[facets < topology.index_map(2).size_local]
    _, areas = outer_facets(body.mesh, facets)
    count, labels = parts_of(body)
    facet_parts = labels[cells_of_facets(body.mesh, facets)]
    faces = np.abs(areas) > _FLAT * np.linalg.norm(areas, axis=1, keepdims=True)
    faces[~_are_flat(body, facets, areas)] = True  # curved: nothing is known of the normals
    for i, axis in enumerate(AXES):
        held = [body.held_facets(support.region) for support in job.supports if axis in support.held]
        faces[np.isin(facets, np.concatenate(held)) if held else slice(0), i] = False
    for support in job.supports:
        if support.slides:
            slides = np.isin(facets, body.held_facets(support.region))
            if support.normal is not None:
                sizes = np.linalg.norm(areas, axis=1) * np.linalg.norm(support.normal)
                slides &= np.abs(areas @ np.array(support.normal)) >= (1 - _FLAT) * sizes
            faces[slides] = False
    free = np.zeros(count, dtype=np.int64)
    free[facet_parts[faces.any(axis=1)]] = 1
    body.mesh.comm.Allreduce(MPI.IN_PLACE, free, MPI.MAX)
    if not free.all():
        what = "an incompressible body" if count == 1 else f"a part of an incompressible body (of {count} parts)"
        raise MeshError(
            f"supports: hold the whole surface of {what}: its pressure is not determined",
            "Leave a part of the surface free, or give the law a bulk modulus.",
        )


def _are_flat(body: Body, facets: LocalIndices, areas: Floats) -> npt.NDArray[np.bool_]:
    """Return whether all nodes of each facet with this area vector lie in one plane."""
    if not len(facets):
        return np.zeros(0, dtype=np.bool_)
    nodes = body.mesh.geometry.x[entities_to_geometry(body.mesh, 2, facets)]
    heights = np.einsum("fni,fi->fn", nodes - nodes[:, :1], areas)
    return np.asarray(np.abs(heights).max(axis=1) <= _FLAT * np.linalg.norm(areas, axis=1) ** 1.5)


def joined_parts(body: Body, interfaces: Sequence[Interface], count: int, labels: Ints) -> tuple[int, Ints]:
    """Return number and labels of the parts that are left if those on both sides of interfaces are one; collective.

    Args:
        count, labels: parts that share no node, as `parts_of` returns them.
    """
    pairs = list[tuple[int, int]]()
    for interface in interfaces:
        found = np.concatenate([_labels(body, labels, name) for name in sides_of(body.regions, interface.between)])
        everywhere = np.unique(np.concatenate(body.mesh.comm.allgather(found)))
        pairs += [(int(everywhere[0]), int(other)) for other in everywhere[1:]]
    joints = np.array([*pairs, *((part, part) for part in range(count))], dtype=np.int64)
    _, numbers = np.unique(connected(joints, count)[-count:], return_inverse=True)
    return int(numbers.max()) + 1, numbers[labels]


def _labels(body: Body, labels: Ints, region: str) -> Ints:
    return labels[cells_of_facets(body.mesh, body.facets(region))]
