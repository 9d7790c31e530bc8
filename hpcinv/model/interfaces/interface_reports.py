"""What a solution says about an interface, and its tractions from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem

from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.job.interfaces import Interface
from hpcinv.mesh.source import Floats
from hpcinv.model.contact_reports import ContactReport, FrictionReport, SlipHistory
from hpcinv.model.interfaces.friction import Friction, SlipBegin, Tractions
from hpcinv.model.interfaces.jump import Jump
from hpcinv.model.interfaces.kinds import Law, assumption
from hpcinv.model.interfaces.nodal_functions import NodalFunctions

OPEN, STICKS, SLIDES = 0.0, 1.0, 2.0
type Transfer = Callable[[fem.Function], fem.Function]


@dataclass(frozen=True)
class InterfaceReports:
    """Reports of one interface.

    Attributes:
        where: its place in the job.
        label: ending of the names of its fields.
        sign: of the kinematics.
        functions: functions with the numbers at its nodes.
        prefix: beginning of the names of its fields.
    """

    where: str
    label: str
    spec: Interface
    law: Law
    sign: int
    functions: NodalFunctions
    prefix: str = "interface"

    def made(
        self,
        jump: Jump,
        tractions: Floats,
        gaps: Floats,
        force: Floats,
        scales: Scales,
        *,
        tolerance: float,
        is_given: bool,
        friction: FrictionReport | None,
    ) -> ContactReport:
        """Return a report of scaled numbers; collective.

        Args:
            jump: where the forces act.
            tractions, gaps: of all functions, with components of kinds with vectors.
            force: on the first region of the job, (3,).
            tolerance: of gaps.
        """
        unit = scales.stress
        if self.law.has_vectors:
            vectors = tractions.reshape(-1, 3)
            sizes, gaps = np.linalg.norm(vectors, axis=1), np.linalg.norm(gaps.reshape(-1, 3), axis=1)
            pressures = np.einsum("ni,ni->n", vectors, jump.normals)
            parts = {f"traction_{axis}": -vectors[:, i] for i, axis in enumerate("xyz")}
        else:
            pressures, sizes = tractions, np.abs(tractions)
            parts = {"multiplier": tractions}
        touched = jump.areas > 0
        widest = np.abs(gaps) if self.law.pulls else -gaps
        fields = [self.functions.made(f"{self.prefix}_pressure{self.label}", pressures * unit, corners=True)]
        fields += [self.functions.made(f"{self.prefix}_{n}{self.label}", v * unit) for n, v in parts.items()]
        force = force * unit * scales.length**2
        shares = jump.areas / max(float(jump.areas.sum()), np.finfo(float).tiny)
        return ContactReport(
            where=self.where,
            region=self.spec.between[0],
            assumption=assumption(self.spec, self.sign),
            force=(float(force[0]), float(force[1]), float(force[2])),
            area=jump.area * float(shares[sizes > 0].sum()) * scales.length**2,
            penetration=float(widest[touched].max(initial=0.0)) * scales.length,
            distance=float(np.abs(gaps[sizes > 0.01 * sizes.max(initial=0.0)]).max(initial=0.0)) * scales.length,
            largest_pressure=float(sizes.max(initial=0.0)) * unit,
            tolerance=tolerance * scales.length,
            is_given=is_given,
            penalty=None,
            fields=tuple(fields),
            friction=friction,
        )

    def with_tractions(
        self, report: ContactReport, pressures: Floats, tangential: Floats, scales: Scales
    ) -> ContactReport:
        """Return a report with other pressures and tangential tractions (n, 3) of all functions, scaled."""
        pressure, multiplier = report.fields
        given = self.functions.made(multiplier.name, pressures * scales.stress)
        friction = report.friction
        if friction is not None:
            friction = replace(friction, tractions=self._components("friction", -tangential * scales.stress))
        return replace(report, fields=(pressure, given), friction=friction)

    def multipliers(self, report: ContactReport, scales: Scales, transfer: Transfer) -> Floats:
        """Return the scaled multipliers of a report, pressures or components of tractions; collective."""
        _, *components = report.fields
        values = [self.functions.values(transfer(component)) / scales.stress for component in components]
        return -np.stack(values, axis=1).ravel() if self.law.has_vectors else values[0]

    # Friction.

    def friction(
        self,
        friction: Friction,
        found: Tractions,
        pressures: Floats,
        jump: Jump,
        place_of: Callable[[int], Floats],
        scales: Scales,
        history: SlipHistory | None = None,
    ) -> FrictionReport:
        """Return a report of friction; collective.

        Args:
            jump: where the forces act.
            place_of: returns the place (m) of the node of a function.
            history: before the last load step.
        """
        sizes = np.linalg.norm(found.vectors, axis=1)
        slides = found.sliding & (pressures > 0)
        shares = jump.areas / max(float(jump.areas.sum()), np.finfo(float).tiny)
        state = np.where(pressures > 0, np.where(slides, SLIDES, STICKS), OPEN)
        excess = np.where(jump.areas > 0, sizes - self.spec.friction * pressures, -np.inf)
        worst = int(excess.argmax())
        place = place_of(worst)
        return FrictionReport(
            coefficient=self.spec.friction,
            sliding_area=jump.area * float(shares[slides].sum()) * scales.length**2,
            energy_lost=friction.energy(found, pressures) * scales.stress * scales.length**3,
            place=(float(place[0]), float(place[1]), float(place[2])),
            largest=float(sizes[worst]) * scales.stress,
            allowed=self.spec.friction * float(pressures[worst]) * scales.stress,
            tractions=self._components("friction", -found.vectors * scales.stress),
            slips=self._components("slip", found.slips * scales.length),
            state=self.functions.made(f"{self.prefix}_state{self.label}", state),
            history=history,
        )

    def _components(self, name: str, vectors: Floats) -> tuple[fem.Function, ...]:
        return tuple(
            self.functions.made(f"{self.prefix}_{name}_{axis}{self.label}", vectors[:, i])
            for i, axis in enumerate("xyz")
        )

    def history(
        self, begin: SlipBegin, displacement: fem.Function, penalties: tuple[float, float], scales: Scales
    ) -> SlipHistory:
        """Return the history of a solution with which a load step begins.

        Args:
            displacement: a new function (scaled) with its displacement, which is scaled to m.
            penalties: ``share`` and ``softness`` of `SlipHistory`.
        """
        displacement.x.array[:] *= scales.length
        numbers = {
            "load": begin.load,
            "energy_lost": begin.energy * scales.stress * scales.length**3,
            "shift": (begin.shift * scales.length).tolist(),
            "share": penalties[0],
            "softness": penalties[1],
        }
        slips = self._components("slip", begin.slips * scales.length)
        force = self.functions.made("force", begin.forces * scales.stress * scales.length**2)
        return SlipHistory(displacement, slips, force, numbers)

    def begin_of(self, history: SlipHistory, u: Floats, points: Floats, scales: Scales) -> SlipBegin:
        """Return the solution with which a load step begins, of a history; collective.

        Args:
            u: its owned unknowns (scaled); points: places of the nodes of the first surface's facets.
        """
        numbers = history.numbers
        slips = [self.functions.values(slip) / scales.length for slip in history.slips]
        return SlipBegin(
            numbers["load"],
            u,
            points,
            np.stack(slips, axis=1),
            self.functions.values(history.force) / (scales.stress * scales.length**2),
            numbers["energy_lost"] / (scales.stress * scales.length**3),
            np.array(numbers["shift"]) / scales.length,
        )

    def slipped(self, report: FrictionReport, scales: Scales, transfer: Transfer) -> tuple[Floats, Floats]:
        """Return the scaled tractions (n, 3) of a report as a `Friction` has them, and slips; collective."""
        tractions, slips = (
            np.stack([self.functions.values(transfer(part)) for part in parts], axis=1)
            for parts in (report.tractions, report.slips)
        )
        return -tractions / scales.stress, slips / scales.length
