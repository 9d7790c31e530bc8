"""Axes of nodes that are held along other directions than x, y and z: ``*TRANSFORM`` of CalculiX and Abaqus.

Source: Dhondt, *CalculiX CrunchiX User's Manual*, ``*TRANSFORM``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hpcinv.formats.inp import number
from hpcinv.mesh.source import Floats, Ints
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.slides import Slide
from hpcinv.studies.second_opinion.units import Units

_PARALLEL = 1e-6
"""Sine of the angle below which directions are the same; raised, nearly parallel planes hold one direction only."""


@dataclass(frozen=True)
class Frame:
    """Axes of nodes.

    Attributes:
        nodes: rows.
        axes: (3, 3), as rows; the first two are stated.
        held: displacements, m, by component (0, 1, 2).
        region: whose nodes they are; empty for other nodes.
    """

    nodes: Ints
    axes: Floats
    held: Mapping[int, float]
    region: str = ""


class Frames:
    """Axes of the nodes that slide.

    The axis of a plane has the number of its largest component, and an axis of the coordinates that is in the plane
    keeps its number: what other supports hold along it is said as elsewhere.
    """

    def __init__(self, body: LoadedBody) -> None:
        self._body = body
        self._clamped = _clamped(body)
        self.all = list[Frame]()
        self.own: Ints = np.zeros(0, dtype=np.int64)
        """nodes of which all that is held is said in axes of their own"""
        for slide in body.slides:
            if (frame := self._plane(slide)) is not None:
                self.all.append(frame)
        in_planes = self._nodes()
        others = [slide.nodes for slide in body.slides]
        self.own = np.setdiff1d(np.concatenate([in_planes, *others]), in_planes)
        self.all += self._own_frames()

    def _nodes(self) -> Ints:
        return np.concatenate([np.zeros(0, dtype=np.int64), *(frame.nodes for frame in self.all)])

    def _plane(self, slide: Slide) -> Frame | None:
        """Return the axes of a plane; ``None`` if one of its nodes is also held along another oblique direction."""
        normal = slide.plane_normal
        if normal is None:
            return None
        axes, kept = _axes_of_plane(normal)
        oblique = [other.nodes for other in self._body.slides if other is not slide]
        oblique += [np.setdiff1d(held.nodes, self._clamped) for held in self._body.held if held.axis != kept]
        if any(np.isin(slide.nodes, nodes).any() for nodes in oblique):
            return None
        return Frame(slide.nodes, axes, {int(normal.argmax()): 0.0}, slide.region)

    def _own_frames(self) -> Iterator[Frame]:
        conditions: dict[int, list[tuple[Floats, float]]] = {node: [] for node in self.own.tolist()}
        for slide in self._body.slides:
            for node, direction, value in zip(slide.nodes.tolist(), slide.directions, slide.values, strict=True):
                if node in conditions:
                    conditions[node].append((direction, float(value)))
        for held in self._body.held:
            for node, value in zip(held.nodes.tolist(), held.values.tolist(), strict=True):
                if node in conditions:
                    conditions[node].append((np.eye(3)[held.axis], value))
        for node, entries in conditions.items():
            yield _own_frame(node, entries)

    def axes(self, count: int) -> Floats:
        """Return the axes (count, 3, 3) of the first nodes, as rows."""
        axes = np.tile(np.eye(3), (count, 1, 1))
        for frame in self.all:
            axes[frame.nodes] = frame.axes
        return axes

    def local(self, vectors: Floats) -> Floats:
        """Return components (n, 3) of vectors at all nodes along the axes of these."""
        components: Floats = np.einsum("nij,nj->ni", self.axes(len(vectors)), vectors)
        return components

    def lines(self, tags: Ints, used: Ints) -> Iterator[str]:
        """Yield sets and axes of nodes.

        Args:
            tags: numbers of all nodes.
            used: nodes (rows) of the deck.
        """
        for name, frame in self._named(tags, used):
            if not frame.region:
                yield f"*NSET, NSET={name}\n{tags[frame.nodes[0]]}\n"
            yield f"*TRANSFORM, NSET={name}\n{', '.join(number(entry) for entry in frame.axes[:2].ravel().tolist())}\n"

    def held(self, tags: Ints, used: Ints, units: Units, *, moved: bool) -> Iterator[str]:
        """Yield lines of ``*BOUNDARY`` of what moves, or of what does not."""
        for name, frame in self._named(tags, used):
            for component, value in sorted(frame.held.items()):
                if bool(value) is moved:
                    place = name if frame.region else tags[frame.nodes[0]]
                    yield f"{place}, {component + 1}, {component + 1}, {number(value / units.length)}\n"

    def _named(self, tags: Ints, used: Ints) -> Iterator[tuple[str, Frame]]:
        is_used = np.zeros(len(tags), dtype=bool)
        is_used[used] = True
        for frame in self.all:
            if frame.region or is_used[frame.nodes[0]]:
                yield frame.region or f"HPCINV_AT_{tags[frame.nodes[0]]}", frame


def _clamped(body: LoadedBody) -> Ints:
    """Return the nodes that do not move at all: any axes say so."""
    counts = np.zeros((3, len(body.rest.points)), dtype=bool)
    for held in body.held:
        counts[held.axis, held.nodes[held.values == 0]] = True
    return np.flatnonzero(counts.all(axis=0))


def _axes_of_plane(normal: Floats) -> tuple[Floats, int | None]:
    """Return axes (3, 3) of a plane, and the axis of the coordinates that is one of them, if there is one."""
    across, along = int(np.abs(normal).argmax()), int(np.abs(normal).argmin())
    axes = np.zeros((3, 3))
    axes[across] = normal
    axes[along] = np.eye(3)[along] - normal[along] * normal
    axes[along] /= np.linalg.norm(axes[along])
    last = 3 - across - along
    axes[last] = np.cross(axes[(last + 1) % 3], axes[(last + 2) % 3])
    return axes, along if axes[along, along] == 1.0 else None


def _own_frame(node: int, entries: Sequence[tuple[Floats, float]]) -> Frame:
    directions = np.array([direction for direction, _ in entries])
    values = np.array([value for _, value in entries])
    _, sizes, axes = np.linalg.svd(directions)
    rank = int((sizes > _PARALLEL * sizes[0]).sum())
    axes[2] *= np.sign(np.linalg.det(axes))
    held = axes[:rank] @ np.linalg.lstsq(directions, values, rcond=_PARALLEL)[0]
    return Frame(np.array([node]), axes, dict(enumerate(held.tolist())))
