"""One interface among the contacts of a job: updates of its multipliers between solves, and its results.

Forces and stiffness of the multipliers are in `hpcinv.model.interfaces.interface_forces`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.job.interfaces import Interface, interface_of
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.contact_reports import ContactReport, SlipHistory
from hpcinv.model.interfaces.facets import RegionFacets
from hpcinv.model.interfaces.friction import SlipBegin
from hpcinv.model.interfaces.interface_forces import InterfaceForces
from hpcinv.model.interfaces.node_gaps import NodeGaps
from hpcinv.model.interfaces.refused_surfaces import check_obstacle, check_overlap
from hpcinv.model.interfaces.softening import STIFF
from hpcinv.model.interfaces.surface_passage import SurfacePassage
from hpcinv.model.obstacle_passage import Passage
from hpcinv.model.obstacle_surface import ObstacleSurface
from hpcinv.model.outcome import Outcome
from hpcinv.model.spaces import Unknowns


class SurfacePair(InterfaceForces):
    """One interface of a job, which takes the part of a contact among `Contacts`. Methods are collective."""

    # What a given shape leaves undetermined.

    @property
    def assumes_pressure(self) -> bool:
        """True if an assumption determines the pressure."""
        return self._sign < 0 and not self._law.pulls

    @property
    def finds_at(self) -> Booleans:
        """Whether each function presses with a pressure that the solve finds."""
        return np.asarray((self._tractions()[1] > 0.5) & (self._penalties > 0))

    @property
    def penalties(self) -> Floats:
        """Present penalties of all functions, scaled."""
        return self._penalties

    def jumps(self, x: PETSc.Vec) -> Floats:
        """Return the jumps of a vector of the unknowns: gaps of unloaded bodies fall by them; collective."""
        return self._products(x)

    @property
    def pressing(self) -> Ints:
        """Numbers of the functions whose pressures may act on the given shape."""
        return np.flatnonzero((self._force_jump.areas > 0) & (self._touching > 0))

    @property
    def areas(self) -> Floats:
        """Areas of all functions (scaled), whose products with pressures add up to the force."""
        return self._force_jump.areas

    @property
    def pressures(self) -> Floats:
        """Present pressures of all functions, scaled."""
        return self._tractions()[0]

    @property
    def tangential(self) -> Floats:
        """Present tangential tractions (n, 3) of all functions on the second surface, scaled; 0 without friction."""
        found = [friction.tractions(self._u, self.pressures).vectors for friction in self._frictions]
        return found[0] if found else np.zeros((len(self._names), 3))

    @property
    def frame(self) -> tuple[Floats, Floats]:
        """Places (n, 3), scaled, of the nodes of all functions in the given mesh, and mean normals (n, 3) there."""
        return self._node_places, self._force_jump.normals

    def forces_of(self, pressures: Floats, tangential: Floats) -> Floats:
        """Return the nodal forces (owned unknowns, scaled) of tractions of all functions, (n,) and (n, 3)."""
        forces = np.zeros(self._owned)
        self._add_transposed(pressures, forces)
        for friction in self._frictions:
            friction.add_forces(tangential, forces)
        return forces

    def node_gaps(self, *, loaded: bool) -> NodeGaps:
        """Return the gaps at the nodes of both surfaces, of the loaded or of the unloaded bodies; collective."""
        u = self._sign * self._unknowns.state.x.array[self._unknowns.displacement_dofs_of_nodes]
        facets = self._facets(self._body.mesh.geometry.x, u if loaded == (self._sign > 0) else None)
        return self._opposite.node_gaps(*facets, self._owned, self._comm, loaded=loaded)

    # The part of a contact.

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

    @property
    def multipliers(self) -> Floats:
        """All multipliers; pressures are the first."""
        return np.concatenate([self._q, *(friction.q.ravel() for friction in self._frictions)])

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

    def _place_of(self, number: int) -> Floats:
        """Return the place (m) of the node of a function in the given mesh, on all ranks."""
        first, name = self._first.at(self._body.given_nodes), self._names[number]
        found = [first.points[row, k] for row, k in np.argwhere(first.nodes == name)[:1]]
        return next(place for places in self._comm.allgather(found) for place in places)

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

    # Derivatives where multipliers have settled.

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the mesh."""
        comm: MPI.Intracomm = self._comm
        return comm

    @property
    def body_length(self) -> float:
        """Length of the body, scaled."""
        return self._body.length

    def incidence(self) -> tuple[Ints, Ints]:
        """Return pairs (k, 2) of functions and nodes on which they depend, and the nodes' unknowns (n, 3); collective.

        Nodes are numbered from 0. All ranks have all of them.
        """
        found = np.unique(np.concatenate([self._force_jump.incidence(), self._gap_jump.incidence()]), axis=0)
        nodes, numbers = np.unique(found[:, 1:], axis=0, return_inverse=True)
        return np.column_stack([found[:, 0], numbers.ravel()]), nodes

    @property
    def multiplier_places(self) -> tuple[Ints, Ints]:
        """Function of each multiplier, and its number among the multipliers of the function."""
        widths = [3 if self._law.has_vectors else 1, *(3 for _ in self._frictions)]
        firsts = np.cumsum([0, *widths])
        functions = [np.repeat(np.arange(len(self._names)), width) for width in widths]
        slots = [np.tile(np.arange(w) + f, len(self._names)) for w, f in zip(widths, firsts, strict=False)]
        return np.concatenate(functions), np.concatenate(slots)

    def settling(self) -> tuple[Floats, Floats]:
        """Return residuals of the owned unknowns, and by how much gaps and slips miss what multipliers ask for."""
        forces, tractions = np.zeros(self._owned), self._tractions()[0]
        self.add_forces(forces)
        found, penalties = [tractions], [self._penalties]
        for friction in self._frictions:
            found.append(friction.tractions(self._u, tractions).vectors.ravel())
            penalties.append(np.repeat(friction.penalties, 3))
        all_penalties, given = np.concatenate(penalties), self.multipliers
        has_penalty = all_penalties > 0
        missing = (np.concatenate(found) - given) / np.where(has_penalty, all_penalties, 1.0)
        return forces, np.where(has_penalty, missing, -given)

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

    @property
    def surfaces(self) -> tuple[RegionFacets, ...]:
        """Surfaces of the mesh, in the order of the job; only the first one on a rigid obstacle."""
        return self._regions

    @property
    def given_normals(self) -> tuple[Floats, Floats]:
        """Normals of the given mesh (n, 3) where its surfaces face each other, and their places (scaled)."""
        facing = self._given.areas > 0
        return self._given.normals[facing], self._node_places[facing]

    @property
    def pressing_force(self) -> float:
        """Sum of the forces (scaled) by which the surfaces press or pull on each other, whatever their direction."""
        tractions = np.abs(self._tractions()[0]).reshape(len(self._names), -1).max(axis=1)
        return float(tractions @ self._force_jump.areas)

    def totals(self) -> Floats:
        """Return the present force and area in contact (4,), scaled."""
        tractions = self._tractions()[0]
        return np.append(self._total_force(tractions), self._force_jump.areas[tractions > 0].sum())

    def _total_force(self, tractions: Floats) -> Floats:
        """Return the force (3,) on the first region of the job, or on the first sides of one surface, scaled."""
        if self.spec.between[0] == self.spec.between[1] and self._pressed is not None:
            sheared = [friction.tractions(self._u, tractions).vectors for friction in self._frictions]
            shear: Floats = sum((self.areas @ vectors for vectors in sheared), np.zeros(3))
            return self._pressed.resultant(tractions, self._first_points()) - shear
        local = np.unique(self._first.local_nodes)
        local = local[local < self._unknowns.displacement_space.dofmap.index_map.size_local]
        dofs = self._unknowns.displacement_dofs_of_nodes[local]
        total: Floats = self._comm.allreduce(self._nodal_forces(tractions)[dofs].sum(axis=0), op=MPI.SUM)
        return -total if self._is_swapped else total


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
