"""Loads that friction on a plane cannot hold."""

from __future__ import annotations

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.base.quantity.units import readable
from hpcinv.job.job import Job
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.physics.effects.contact import Contact
from hpcinv.physics.effects.obstacles import Plane

_CERTAIN = 1e-6
"""Share by which a load must exceed friction. Raised, fewer loads are named; lowered, rounding errors name some."""
_DEAD = 1e-9  # change of the resultant by another shape, relative to it, up to which it does not depend on the shape
_OTHER_SHAPE = 0.01 * np.array([[2.0, -1.0, 3.0], [1.0, -2.0, -1.0], [-3.0, 2.0, 1.0]])  # displacement gradient


def friction_limit(job: Job, system: System, load: float, scales: Scales) -> list[str]:
    """Return lines on whether friction on planes can hold a body that nothing else holds; collective.

    All tractions on parallel planes lie in one friction cone, and so does their sum. So it cannot balance a resultant
    of the other loads that is outside of the cone. No lines are returned for bodies that are held in other ways.

    Args:
        load: load factor of the resultant.
    """
    contacts = _only_contacts(job)
    if not contacts or system.weak_form.kinematics.sign < 0:
        return []
    planes = [contact.obstacle for contact in contacts if isinstance(contact.obstacle, Plane)]
    normals = np.array([np.array(plane.normal) / np.linalg.norm(plane.normal) for plane in planes])
    resultant = _dead_resultant(system, load)
    if len(planes) < len(contacts) or np.abs(normals - normals[0]).max() > _CERTAIN or resultant is None:
        text = "Whether friction can hold the body is not decided: normals or loads depend on its shape"
        return [text, "Hold it by a support, and compare the reaction with friction"]
    friction = max(contact.friction for contact in contacts)
    pressing = -float(resultant @ normals[0])
    along = float(np.linalg.norm(resultant + pressing * normals[0]))
    if along <= friction * max(pressing, 0.0) + _CERTAIN * float(np.linalg.norm(resultant)):
        return []
    unit = scales.stress * scales.length**2
    limit = f"{friction:g} × {readable(max(pressing, 0.0) * unit, 'N')}"
    return [
        f"Friction cannot hold the body: its load along the plane, {readable(along * unit, 'N')}, exceeds {limit}",
        f"Hold it by a support, or raise the friction above {along / pressing:.3g}"
        if pressing > 0
        else "Hold it by a support",
    ]


def _only_contacts(job: Job) -> list[Contact]:
    """Return the contacts with obstacles, if nothing else holds the body and at least one has friction."""
    contacts = [effect for effect in job.effects if isinstance(effect, Contact)]
    is_free = not job.supports and not job.interfaces and all(contact.is_paired for contact in contacts)
    return contacts if is_free and any(contact.friction for contact in contacts) else []


def _dead_resultant(system: System, load: float) -> Floats | None:
    """Return the resultant (3,), scaled, of all loads but contact; ``None`` if it depends on the shape."""
    unknowns, x = system.weak_form.unknowns, system.position()
    points, dofs, found = unknowns.owned_displacement_points(), unknowns.owned_displacement_dofs, list[Floats]()
    for gradient in (np.zeros((3, 3)), _OTHER_SHAPE):
        state = x.duplicate()
        state.set(0.0)
        state.array[dofs] = (points @ gradient.T).ravel()
        system.set_state(state)
        forces = system.forces(load)  # internal ones add up to nothing
        contact = np.zeros_like(forces)
        for pair in system.weak_form.contacts.pairs:
            pair.add_forces(contact)
        sums = (contact - forces)[dofs].reshape(-1, 3).sum(axis=0)
        found.append(system.comm.allreduce(sums, op=MPI.SUM))
        state.destroy()
    system.set_state(x)
    x.destroy()
    first, second = found
    return first if np.linalg.norm(second - first) <= _DEAD * np.linalg.norm(first) else None
