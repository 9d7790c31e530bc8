"""Check that parts of a body which share nodes, but no facet, cannot turn about these like doors on hinges.

Parts are sets of cells connected by facets. Each has six rigid motions. Nodes that parts share have the same
displacement in all of them, and supports and springs hold some components of it; the motions that are left strain
nothing: the tangent of the unloaded body is singular.

Null pivots of MUMPS (ICNTL 24) show the same motions, but in double precision only: in single precision, as in large
bodies, sound ones have null pivots too. Multigrid has none, and several states are checked before the first is solved.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem, la

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.quantity.units import length_symbol
from hpcinv.errors import MeshError
from hpcinv.mesh import Body
from hpcinv.mesh.extent import extent
from hpcinv.mesh.parts import parts_of
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.topology import connected, unique_rows
from hpcinv.model.assembly.system import System
from hpcinv.model.rigid_motions import Frame, free_motions, largest_stiffness, names, unsprung_basis
from hpcinv.model.supports import Supports
from hpcinv.solver.spring_stiffness import stiffness_of
from hpcinv.solver.support_checks import node_labels

_MOST_DESCRIBED = 3  # parts of a body in one message
# Parts whose motions are found together, by a dense matrix. In larger groups each part is checked by itself, as if the
# others were held: then all that turns by itself is found, but not what moves only together with other parts.
_MOST_TOGETHER = 60
_MOVES = 1e-6  # size of a motion, relative to the largest, below which a part is at rest
_NONE = np.zeros((0, 6))  # rows of a part that nothing holds
_ON_LINE = 1e-6  # distance of nodes from a straight line, relative to their extent, below which they are on it


@dataclass(frozen=True)
class _Joints:
    """Nodes that parts share: sorted rows (node, part) in ``nodes`` (n, 2), and ``points`` (n, 3)."""

    nodes: Ints
    points: Floats

    def part_points(self, part: int) -> Floats:
        """Return the points of the nodes that a part shares with others."""
        points: Floats = self.points[self.nodes[:, 1] == part]
        return points

    def pairs(self) -> Iterator[tuple[int, int, Floats]]:
        """Yield pairs of parts with the points of their common nodes: enough pairs to join all parts at each node."""
        both = [(i, i + 1) for i in range(len(self.nodes) - 1) if self.nodes[i, 0] == self.nodes[i + 1, 0]]
        rows = np.array(both, dtype=np.int64).reshape(-1, 2)
        distinct, place = unique_rows(self.nodes[rows, 1])
        for pair, (first, second) in enumerate(distinct.tolist()):
            yield first, second, self.points[rows[place == pair, 0]]


def check_hinges(body: Body, supports: Supports, space: fem.FunctionSpace, system: System | None = None) -> None:
    """Check that no part of the body can turn about the nodes that it shares with others; collective.

    The supports must hold the body as a whole (`check_held`), and `may_turn` be true.

    Args:
        space: of the displacement.
        system: equations, if there are springs.

    Raises:
        MeshError: on all ranks, with the parts that can, where they meet others, and their motions.
    """
    comm = body.mesh.comm
    count, cell_parts = parts_of(body, joined_by_facets=True)
    joints, frames, cells = _joints(body, space, cell_parts), *_frames(body, cell_parts, count)
    held = _held(supports, cell_parts, frames, comm)
    # On rank 0 only; the groups of parts that are joined by nodes.
    motions = on_root(comm, lambda: [*_free(joints, held, frames, alone=system is None)])
    if system is not None and motions:
        motions = _unsprung_motions(system, cell_parts, frames, motions)
    faults = {
        part: part_motions
        for group, free in motions
        for part, part_motions in zip(group, _part_motions(free), strict=True)
        if part_motions.size
    }
    if faults:
        # The motions of parts that hang on moving parts would show little.
        fewest = min(part_motions.shape[1] for part_motions in faults.values())
        first = [part for part, part_motions in faults.items() if part_motions.shape[1] == fewest][:_MOST_DESCRIBED]
        text = on_root(
            comm,
            lambda: "; ".join(_description(body, joints, frames[p], int(cells[p]), p, faults[p]) for p in first),
        )
        more = f"; and {len(faults) - len(first)} more of its parts" if len(faults) > len(first) else ""
        raise MeshError(
            f"{body.source.path}: {text}{more}",
            "Join the parts by facets (a fillet, an overlap, voxels), support each, or leave the part out.",
        )


def _joints(body: Body, space: fem.FunctionSpace, cell_parts: Ints) -> _Joints:
    """Return on rank 0 the nodes that parts share, sorted, and none elsewhere; collective.

    They are the nodes of the displacement, or of the geometry where that has more: turns about vertices on a line
    strain the cells on a curved edge.
    """
    comm, geometry = body.mesh.comm, body.mesh.geometry
    dofs, index_map, positions = space.dofmap.list, space.dofmap.index_map, space.tabulate_dof_coordinates()
    if geometry.dofmaps[0].shape[1] > dofs.shape[1]:
        dofs, index_map, positions = geometry.dofmaps[0], geometry.index_map(), geometry.x
    owned, total = index_map.size_local, index_map.size_local + index_map.num_ghosts
    least, most = np.full(total, np.iinfo(np.int64).max), np.full(total, -1)
    labels = np.repeat(cell_parts, dofs.shape[1])
    np.minimum.at(least, dofs.ravel(), labels)
    np.maximum.at(most, dofs.ravel(), labels)
    owner_parts = la.vector(index_map, 1, np.int64)
    owner_parts.array[:] = most
    owner_parts.scatter_forward()
    others = owner_parts.array
    shared = (least != most) | (others != most)
    numbers = index_map.local_to_global(np.arange(total, dtype=np.int32))
    here = shared[dofs]
    joint_dofs, label = dofs[here], np.broadcast_to(cell_parts[:, None], dofs.shape)[here]
    ghosts = owned + np.flatnonzero(shared[owned:])
    rows = np.concatenate(
        [np.stack([numbers[joint_dofs], label], axis=1), np.stack([numbers[ghosts], others[ghosts]], axis=1)]
    )
    rows, place = unique_rows(rows)
    points = np.empty((len(rows), 3))
    points[place] = positions[np.concatenate([joint_dofs, ghosts])]
    gathered = comm.gather((rows, points))
    if gathered is None:
        return _Joints(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)))
    rows, place = unique_rows(np.concatenate([r for r, _ in gathered]))
    points = np.empty((len(rows), 3))
    points[place] = np.concatenate([p for _, p in gathered])
    return _Joints(rows, points)


def _frames(body: Body, cell_parts: Ints, count: int) -> tuple[list[Frame], Ints]:
    """Return a frame around each part, and the number of its cells; collective."""
    comm, nodes = body.mesh.comm, body.mesh.geometry.dofmaps[0]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    labels = np.repeat(cell_parts, nodes.shape[1])
    np.minimum.at(low, labels, body.mesh.geometry.x[nodes.ravel()])
    np.maximum.at(high, labels, body.mesh.geometry.x[nodes.ravel()])
    comm.Allreduce(MPI.IN_PLACE, low, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, high, MPI.MAX)
    cells = np.bincount(cell_parts, minlength=count)
    comm.Allreduce(MPI.IN_PLACE, cells, MPI.SUM)
    sizes = np.linalg.norm(high - low, axis=1) / 2
    return [Frame(middle, size) for middle, size in zip((low + high) / 2, sizes.tolist(), strict=True)], cells


def _held(supports: Supports, cell_parts: Ints, frames: list[Frame], comm: MPI.Intracomm) -> dict[int, Floats]:
    """Return on rank 0 rows (n, 6) that supports prescribe of each part's motions; {} elsewhere; collective."""
    rows: dict[int, list[Floats]] = {}
    for support in supports.holders:
        points, labels = support.points, node_labels(support.space, cell_parts)[support.nodes]
        for part in np.unique(labels).tolist():
            components = support.component_of(frames[part].motions(points))
            rows.setdefault(part, []).append(components[labels == part])
    gathered = comm.gather({part: _reduced(np.vstack(part_rows)) for part, part_rows in rows.items()})
    together: dict[int, list[Floats]] = {}
    for rank_rows in gathered or []:
        for part, reduced in rank_rows.items():
            together.setdefault(part, []).append(reduced)
    return {part: np.vstack(part_rows) for part, part_rows in together.items()}


def _reduced(rows: Floats) -> Floats:
    """Return the triangle of a QR factorization, which constrains what its many rows do, with their mean square."""
    triangle: Floats = np.linalg.qr(rows, mode="r") / np.sqrt(len(rows))
    return triangle


def _free(
    joints: _Joints, held: dict[int, Floats], frames: list[Frame], *, alone: bool
) -> Iterator[tuple[Ints, Floats]]:
    """Yield groups of parts (p,) and a basis (6·p, k) of their free motions, if there are any.

    Args:
        alone: check the parts of large groups by themselves, rather than not at all.
    """
    pairs = [(lower, upper, points) for lower, upper, points in joints.pairs()]
    ends = np.array([pair[:2] for pair in pairs], dtype=np.int64).reshape(-1, 2)
    group_of = connected(np.concatenate([ends, np.tile(np.arange(len(frames)), (2, 1)).T]), len(frames))[len(ends) :]
    for number in np.unique(group_of[ends[:, 0]]).tolist():
        group = np.flatnonzero(group_of == number)
        together = len(group) <= _MOST_TOGETHER
        for members in [group] if together else [*group[:, None]] if alone else []:
            if together:
                rows = _rows_of_group(members, pairs, held, frames)
            else:
                there = frames[members[0]].motions(joints.part_points(members[0])).reshape(-1, 6)
                rows = np.vstack([held.get(int(members[0]), _NONE), _reduced(there)])
            free = free_motions(rows)
            if free.size:
                yield members, free


def _rows_of_group(
    group: Ints, pairs: Sequence[tuple[int, int, Floats]], held: dict[int, Floats], frames: list[Frame]
) -> Floats:
    """Return what the motions (6·p) of joined parts must not do, row by row: move held nodes, or part common ones."""
    first = {part: 6 * i for i, part in enumerate(group.tolist())}
    rows = [_placed({start: held.get(part, _NONE)}, 6 * len(group)) for part, start in first.items()]
    for lower, upper, points in pairs:
        if lower in first:
            motions = [frames[part].motions(points).reshape(-1, 6) for part in (lower, upper)]
            triangle = _reduced(np.hstack([motions[0], -motions[1]]))
            rows.append(_placed({first[lower]: triangle[:, :6], first[upper]: triangle[:, 6:]}, 6 * len(group)))
    return np.vstack(rows)


def _placed(blocks: dict[int, Floats], width: int) -> Floats:
    """Return rows of some width with blocks (n, 6) that begin at given columns, and zeros."""
    rows = np.zeros((len(next(iter(blocks.values()))), width))
    for start, block in blocks.items():
        rows[:, start : start + 6] = block
    return rows


def _unsprung_motions(
    system: System, cell_parts: Ints, frames: list[Frame], motions: Sequence[tuple[Ints, Floats]]
) -> list[tuple[Ints, Floats]]:
    """Return the motions of groups of parts that springs leave free; collective."""
    space, comm = system.weak_form.unknowns.displacement_space, system.comm
    points, node_parts = space.tabulate_dof_coordinates(), node_labels(space, cell_parts)
    low, high = extent(comm, points)
    whole = Frame((low + high) / 2, float(np.linalg.norm(high - low)) / 2)
    everywhere = np.ones(len(points), dtype=bool)
    (whole_stiffness,) = stiffness_of(system, 6, lambda motion: whole.moved(points, np.eye(6)[motion]), [everywhere])
    unsprung = []
    for group, free in motions:

        def field(number: int, group: Ints = group, free: Floats = free) -> Floats:
            moved: Floats = np.zeros_like(points)
            for part, part_motion in zip(group.tolist(), free[:, number].reshape(-1, 6), strict=True):
                here = node_parts == part
                moved[here] = frames[part].moved(points[here], part_motion)
            return moved

        (stiffness,) = stiffness_of(system, free.shape[1], field, [everywhere])
        soft = free @ unsprung_basis(np.eye(free.shape[1]), stiffness, largest_stiffness(whole_stiffness))
        if soft.size:
            unsprung.append((group, soft))
    return unsprung


def _part_motions(free: Floats) -> Iterator[Floats]:
    """Yield a basis (6, k) of the motions of each part of a group, from one of the group (6·p, m)."""
    for part_rows in free.reshape(-1, 6, free.shape[1]):
        basis, sizes, _ = np.linalg.svd(part_rows, full_matrices=False)
        yield basis[:, sizes > _MOVES]


def _description(body: Body, joints: _Joints, frame: Frame, cells: int, part: int, motions: Floats) -> str:
    """Return what a part is, where it meets others and how it can move; for rank 0."""
    unit = body.source.unit or 1.0
    length, symbol = body.length_scale / unit, length_symbol(unit)
    points = np.unique(joints.part_points(part), axis=0)
    largest = np.abs(joints.points).max(initial=frame.size)

    def place(point: Floats) -> str:
        rounded = np.round(point / largest, 9) * largest * length
        return f"({', '.join(f'{c:.6g}' for c in rounded + 0.0)})"

    what = f"a part of {cells} cell{'' if cells == 1 else 's'} around {place(frame.centre)} {symbol}"
    free = f"free to {' and to '.join(names(motions, frame, length, symbol))}"
    if len(points) == 1:
        turns = motions.shape[1] == 3 and np.abs(frame.motions(points)[0] @ motions).max() < _MOVES
        about = "about which it is free to turn in every way" if turns else f"and is {free}"
        return f"{what} touches the rest of the body only at the node {place(points[0])} {symbol}, {about}"
    centred = points - points.mean(axis=0)
    hinge_axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    hinge_axis *= np.sign(
        hinge_axis[np.abs(hinge_axis).argmax()]
    )  # so that the ends come in the same order on any machine
    heights = centred @ hinge_axis
    if np.abs(centred - np.outer(heights, hinge_axis)).max() <= _ON_LINE * np.ptp(heights):
        low, high = points[heights.argmin()], points[heights.argmax()]
        where = f"on the straight line from {place(low)} to {place(high)} {symbol}"
    else:
        where = f"at nodes between {place(points.min(axis=0))} and {place(points.max(axis=0))} {symbol}"
    return f"{what} touches the rest of the body only {where}, and is {free}"
