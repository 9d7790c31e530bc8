"""One interface among the contacts of a job: updates of its multipliers between solves and load steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.job.interfaces import Interface, interface_of
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.model.contact_reports import ContactReport, SlipHistory
from hpcinv.model.interfaces.friction import SlipBegin
from hpcinv.model.interfaces.measured_interface import MeasuredInterface
from hpcinv.model.interfaces.refused_surfaces import check_obstacle, check_overlap
from hpcinv.model.interfaces.softening import STIFF
from hpcinv.model.interfaces.surface_passage import SurfacePassage
from hpcinv.model.obstacle_passage import Passage
from hpcinv.model.obstacle_surface import ObstacleSurface
from hpcinv.model.outcome import Outcome
from hpcinv.model.spaces import Unknowns


class SurfacePair(MeasuredInterface):
    """One interface of a job, which takes the part of a contact among `Contacts`. Methods are collective."""

    def passage(self, unknowns: Unknowns) -> SurfacePassage | Passage | None:
        """Return the ways of bodies in contact that a forward solve must not lead through each other."""
        if self._obstacle is not None:
            return self._obstacle.passage(unknowns) if self._sign > 0 else None
        is_followed = self._sign > 0 and not self._law.pulls
        first, second = self._regions
        return SurfacePassage((first, second), self._body, unknowns, self._one_body) if is_followed else None

    def begin_step(self, load: float) -> None:
        """Let slip begin with the last solution below a load factor."""
        for friction in self._frictions:
            friction.begin(load)

    def end_step(self, load: float) -> None:
        """Keep the present solution; slip may begin there."""
        for friction in self._frictions:
            friction.end(load, self._u, self._first_points(), self._tractions()[0])

    def history(self, load: float, scales: Scales) -> SlipHistory | None:
        """Return the history of slip from which a solve goes on that has reached a load factor.

        It is ``None`` without friction, and where slip begins with the unloaded bodies.
        """
        for friction in self._frictions if self.depends_on_path else ():
            begin = friction.begin_before(load)
            return None if begin is None else self._history(begin, friction.softness_of_steps, scales)
        return None

    def new_history(self, scales: Scales) -> SlipHistory:
        """Return a history of slip whose functions are zero."""
        count = len(self._names)
        zero = SlipBegin(0.0, np.zeros(self._owned), None, np.zeros((count, 3)), np.zeros(count), 0.0, np.zeros(3))
        return self._history(zero, 1.0, scales)

    def _history(self, begin: SlipBegin, softness: float, scales: Scales) -> SlipHistory:
        unknowns = self._unknowns
        displacement, state = fem.Function(unknowns.displacement_space), fem.Function(unknowns.space)
        state.x.array[: self._owned] = begin.u
        state.x.scatter_forward()
        displacement.x.array[:] = state.x.array[unknowns.displacement_dofs_of_nodes].ravel()
        return self.reports.history(begin, displacement, (self._softening.share, softness), scales)

    def resume(self, history: SlipHistory, scales: Scales) -> None:
        """Let slip and penalties go on from a history, of a solve that begins."""
        nodes = self._unknowns.displacement_dofs_of_nodes
        u = history.displacement.x.array.reshape(-1, 3) / scales.length
        state = np.zeros(len(self._unknowns.state.x.array))
        state[nodes] = u
        points = self._first.at(self._body.mesh.geometry.x, u).points
        begin = self.reports.begin_of(history, state[: self._owned], points, scales)
        self._softening.share = history.numbers["share"]
        self._penalties = self._softening.share * self._first_penalties
        for friction in self._frictions:
            friction.resume(begin, history.numbers["softness"])

    def locate(self, *, measures: bool = False) -> None:
        """Renew the jumps at the present state, unless they are constant, or it has not changed since.

        Args:
            measures: whether gaps are needed of bodies with given pressures, too.
        """
        if not self._law.is_renewed:
            return
        unknowns, x = self._unknowns, self._body.mesh.geometry.x
        u = unknowns.state.x.array[unknowns.displacement_dofs_of_nodes]
        here = x, u, self._opposite.shift()
        same = map(np.array_equal, self._place, here) if self._place is not None else (False, False, False)
        is_mesh_same, is_displacement_same, is_shift_same = (self._comm.allreduce(p, op=MPI.LAND) for p in same)
        is_state_same = is_displacement_same and is_shift_same
        if is_mesh_same and (is_state_same or not (self.is_iterated or measures)):
            return
        self._place = x.copy(), u.copy(), here[2].copy()
        if self._sign < 0 and is_mesh_same:  # on a given shape forces are constant
            current, pressed, self._pressed = self._force_jump, self._pressed, None
        else:
            current, pressed = self._searched(x, u if self._sign > 0 else None, loaded=True)
        self._set_jumps(current, self._jump(x, -u) if self._sign < 0 else current, pressed)
        self._set_frictions(x, u)
        gaps = self._gap_jump.gaps - self._wanted_gaps
        measured = np.where(self._gap_jump.areas > 0, gaps, 0.0)
        self._offsets = self._sign * measured - self._products(unknowns.state.x.petsc_vec)

    @property
    def _wanted_gaps(self) -> Floats | float:
        """Gaps (scaled) of surfaces that neither press on each other nor pull."""
        if self._law.pulls:
            return self._given.gaps
        rest_gap = self.spec.rest_gap if self._sign < 0 else None
        return 0.0 if rest_gap is None else rest_gap / self._body.length_scale

    def follow_failure(self, outcome: Outcome) -> bool:
        """Adapt the penalties of contact after a solve that failed; tractions of the present state stay.

        Returns:
            Whether the solve is to be made again: friction gives way more from now on, and did not before.
        """
        if not self._law.pulls and self._sign > 0 and self._softening.after_failure(outcome):
            self._soften()
        gives_way = self.is_iterated and outcome in STIFF
        return gives_way and any(friction.soften() for friction in self._frictions)

    def _soften(self) -> None:
        self.locate()
        tractions, gaps = self._tractions()[0], self._signed_gaps()
        self._penalties = self._softening.share * self._first_penalties
        self._q = np.where(tractions > 0, np.maximum(tractions + self._penalties * gaps, 0.0), 0.0)
        self._updates.forget()

    def change(self) -> tuple[float, Callable[[], None]]:
        """Return the change by an update, over the largest at which it has settled, and a function that makes it.

        The jumps are renewed in any case.
        """
        (after, slopes), gaps = self._tractions(), self._signed_gaps()
        forces, active = self._nodal_forces(after), slopes > 0
        differences = [after - self._q]
        acts = self._penalties > 0
        sizes = [float((np.abs(differences[0][acts]) / self._penalties[acts]).max(initial=0.0)) / self._tolerance]
        slipped = list[float]()
        for friction in self._frictions:
            found = friction.tractions(self._u, after)
            differences.append((found.vectors - friction.q).ravel())
            active = np.append(active, found.sliding)
            slipped.append(friction.distance(found))
        sizes += [distance / self._tolerance for distance in slipped]
        if self._law.is_renewed:
            self.locate()
            moved = np.where(slopes > 0, np.abs(self._signed_gaps() - gaps), 0.0)
            sizes.append(float(moved.max(initial=0.0)) / self._tolerance)
            turned = np.abs(self._nodal_forces(after) - forces).max(initial=0.0), np.abs(forces).max(initial=0.0)
            difference, largest = (self._comm.allreduce(float(number), op=MPI.MAX) for number in turned)
            sizes.append(difference / (self._law.settled[1] * largest) if largest else 0.0)

        def apply() -> None:
            self._before_update, is_same = self.multipliers, self._updates.have(active)
            self.put_multipliers(self._updates.after(self.multipliers, np.concatenate(differences), active))
            if self._softening.after_update(max(sizes)):
                self._penalties = self._softening.share * self._first_penalties
                self._updates.forget()
            followed = zip(self._frictions, slipped, strict=True)
            stiffened = [friction.after_update(distance, is_same=is_same) for friction, distance in followed]
            if any(stiffened):
                self._updates.forget()

        return max(sizes), apply

    def put_multipliers(self, values: Floats) -> None:
        """Take other multipliers; pressures of contact do not pull."""
        count = len(self._q)
        self._q = values[:count] if self._law.pulls else np.maximum(values[:count], 0.0)
        for friction in self._frictions:
            friction.q = values[count:].reshape(-1, 3)

    def halve_update(self) -> None:
        self._updates.forget()
        for friction in self._frictions:
            friction.soften_updates()
        if self._before_update is not None:
            self.put_multipliers((self._before_update + self.multipliers) / 2)

    def check_start(self) -> None:
        """Check the present state, the unloaded body's, before the first solve.

        Raises:
            MeshError: on all ranks, if bodies in contact overlap.
        """
        if self._obstacle is not None and self._sign > 0:
            check_obstacle(self.where, self.spec.between[0], self._given.gaps, self._body, self._place_of)
        elif not self._law.pulls and self._sign > 0:
            check_overlap(self.where, self.spec, self._given.gaps, self._body, self._place_of)

    def restore(self, report: ContactReport, scales: Scales, transfer: Callable[[fem.Function], fem.Function]) -> None:
        """Set the multipliers to a solution's, and slip to the solution's in the state that is put next."""
        self._q = self.reports.multipliers(report, scales, transfer)
        if report.friction is not None:
            slipped = self.reports.slipped(report.friction, scales, transfer)
            for friction in self._frictions:
                friction.restore(*slipped)
            self._place = None
        self._updates.forget()

    def report(self, scales: Scales) -> ContactReport:
        """Return the results of the present state."""
        if not self.is_iterated:
            self.locate(measures=True)  # no update has measured the gaps there
        jump, tractions = self._force_jump, self._tractions()[0]
        history = self.history(1.0, scales)
        frictions = [
            self.reports.friction(f, f.tractions(self._u, tractions), tractions, jump, self._place_of, scales, history)
            for f in self._frictions
        ]
        return self.reports.made(
            jump,
            tractions,
            self._signed_gaps() * self._sign,
            self._total_force(tractions),
            scales,
            tolerance=self._tolerance,
            is_given=not self.is_iterated,
            friction=frictions[0] if frictions else None,
        )

    def scale_penalties(self, factor: float) -> None:
        """Take other penalties; tractions of a state that has settled do not depend on them."""
        self._softening.share *= factor
        self._penalties = self._softening.share * self._first_penalties
        for friction in self._frictions:
            friction.scale_penalties(factor)

    def begin_unloaded(self) -> None:
        """Let slip begin with the unloaded bodies; multipliers stay."""
        for friction in self._frictions:
            friction.begin_unloaded()


def pairs_of(
    interfaces: Sequence[Interface],
    obstacles: Sequence[tuple[str, str, ObstacleSurface]],
    body: Body,
    unknowns: Unknowns,
    sign: int,
    units: tuple[float, float],
) -> list[SurfacePair]:
    """Return the interfaces of a job, and its contacts with obstacles that take the part of a surface; collective.

    Args:
        obstacles: place in the job and ending of the names of fields, by obstacle.
        sign: of the kinematics.
        units: typical shear modulus (scaled), and unit of scaled stresses (Pa).
    """
    labels = [""] if len(interfaces) == 1 else [f"_{i}" for i in range(len(interfaces))]
    pairs = [
        SurfacePair(f"interfaces[{i}]", label, spec, body, unknowns, sign, *units)
        for i, (label, spec) in enumerate(zip(labels, interfaces, strict=True))
    ]
    for where, label, obstacle in obstacles:
        spec = interface_of(obstacle.effect)
        pairs.append(SurfacePair(where, label, spec, body, unknowns, sign, *units, obstacle))
    return pairs
