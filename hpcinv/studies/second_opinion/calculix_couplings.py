"""Remote loads in CalculiX and Abaqus: ``*COUPLING`` of a surface to a reference node, and the forces on this.

In CalculiX the rotation of a reference node is a vector, and moments do work on its components. A moment that keeps its
direction has other components there, unless it is along the axis of the rotation. In Abaqus it has the same ones.

Source: Dhondt, *CalculiX CrunchiX User's Manual*, ``*COUPLING``, ``*KINEMATIC``.
"""

from __future__ import annotations

from collections.abc import Iterator

from hpcinv.formats.inp import number
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.units import Units

MOMENT_NOTE = "the moment has other components, those on the rotation vector of CalculiX"


def coupling_lines(body: LoadedBody, first: int, units: Units) -> Iterator[str]:
    """Yield reference nodes and couplings.

    Args:
        first: number of the first node.
        units: of the deck.
    """
    for node, remote in enumerate(body.remotes, first):
        name = remote.group.name
        yield f"*NODE\n{node}, {', '.join(map(number, (remote.point / units.length).tolist()))}\n"
        yield f"*COUPLING, CONSTRAINT NAME=HPCINV_{node}, REF NODE={node}, SURFACE={name}\n*KINEMATIC\n1, 3\n"


def remote_forces(body: LoadedBody, program: str, first: int, units: Units) -> Iterator[str]:
    """Yield lines of ``*CLOAD`` on the reference nodes."""
    for node, remote in enumerate(body.remotes, first):
        moment = remote.moment if program == "abaqus" else remote.moment_by_components
        loads = [*(remote.force / units.force).tolist(), *(moment / (units.force * units.length)).tolist()]
        yield from (f"{node}, {component}, {number(load)}\n" for component, load in enumerate(loads, 1) if load)
