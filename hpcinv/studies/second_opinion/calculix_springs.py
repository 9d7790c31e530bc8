"""Foundations in CalculiX and Abaqus: a spring at each point of a quadrature, which moves as the facet there.

A node at the point has as its displacements the normal and tangential displacements of the facet, by ``*EQUATION``,
times the root of its area over the mean one; so all springs of a foundation have the same stiffness, and their sum is
the stiffness matrix of the run. Springs at the nodes would lump it.

Source: Dhondt, *CalculiX CrunchiX User's Manual*, ``*EQUATION``, ``*SPRING``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcinv.formats.inp import number
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.studies.second_opinion.calculix_frames import Frames
from hpcinv.studies.second_opinion.foundations import SpringPoints, spring_points
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.units import Units

_TERMS_PER_LINE = 4


def spring_lines(body: LoadedBody, mesh: MeshSource, frames: Frames, node: int, units: Units) -> Iterator[str]:
    """Yield nodes, equations and springs of all foundations.

    Args:
        mesh: as the deck has it.
        node: number of the first node.
        units: of the deck.
    """
    element = int(mesh.cell_tags.max()) + 1
    for count, foundation in enumerate(body.foundations, 1):
        points = spring_points(body.rest, body.loaded, foundation, body.quadrature)
        stiffnesses = foundation.stiffnesses
        tags = range(node, node + len(points.points))
        yield "*NODE\n"
        for tag, point in zip(tags, (points.points / units.length).tolist(), strict=True):
            yield f"{tag}, {', '.join(map(number, point))}\n"
        yield from _equations(points, tags, foundation.axes(points)[:, : len(stiffnesses)], mesh, frames)
        for axis, stiffness in enumerate(stiffnesses, 1):
            name = f"HPCINV_SPRINGS_{count}_{axis}"
            yield f"*ELEMENT, TYPE=SPRING1, ELSET={name}\n"
            yield from (f"{element + place}, {tag}\n" for place, tag in enumerate(tags))
            mean = stiffness * float(points.areas.mean()) / (units.force / units.length)
            yield f"*SPRING, ELSET={name}\n{axis}\n{number(mean)}\n"
            element += len(tags)
        if len(stiffnesses) == 1:
            yield "*BOUNDARY\n"
            yield from (f"{tag}, 2, 3\n" for tag in tags)
        node += len(tags)


def _equations(points: SpringPoints, tags: range, axes: Floats, mesh: MeshSource, frames: Frames) -> Iterator[str]:
    sizes = np.sqrt(points.areas / points.areas.mean())
    turns = frames.axes(len(mesh.points))[points.nodes]
    factors = np.einsum("q,qk,qkij,qdj->qdki", sizes, points.shapes, turns, axes)
    nodes = mesh.node_tags[points.nodes].tolist()
    for tag, own_nodes, directions in zip(tags, nodes, factors.tolist(), strict=True):
        for axis, by_node in enumerate(directions, 1):
            terms = [f"{tag}, {axis}, -1."]
            terms += [
                f"{node}, {component}, {number(factor)}"
                for node, parts in zip(own_nodes, by_node, strict=True)
                for component, factor in enumerate(parts, 1)
                if factor
            ]
            yield f"*EQUATION\n{len(terms)}\n"
            for start in range(0, len(terms), _TERMS_PER_LINE):
                yield f"{', '.join(terms[start : start + _TERMS_PER_LINE])}\n"
