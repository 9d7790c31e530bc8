"""Augmentation: solves at the full load until the pressures of rigid obstacles, or their nearest points, settle."""

from collections.abc import Iterator
from dataclasses import replace

from hpcinv.model.outcome import Outcome
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import Solve

STRATEGY = "augmentation"
_MOST = 100  # updates


def augment(equilibrium: Equilibrium, tolerance: float) -> Iterator[Solve]:
    """Yield solves at the full load, each after an update of the contacts, until one would change them no more.

    The present state is a solution at the full load. The last solve is accepted if the contacts have settled.

    Source: Uzawa's method for contact, Simo & Laursen (1992), doi:10.1016/0045-7949(92)90540-G.
    """
    contacts = equilibrium.system.scene.contacts
    for _ in range(_MOST):
        equilibrium.system.set_load(1.0)
        if not contacts.update():
            return
        solve = equilibrium.solve(1.0, tolerance, begins_near=True)
        yield replace(solve, strategy=STRATEGY)
        if not solve.outcome.accepted:
            return
    yield Solve(1.0, Outcome.CONTACT_LIMIT, (), 0, strategy=STRATEGY)
