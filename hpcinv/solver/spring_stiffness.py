"""Stiffness of springs against motions that strain nothing else."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System

_SMALL = 1e-7  # size of motions that are rigid to rounding errors


@contextmanager
def forces_of(system: System) -> Iterator[tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]]:
    """Context with two functions of a field (n, 3) at the nodes of the displacement; its end restores the state.

    The first returns the owned unknowns of the field, the second the forces on them in the unloaded state, per size
    of the field; both are collective.
    """
    unknowns = system.weak_form.unknowns
    kept_state, owned = system.state.x.array.copy(), len(system.rhs.array)

    def local_unknowns(field: Floats) -> Floats:
        values: Floats = np.zeros_like(kept_state)
        values[unknowns.displacement_dofs_of_nodes] = field
        return values

    def unknowns_of(field: Floats) -> Floats:
        return np.array(local_unknowns(field)[:owned])

    def forces(field: Floats) -> Floats:
        system.set_values(local_unknowns(_SMALL * field))
        return np.asarray(system.forces(0.0))

    try:
        unmoved = forces(np.zeros((len(unknowns.displacement_space.tabulate_dof_coordinates()), 3)))
        yield unknowns_of, lambda field: (forces(field) - unmoved) / _SMALL
    finally:
        system.set_values(kept_state)


def stiffness_of(system: System, count: int, field: Callable[[int], Floats], parts: Sequence[Floats]) -> list[Floats]:
    """Return the stiffness (k, k) of each of some parts, which share no node, against ``count`` motions; collective.

    Args:
        field: a motion by its number, at all nodes (n, 3) of the displacement.
        parts: the nodes (n,) of each part, as a mask.
    """
    with forces_of(system) as (unknowns_of, forces):
        moved = np.stack([forces(field(i)) for i in range(count)], axis=1)
        stiffnesses = []
        for part in parts:
            tests = np.stack([unknowns_of(field(i) * part[:, None]) for i in range(count)], axis=1)
            stiffness = np.asarray(system.comm.allreduce(tests.T @ moved))
            stiffnesses.append((stiffness + stiffness.T) / 2)
    return stiffnesses
