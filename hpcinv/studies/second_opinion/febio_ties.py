"""Slides in FEBio: linear constraints, which eliminate a displacement of a node (``FELinearConstraint``)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from hpcinv.job.vocabulary import AXES
from hpcinv.mesh.source import Floats, Ints
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.units import Units

_PARALLEL = 1e-6
"""Sine of the angle below which directions are the same; raised, nearly parallel planes hold one direction only."""
_NONE = 1e-12
"""Factor that is a rounding error; raised, shallow slopes are lost."""


@dataclass(frozen=True)
class Tie:
    """A displacement that follows from others at its node: ``offset + Σ factor u``, m, by axes (0, 1, 2)."""

    offset: float
    factors: Mapping[int, float]


class Ties:
    """Displacements of nodes (rows) that slide, by row and axis. FEBio has one constraint for each.

    What supports hold along axes is put in, since a constraint must have no displacement that another one eliminates.
    """

    def __init__(self, body: LoadedBody) -> None:
        held: dict[int, dict[int, float]] = {}
        for entry in body.held:
            for row, value in zip(entry.nodes.tolist(), entry.values.tolist(), strict=True):
                held.setdefault(row, {})[entry.axis] = value
        conditions: dict[int, list[tuple[Floats, float]]] = {}
        for slide in body.slides:
            for row, direction, value in zip(slide.nodes.tolist(), slide.directions, slide.values, strict=True):
                conditions.setdefault(row, []).append((direction, float(value)))
        self.by_place: dict[tuple[int, int], Tie] = {}
        for row, entries in conditions.items():
            directions, values = np.array([d for d, _ in entries]), np.array([v for _, v in entries])
            known = held.get(row, {})
            for axis, value in known.items():
                values -= directions[:, axis] * value
            free = [axis for axis in range(3) if axis not in known]
            for column, offset, factors in _eliminated(directions[:, free], values):
                self.by_place[row, free[column]] = Tie(offset, {free[c]: f for c, f in factors.items()})

    def constraints(self, tags: Ints, used: Ints, units: Units) -> Iterator[str]:
        """Yield conditions of displacements that follow from others.

        Args:
            tags: numbers of all nodes.
            used: nodes (rows) of the model.
        """
        there = set(used.tolist())
        for (row, axis), tie in self.by_place.items():
            if row in there and tie.factors:
                node = int(tags[row])
                children = [(node, other, factor) for other, factor in tie.factors.items()]
                yield constraint(node, axis, children, tie.offset / units.length)

    def determined(self) -> Iterator[tuple[int, Ints, Floats]]:
        """Yield axis, nodes (rows) and displacements, m, of those that are known, as of nodes in three planes."""
        for axis in range(3):
            known = {
                row: tie.offset for (row, other), tie in self.by_place.items() if other == axis and not tie.factors
            }
            if known:
                yield axis, np.array(list(known)), np.array(list(known.values()))


def constraint(node: int, axis: int, children: list[tuple[int, int, float]], offset: float = 0.0) -> str:
    """Return the condition that a displacement is a sum of others and a number.

    Args:
        children: node, axis and factor of each.
    """
    constant = f'<offset lc="1">{offset!r}</offset>' if offset else ""
    terms = "".join(
        f"<child_dof><node>{other}</node><dof>{AXES[a]}</dof><value>{factor!r}</value></child_dof>"
        for other, a, factor in children
    )
    return f'<bc type="linear constraint"><node>{node}</node><dof>{AXES[axis]}</dof>{constant}{terms}</bc>'


def _eliminated(directions: Floats, values: Floats) -> list[tuple[int, float, dict[int, float]]]:
    """Return column, number, and factors of the others, of each unknown that conditions (k, n) determine.

    Gauss and Jordan's elimination with the largest entry first. Conditions that follow from others are left out.
    """
    count = directions.shape[1]
    table = np.hstack([directions, values[:, None]])
    columns: list[int] = []
    for row in range(min(len(table), count)):
        sizes = np.abs(table[row:, :count])
        sizes[:, columns] = 0.0
        place, column = (int(i) for i in np.unravel_index(sizes.argmax(), sizes.shape))
        if sizes[place, column] <= _PARALLEL:
            break
        table[[row, row + place]] = table[[row + place, row]]
        table[row] /= table[row, column]
        others = np.arange(len(table)) != row
        table[others] -= np.outer(table[others, column], table[row])
        columns.append(column)
    free = [c for c in range(count) if c not in columns]
    return [
        (column, float(table[row, count]), {c: -float(table[row, c]) for c in free if abs(table[row, c]) > _NONE})
        for row, column in enumerate(columns)
    ]
