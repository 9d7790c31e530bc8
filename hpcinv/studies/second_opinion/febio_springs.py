"""Foundations in FEBio: a spring at each point of a quadrature, which moves as the facet there.

A node at the point has as its displacements the normal and tangential displacements of the facet, by linear
constraints, times the root of its area over the mean one; so all springs of a foundation have the same stiffness, and
their sum is the stiffness matrix of the run. FEBio's springs act along the line between their ends: an end far away
keeps that direction, to ``1e-6`` of the displacement over the size of the body.

Source: FEBio's ``FEDiscreteElasticDomain.cpp``, ``FESpringMaterial.cpp``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.studies.second_opinion.febio_ties import Ties, constraint
from hpcinv.studies.second_opinion.foundations import Foundation, SpringPoints, spring_points
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.units import Units

_FAR = 1e6
"""Length of a spring, in sizes of the body. Raised, its change has fewer digits; lowered, the spring turns."""
GROUND, POINTS = "hpcinv-ground", "hpcinv-spring-points"
"""node sets of the fixed ends of springs, and of points with a spring along their first axis only"""


@dataclass
class SpringLines:
    """Lines of a model on its springs, by the section that they are for."""

    nodes: list[str] = field(default_factory=list)
    sets: list[str] = field(default_factory=list)
    conditions: list[str] = field(default_factory=list)
    discrete: list[str] = field(default_factory=list)


def springs_of(body: LoadedBody, mesh: MeshSource, ties: Ties, first: int, units: Units) -> SpringLines:
    """Return the lines on all foundations of a body.

    Args:
        mesh: as the model has it.
        first: number of the first node that is not of the mesh.
        units: of the model.
    """
    lines, ground, single = SpringLines(), list[int](), list[int]()
    distance = _FAR * float(np.ptp(body.rest.points, axis=0).max()) / units.length
    for count, foundation in enumerate(body.foundations, 1):
        points = spring_points(body.rest, body.loaded, foundation, body.quadrature)
        tags = range(first, first + len(points.points))
        places = points.points / units.length
        lines.nodes += [_node(tag, place) for tag, place in zip(tags, places, strict=True)]
        lines.conditions += _constraints(foundation, points, tags, mesh, ties, units)
        single += [] if len(foundation.stiffnesses) > 1 else tags
        first += len(tags)
        for axis, stiffness in enumerate(foundation.stiffnesses):
            if not stiffness:  # FEBio has no spring without stiffness
                continue
            ends = range(first, first + len(tags))
            lines.nodes += [_node(t, p) for t, p in zip(ends, places + distance * np.eye(3)[axis], strict=True)]
            name = f"springs-{count}-{'xyz'[axis]}"
            pairs = "".join(f"<delem>{point},{end}</delem>" for point, end in zip(tags, ends, strict=True))
            lines.sets.append(f'<DiscreteSet name="{name}">{pairs}</DiscreteSet>')
            mean = stiffness * float(points.areas.mean()) / (units.force / units.length)
            number = len(lines.discrete) // 2 + 1
            title = f'discrete_material id="{number}" name="{name}" type="linear spring"'
            lines.discrete += [
                f"<{title}><E>{mean!r}</E></discrete_material>",
                f'<discrete dmat="{number}" discrete_set="{name}"/>',
            ]
            ground += ends
            first += len(ends)
    for name, nodes, dofs in ((GROUND, ground, "xyz"), (POINTS, single, "yz")):
        if nodes:
            lines.sets.append(f'<NodeSet name="{name}">{",".join(map(str, nodes))}</NodeSet>')
            held = "".join(f"<{axis}_dof>{int(axis in dofs)}</{axis}_dof>" for axis in "xyz")
            lines.conditions.append(f'<bc name="{name}" node_set="{name}" type="zero displacement">{held}</bc>')
    return lines


def _node(tag: int, place: Floats) -> str:
    return f'<node id="{tag}">{",".join(map(repr, place.tolist()))}</node>'


def _constraints(
    foundation: Foundation, points: SpringPoints, tags: range, mesh: MeshSource, ties: Ties, units: Units
) -> Iterator[str]:
    """Yield the displacements of the points; those that other constraints eliminate are written by their others."""
    sizes = np.sqrt(points.areas / points.areas.mean())
    axes = foundation.axes(points)[:, : len(foundation.stiffnesses)]
    factors = np.einsum("q,qk,qdi->qdki", sizes, points.shapes, axes)
    for tag, rows, directions in zip(tags, points.nodes.tolist(), factors.tolist(), strict=True):
        for axis, by_node in enumerate(directions):
            terms: dict[tuple[int, int], float] = {}
            offset = 0.0
            for row, parts in zip(rows, by_node, strict=True):
                for component, factor in enumerate(parts):
                    tie = ties.by_place.get((row, component))
                    offset += 0.0 if tie is None else factor * tie.offset
                    for other, share in ({component: 1.0} if tie is None else tie.factors).items():
                        terms[row, other] = terms.get((row, other), 0.0) + factor * share
            children = [(int(mesh.node_tags[row]), other, factor) for (row, other), factor in terms.items() if factor]
            yield constraint(tag, axis, children, offset / units.length)
