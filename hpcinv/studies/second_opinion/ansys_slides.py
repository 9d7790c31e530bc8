"""Constraint equations of Ansys (``CE``) for nodes that stay in planes.

The program eliminates the first displacement of an equation that nothing else holds.
Source: *Ansys Mechanical APDL Command Reference*, CE; *Modeling and Meshing Guide*, "Constraint equations".
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcinv.errors import OutputError
from hpcinv.formats.inp import number
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.studies.second_opinion.loaded_body import LoadedBody

_NONE = 1e-9
"""Component of a unit vector that is a rounding error; raised, shallow slopes are lost"""


def slide_lines(body: LoadedBody, mesh: MeshSource, nodes: Ints) -> Iterator[str]:
    """Yield an equation for each node (row) that slides, without what follows from other supports of the node.

    Args:
        nodes: of the deck.

    Raises:
        OutputError: nodes move along their normals.
    """
    known: dict[int, Floats] = {}  # directions along which a node is held, (k, 3)
    for held in body.held:
        for row in held.nodes.tolist():
            known[row] = np.vstack([known.get(row, np.zeros((0, 3))), np.eye(3)[held.axis]])
    axes = {row: np.abs(directions).max(axis=0) > 0 for row, directions in known.items()}
    is_there = set(nodes.tolist())
    for slide in body.slides:
        if np.abs(slide.values).max() > _NONE * np.ptp(body.rest.points, axis=0).max():
            text = (
                f"{slide.place}: nodes move along the normals, and constraint equations are written without constants"
            )
            raise OutputError(text, "Let the support slide in a plane, without 'surface'.")
        for row, direction in zip(slide.nodes.tolist(), slide.directions, strict=True):
            others = known.get(row, np.zeros((0, 3)))
            all_directions = np.vstack([others, direction])
            if row not in is_there or _rank(all_directions) == _rank(others):
                continue
            known[row] = all_directions
            yield _equation(int(mesh.node_tags[row]), direction, axes.get(row, np.zeros(3, dtype=bool)))


def _rank(directions: Floats) -> int:
    return int(np.linalg.matrix_rank(directions, tol=1e-6)) if len(directions) else 0


def _equation(tag: int, direction: Floats, is_held: Floats) -> str:
    """Return an equation whose first terms are of displacements that are free, the largest one first."""
    order = sorted(range(3), key=lambda axis: (bool(is_held[axis]), -abs(direction[axis])))
    terms = [f"{tag},U{'XYZ'[i]},{number(float(direction[i]))}" for i in order if abs(direction[i]) > _NONE]
    return f"CE,NEXT,0,{','.join(terms)}\n"
