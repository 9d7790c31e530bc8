"""Remote loads in FEBio: nodes of a rigid body, and a force and a moment on it.

The force acts at the centre of mass, which is the reference point; both keep their direction in space, as in a job
(``load_type`` LOAD). A moment works on spins, so that it has the numbers of the job.

Source: FEBio's ``FERigidNodeSet.cpp``, ``FERigidForce.cpp``, ``FERigidMaterial.cpp``.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.units import Units


def rigid_materials(body: LoadedBody, first: int, units: Units) -> Iterator[str]:
    """Yield the rigid bodies of remote loads.

    Args:
        first: number of the first material.
    """
    for number, remote in enumerate(body.remotes, first):
        centre = ",".join(map(repr, (remote.point / units.length).tolist()))
        yield (
            f'<material id="{number}" name="rigid-{escape(remote.group.name)}" type="rigid body"><density>1</density>'
            f"<center_of_mass>{centre}</center_of_mass></material>"
        )


def rigid_conditions(body: LoadedBody, first: int) -> Iterator[str]:
    """Yield the conditions that nodes move with their rigid body."""
    for number, remote in enumerate(body.remotes, first):
        yield f'<bc type="rigid" node_set="{escape(remote.group.name)}"><rb>{number}</rb></bc>'


def rigid_loads(body: LoadedBody, first: int, units: Units) -> Iterator[str]:
    """Yield the section of forces and moments on rigid bodies."""
    lines = list[str]()
    for number, remote in enumerate(body.remotes, first):
        moment = remote.moment / (units.force * units.length)
        kinds = (("force", "xyz", remote.force / units.force), ("moment", "uvw", moment))
        for kind, letters, vector in kinds:
            for letter, value in zip(letters, vector.tolist(), strict=True):
                if value:
                    lines.append(
                        f'<rigid_load type="rigid_{kind}"><rb>{number}</rb><dof>R{letter}</dof>'
                        f'<value lc="1">{value!r}</value><load_type>LOAD</load_type></rigid_load>'
                    )
    if lines:
        yield from ("<Rigid>", *lines, "</Rigid>")
