"""Contacts of a job: their pressures, which a solver updates between solves, and their resultants."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.model.contact_reports import ContactReport, SlipHistory
from hpcinv.model.outcome import Outcome
from hpcinv.model.spaces import Unknowns
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import Effect
from hpcinv.physics.effects.contact import Contact
from hpcinv.physics.kinematics.kinematics import Kinematics

MOST_UNBALANCED = 2.0**-20
"""Largest force on a part that contact alone holds that pressure does not balance, by the force of the contact, 1e-6.
Raised, loads that nothing balances move the part."""


class Passages:
    """The ways past all obstacles that a surface can pass through; methods are collective if there are any."""

    def __init__(self, passages: Sequence[Any], comm: MPI.Intracomm) -> None:
        self._passages, self._comm = tuple(passages), comm

    def __bool__(self) -> bool:
        return bool(self._passages)

    def depart(self) -> None:
        for passage in self._passages:
            passage.depart()

    def forget(self) -> None:
        for passage in self._passages:
            passage.forget()

    def has_passed(self) -> bool:
        """Return whether a way from where they began to the present state leads through an obstacle."""
        if not self._passages:
            return False
        have_passed = [passage.has_passed() for passage in self._passages]  # all of them, which gives each a start
        return bool(self._comm.allreduce(any(have_passed), op=MPI.LOR))

    def points(self) -> list[Floats]:
        """Return the present points, relative to each obstacle."""
        return [passage.points() for passage in self._passages]

    def share(self, start: Sequence[Floats]) -> float:
        """Return the share of the straight way from ``start`` to the present state that passes through no obstacle."""
        shares = [p.share(a, b) for p, a, b in zip(self._passages, start, self.points(), strict=True)]
        return float(self._comm.allreduce(min(shares, default=1.0), op=MPI.MIN))


class Contacts:
    """All contacts of a job; methods are collective.

    Args:
        resolve: path of a file of the job.
        degree: polynomial degree of the displacement.
        modulus: shear modulus of the body, scaled.
        pairs: interfaces of the job, and obstacles on which surfaces press as on interfaces; each takes the part of a
            contact.

    Attributes:
        pairs: as given.
        pins: of parts that contact alone holds.
        is_iterated: whether pressures or nearest points are found by iteration; has_obstacles: whether there are
            obstacles among these.
        depends_on_path: whether tractions depend on the load steps before.
    """

    def __init__(
        self,
        effects: tuple[tuple[str, tuple[Any, Any, Any]], ...],
        k: Kinematics,
        body: Body,
        resolve: Callable[[str], Path],
        degree: int,
        modulus: float,
        pairs: Sequence[Any] = (),
    ) -> None:
        self._obstacles = [
            on_demand("rigid obstacle")(f"contact_pressure{label}", where, *e, k, body, resolve, degree, modulus)
            for where, label, e in _labelled(effects)
            if not e[0].is_paired
        ]
        self.pairs = tuple(pairs)
        self.pins: tuple[Any, ...] = ()
        self._all: list[Any] = [*self._obstacles, *self.pairs]
        self._iterated = [contact for contact in self._all if contact.is_iterated]
        self.depends_on_path = any(pair.depends_on_path for pair in self.pairs)
        self.is_iterated = bool(self._iterated)
        self.has_obstacles = any(contact.has_obstacle for contact in self._iterated)

    @property
    def stiff(self) -> tuple[Any, ...]:
        """Interfaces and pins, which add forces and stiffness to the equations."""
        return self.pairs + self.pins

    def check_balance(self, scales: Scales) -> None:
        """Check in a solution that pressure balances the loads of parts that contact alone holds.

        Raises:
            MeshError: on all ranks, if it does not.
        """
        force = sum(pair.pressing_force for pair in self.pairs) if self.pins else 0.0
        for pin in self.pins:
            pin.check_balance(force, scales)

    def passages(self, unknowns: Unknowns) -> Passages:
        """Return the ways of the body past obstacles that a forward solve must not lead through."""
        passages = [contact.passage(unknowns) for contact in self._all]
        return Passages([passage for passage in passages if passage is not None], unknowns.mesh.comm)

    def update_parameters(self, effects: Sequence[Effect], modulus: float, scales: Scales) -> None:
        """Take the numbers of other effects, shear modulus and scales, of a job of the same reuse group."""
        contacts = [effect for effect in effects if isinstance(effect, Contact)]
        alone = (effect for effect in contacts if not effect.is_paired)
        for contact, effect in zip(self._obstacles, alone, strict=True):
            contact.update_parameters(effect, modulus)
        paired = (effect for effect in contacts if effect.is_paired)
        for pair in self.pairs:
            pair.update_modulus(modulus)
            if pair.has_obstacle:
                pair.update_obstacle(next(paired))
            pair.update_pressure(scales.stress)

    def reset(self) -> None:
        """Set the pressures of rigid obstacles to zero, and their penalties to the first ones."""
        for contact in self._all:
            contact.reset()

    def begin(self) -> None:
        """Begin a solve that finds pressures by iteration; given ones stay."""
        for contact in self._iterated:
            contact.reset()

    def restore(
        self,
        reports: Sequence[ContactReport],
        scales: Scales,
        transfer: Callable[[fem.Function], fem.Function] = lambda field: field,
    ) -> None:
        """Set the pressures and penalties of rigid obstacles to a solution's.

        Args:
            transfer: returns a function of the solution's mesh on the mesh of these contacts, if that is another one
                with the same cells.
        """
        for contact, report in zip(self._all, reports, strict=True):
            contact.restore(report, scales, transfer)

    def locate(self) -> None:
        """Find the nearest points of triangulated surfaces to the present state."""
        for contact in self._all:
            contact.locate()

    def begin_step(self, load: float) -> None:
        """Let slip of interfaces begin with the last solution below a load factor."""
        for pair in self.pairs:
            if pair.depends_on_path:
                pair.begin_step(load)

    def end_step(self, load: float) -> None:
        """Keep the present state, a solution at a load factor; slip of interfaces may begin there."""
        for pair in self.pairs:
            if pair.depends_on_path:
                pair.end_step(load)

    def histories(self, load: float, scales: Scales) -> tuple[SlipHistory | None, ...]:
        """Return the histories of slip of all contacts for a solve that has reached a load factor, or none."""
        if not self.depends_on_path:
            return ()
        return (None,) * len(self._obstacles) + tuple(pair.history(load, scales) for pair in self.pairs)

    def new_history(self, number: int, scales: Scales) -> SlipHistory:
        """Return a history of slip, with zeros, of the contact of a number."""
        history: SlipHistory = self._all[number].new_history(scales)
        return history

    def resume(self, histories: Sequence[SlipHistory | None], scales: Scales) -> None:
        """Let slip go on from the histories of all contacts, or from the unloaded body without one."""
        for contact, history in zip(self._all, histories or (None,) * len(self._all), strict=True):
            if history is not None:
                contact.resume(history, scales)

    def follow_failure(self, outcome: Outcome) -> bool:
        """Adapt penalties of interfaces after a solve that failed; return whether it is to be made again."""
        followed = [pair.follow_failure(outcome) for pair in self.pairs]  # all of them
        return any(followed)

    def update(self) -> bool:
        """Update the contacts that have not settled; return whether there are any.

        A settled contact stays as it is: its tolerance may be far above the tolerance of others, which would follow its
        last digits for ever.
        """
        updates = [apply for size, apply in [contact.change() for contact in self._iterated] if size > 1.0]
        for apply in updates:
            apply()
        return bool(updates)

    def halve_update(self) -> None:
        """Take back half of the last change of the pressures, after which no solution was found, and its penalties."""
        for contact in self._iterated:
            contact.halve_update()

    def check_start(self) -> None:
        """Check the present state, the unloaded body's, before the first solve.

        Raises:
            MeshError: on all ranks, if a rigid obstacle overlaps the undeformed body, or if no contact pressure acts on
                a known current body.
        """
        for contact in self._all:
            contact.check_start()

    def response(self) -> Floats:
        """Return the present force (3,), scaled, of contacts that the state of the body determines."""
        forces = [contact.totals()[:3] for contact in self._all if contact.depends_on_state]
        force: Floats = np.sum([np.zeros(3), *forces], axis=0)
        return force

    def rigid(self) -> list[Any]:
        """Return the rigid obstacles with a uniform penalty, in the order of the job."""
        return [contact for contact in self._all if contact.has_uniform_penalty]

    def reports(self, scales: Scales) -> tuple[ContactReport, ...]:
        """Return the results of the present state."""
        return tuple(contact.report(scales) for contact in self._all)


type _Named = tuple[str, tuple[Any, Any, Any]]


def _labelled(effects: Iterable[_Named]) -> list[tuple[str, str, tuple[Any, Any, Any]]]:
    """Return place, ending of the names of fields, and effect, load factor and quantities of each contact."""
    found = [(where, effect) for where, effect in effects if isinstance(effect[0], Contact)]
    labels = [""] if len(found) == 1 else [f"_{i}" for i in range(len(found))]
    return [(where, label, effect) for label, (where, effect) in zip(labels, found, strict=True)]


def paired_obstacles(
    effects: Iterable[_Named], body: Body, resolve: Callable[[str], Path]
) -> list[tuple[str, str, Any]]:
    """Return the obstacles that take the part of a surface of an interface, with places and endings of names."""
    return [
        (where, label, on_demand("surface of an obstacle")(*effect, body, resolve, body.mesh.comm))
        for where, label, effect in _labelled(effects)
        if effect[0].is_paired
    ]
