"""Two surfaces of one mesh in an interface: multipliers that a solver updates between solves, forces and stiffness.

At each function ``N_i`` of the first surface a gap ``g_i`` is measured (`Jump`), and a traction ``λ_i`` acts,

    R ← R - B_fᵀ λ,      λ = law(q - ε s g),      g = c + s B_g u,

where the rows of ``B_f`` are jumps on the loaded bodies. ``B_g`` are jumps where the gap is measured: there ``s = 1``,
or on unloaded bodies of inverse problems, whose places are ``x - u``, ``s = -1``. Jumps are constant during a solve.
They, and ``q ← λ`` (augmented Lagrangian, Uzawa), are renewed between solves until they have settled. The kinds are in
`hpcinv.model.interfaces.kinds`.

Source: Puso & Laursen (2004), doi:10.1016/j.cma.2004.06.001; Simo & Laursen (1992), doi:10.1016/0045-7949(92)90540-G.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.errors import MeshError
from hpcinv.job.interfaces import Interface, interface_of
from hpcinv.mesh import Body
from hpcinv.mesh.interface_sides import sides_of
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.contact_reports import ContactReport
from hpcinv.model.interfaces.accelerated import AcceleratedUpdates
from hpcinv.model.interfaces.facets import Facets, RegionFacets, gathered
from hpcinv.model.interfaces.friction import frictions_of
from hpcinv.model.interfaces.given_pressures import given_pressures
from hpcinv.model.interfaces.interface_reports import InterfaceReports
from hpcinv.model.interfaces.jump import Jump
from hpcinv.model.interfaces.kinds import LAWS
from hpcinv.model.interfaces.nodal_functions import NodalFunctions
from hpcinv.model.interfaces.node_gaps import NodeGaps
from hpcinv.model.interfaces.one_body import OneBody, one_body_of
from hpcinv.model.interfaces.opposite import Opposite, OppositeObstacle, OppositeSurface
from hpcinv.model.interfaces.pressed_segments import PressedSegments
from hpcinv.model.interfaces.refused_surfaces import (
    check_obstacle,
    check_overlap,
    refuse_surfaces,
)
from hpcinv.model.interfaces.softening import STIFF, Softening
from hpcinv.model.interfaces.surface_passage import SurfacePassage
from hpcinv.model.obstacle_contact import first_penalty
from hpcinv.model.obstacle_passage import Passage
from hpcinv.model.obstacle_surface import ObstacleSurface
from hpcinv.model.outcome import Outcome
from hpcinv.model.spaces import Unknowns
from hpcinv.physics.effects.contact import Contact

_DIFFERENT: Any = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN  # its stub has the wrong type
_ROUNDED = 2.0**-26
"""Overlap up to which the pressure of contact is rounded, in lengths of the body. Lowered, nodes that barely touch go
in and out of contact; raised, bodies that only touch press on each other."""
_NEAR = 2.0**-8
"""Gap of a given deformed shape, in lengths of the body, up to which its bodies touch. Raised, they press on each other
where they are apart; lowered, segmented surfaces do not touch."""


class SurfacePair:
    """One interface of a job in a weak form. Methods are collective.

    It takes the part of a contact among `Contacts`.

    Args:
        where: place in the job.
        label: ending of the names of its fields.
        sign: of the kinematics.
        modulus: typical shear modulus, scaled.
        stress: unit of scaled stresses (Pa).
        obstacle: rigid obstacle that takes the part of the second surface; none between two regions.

    Attributes:
        is_iterated: whether its tractions are found by iteration; else they are given.
        depends_on_path: whether its tractions depend on the load steps before.
        reports: makes reports of its solutions.
        version: number of the pattern of `stiffness`.
        has_obstacle: whether the second surface is a rigid obstacle's; depends_on_state: whether it exerts a force on
            the body as a whole that depends on the state.

    Raises:
        MeshError: on all ranks, if the surfaces do not face each other, or are apart.
    """

    has_uniform_penalty = False

    def __init__(
        self,
        where: str,
        label: str,
        spec: Interface,
        body: Body,
        unknowns: Unknowns,
        sign: int,
        modulus: float,
        stress: float,
        obstacle: ObstacleSurface | None = None,
    ) -> None:
        sides = sides_of(body, spec.between)
        are_doubled, spec = sides != spec.between, spec.model_copy(update={"between": sides})
        self._obstacle = obstacle
        self.has_obstacle, self.depends_on_state = obstacle is not None, obstacle is not None and sign > 0
        self.where, self.spec, self._law = where, spec, LAWS[spec.kind]
        self._body, self._unknowns, self._comm, self._sign = body, unknowns, body.mesh.comm, sign
        finds_pressure = spec.assumed is not None and spec.assumed.finds_pressure
        self.is_iterated, self.version = self._law.pulls or sign > 0 or finds_pressure, 0
        self._updates, self._softening = AcceleratedUpdates(), Softening()
        if unknowns.has_directors:
            raise MeshError(
                f"{where}: friction or a closure is not possible with a shell of more than 3,000 thicknesses",
                "Make it thicker or shorter, or leave 'friction' and 'closure' out.",
            )
        regions = [self._region(name) for name in spec.between[: 1 if obstacle is not None else 2]]
        # On the finer surface, nodes that supports hold leave tractions that hardly load the other body.
        sizes = [region.at(body.given_nodes).mean_radius(self._comm) for region in regions]
        self._is_swapped = self._law.pulls and sizes[0] < sizes[-1]
        self._regions = tuple(regions)
        first = self._first = regions[1] if self._is_swapped else regions[0]
        self._opposite = self._opposite_side(are_doubled=are_doubled)
        self._owned = unknowns.space.dofmap.index_map.size_local * unknowns.space.dofmap.index_map_bs
        corners = not self._law.has_vectors
        chosen = first.nodes[:, : first.kind.corner_count] if corners else first.nodes
        self._names: Ints = np.unique(np.concatenate(self._comm.allgather(np.unique(chosen))))
        functions = NodalFunctions(self._names, body, unknowns, corners=corners)
        prefix = "interface" if obstacle is None else "contact"
        self.reports = InterfaceReports(where, label, spec, self._law, sign, functions, prefix)
        turns = not self._opposite.fixes_normals
        self._frictions = frictions_of(spec, sign, self._names, self._owned, self._comm, turns=turns)
        self.depends_on_path = sign > 0 and bool(self._frictions)
        self.update_modulus(modulus)
        self._assumed: Floats | float = 0.0
        self.reset()
        self._given, pressed = self._searched(body.given_nodes / body.length_scale, None, loaded=sign < 0)
        if obstacle is None and self._one_body is None and not self._given.areas.any():
            facing = self._facets(body.given_nodes / body.length_scale)
            refuse_surfaces(where, spec, *facing, body.length_scale, self._comm)
        self._offsets: Floats = np.zeros(len(self._q))
        self._pressing: Booleans = np.zeros(0, dtype=np.bool_)
        self._force_jump = self._gap_jump = self._given
        self._place: tuple[Floats, Floats, Floats] | None = None
        self._set_jumps(self._given, self._given, pressed)
        self._set_frictions(
            body.given_nodes / body.length_scale, np.zeros((len(unknowns.displacement_dofs_of_nodes), 3))
        )
        self.update_pressure(stress)

    def _opposite_side(self, *, are_doubled: bool) -> Opposite:
        """Return what lies opposite to the first surface.

        Args:
            are_doubled: whether the nodes of both surfaces were doubled.
        """
        self._one_body: OneBody | None = None
        if self._obstacle is not None:
            return OppositeObstacle(self._obstacle, self._sign)
        one, other = self._regions
        if self._sign > 0 and not (self._law.pulls or are_doubled):
            self._one_body = one_body_of(self.where, self.spec, self._body, (one, other))
        second = one if self._is_swapped else other
        return OppositeSurface(second, self._comm, share_nodes=are_doubled, one_body=self._one_body)

    def _region(self, name: str) -> RegionFacets:
        facets = self._body.boundary_facets(name, "An interface is between two regions of the boundary.")
        return RegionFacets(self._body, facets, self._unknowns)

    def _facets(self, nodes: Floats, u: Floats | None = None) -> tuple[Facets, Facets]:
        return self._first.at(nodes, u), self._opposite.facets(nodes, u)

    def _jump(self, nodes: Floats, u: Floats) -> Jump:
        jump, pressed = self._searched(nodes, u, loaded=False)
        if pressed is not None:
            pressed.destroy()
        return jump

    def _searched(self, nodes: Floats, u: Floats | None, *, loaded: bool) -> tuple[Jump, PressedSegments | None]:
        """Return the jumps where the geometry nodes are (scaled), plus a displacement of the nodes of its space.

        Args:
            loaded: whether these are the loaded bodies.
        """
        first, second = self._facets(nodes, u)
        found = self._opposite.segments(first, second, self._law.reach, loaded=loaded)
        corners = not self._law.has_vectors
        jump = Jump(self._names, corners=corners, first=first, second=second, segments=found, comm=self._comm)
        if not self._law.is_renewed:
            return jump, None
        fixes = self._opposite.fixes_normals
        pressed = PressedSegments(self._names, first, second, found, self._owned, self._comm, fixes_normals=fixes)
        return jump, pressed

    # Algebra of the multipliers; all ranks have all of them.

    def _set_jumps(self, forces: Jump, gaps: Jump, pressed: PressedSegments | None) -> None:
        is_new = self.version == 0 or not (
            forces.has_pattern_of(self._force_jump) and gaps.has_pattern_of(self._gap_jump)
        )
        self.version += is_new
        self._force_jump, self._gap_jump = forces, gaps
        self.destroy()
        self._pressed = pressed
        if self._law.has_vectors:
            self._force_matrix = forces.vector_matrix(self._owned, means=False)
            self._gap_matrix = gaps.vector_matrix(self._owned, means=True)
        else:
            self._gap_matrix = gaps.normal_matrix(self._owned, means=True)
        areas = np.repeat(np.minimum(forces.areas, gaps.areas), 3 if self._law.has_vectors else 1)
        sizes = np.sqrt(np.where(areas > 0, areas, 1.0)) if self._soft_penalty is None else 1.0
        stiffness = self._stiffness if self._soft_penalty is None else self._soft_penalty
        self._first_penalties = np.where(areas > 0, stiffness / sizes, 0.0)
        self._penalties = self._softening.share * self._first_penalties
        self._left: PETSc.Vec = self._gap_matrix.createVecLeft()
        self._right: PETSc.Vec = self._gap_matrix.createVecRight()

    def destroy(self) -> None:
        """Free PETSc objects."""
        for name in ("_force_matrix", "_gap_matrix", "_left", "_right"):
            if name in vars(self):
                getattr(self, name).destroy()
        for friction in self._frictions:
            friction.destroy()
        if "_pressed" in vars(self) and self._pressed is not None:
            self._pressed.destroy()

    def _set_frictions(self, nodes: Floats, u: Floats) -> None:
        moved, at = (u, None) if self._sign > 0 else (None, -u)
        penalties = self._first_penalties if self.is_iterated else np.zeros_like(self._penalties)
        for friction in self._frictions:
            friction.set_jump(
                self._force_jump,
                penalties,
                self._first.at(nodes, moved),
                self._first.at(nodes, at),
                self._u,
                self._opposite.shift(),
            )

    @property
    def _u(self) -> Floats:
        """Present owned unknowns."""
        owned: Floats = self._unknowns.state.x.array[: self._owned]
        return owned

    def update_modulus(self, modulus: float) -> None:
        """Take another typical shear modulus (scaled)."""
        self._stiffness = self._law.penalty * modulus
        is_shell = self._body.source.thickness > 0
        self._soft_penalty = first_penalty(modulus, self._body) if is_shell else None

    def update_pressure(self, stress: float) -> None:
        """Take the pressure of the job, in another unit (Pa) of scaled stresses.

        Raises:
            MeshError: on all ranks, if the mesh has no such array, or the pressure is negative.
        """
        if self._sign > 0 or self.spec.assumed is None or self.spec.pressure is None:
            return
        places = self._node_places * self._body.length_scale
        where = f"{self.where}.pressure"
        pressures = given_pressures(self.spec.pressure, where, self._body, self.reports.functions, places)
        acts = (self._given.areas > 0) & (self._touching > 0)
        self._assumed = np.where(acts, pressures / stress, 0.0)
        self.reset()

    def update_obstacle(self, effect: Contact) -> None:
        """Take the numbers of another contact of the same reuse group."""
        assert self._obstacle is not None
        self._obstacle.effect = effect
        names = ("rest_gap", "touches_within", "known", "pressure")
        self.spec = self.spec.model_copy(update={name: getattr(effect, name) for name in names})

    @property
    def _tolerance(self) -> float:
        return self._law.settled[0] * self._body.length

    def _put_in_rows(self, values: Floats) -> None:
        start, end = self._left.getOwnershipRange()
        self._left.array[:] = values[start:end]

    def _products(self, x: PETSc.Vec) -> Floats:
        """Return the jumps of a vector of the unknowns where gaps are measured, in the mean around each node."""
        self._gap_matrix.mult(x, self._left)
        return np.concatenate(self._comm.allgather(np.array(self._left.array)))

    def _signed_gaps(self) -> Floats:
        """Return ``s g``."""
        return self._offsets + self._products(self._unknowns.state.x.petsc_vec)

    def _tractions(self) -> tuple[Floats, Floats]:
        """Return tractions, and their derivatives by trial values."""
        if not self.is_iterated:
            return self._q, np.zeros_like(self._q)
        width = self._penalties * _ROUNDED * self._body.length
        tractions, slopes = self._law(self._q - self._penalties * self._signed_gaps(), width)
        return tractions * self._touching, slopes * self._touching

    @property
    def _touching(self) -> Floats | float:
        """Return 1 where tractions may act, else 0: on a given shape, where its bodies touch each other."""
        if self._sign > 0 or self._law.pulls:
            return 1.0
        within = self.spec.touches_within
        reach = _NEAR * self._body.length if within is None else within / self._body.length_scale
        return (self._force_jump.gaps <= reach).astype(np.float64)

    def add_forces(self, forces: Floats) -> None:
        """Subtract the nodal forces of the tractions from residuals (owned unknowns at first)."""
        tractions = self._tractions()[0]
        self._add_transposed(-tractions, forces)
        for friction in self._frictions:
            friction.add_forces(friction.tractions(self._u, tractions).vectors, forces, -1.0)

    def add_products(self, x: PETSc.Vec, forces: Floats) -> None:
        """Add the stiffness times a vector of the unknowns to residuals (owned unknowns at first)."""
        tractions = self._tractions()[0]
        rates = self._slopes() * self._products(x)
        self._add_transposed(rates, forces)
        for friction in self._frictions:
            friction.add_products(friction.tractions(self._u, tractions), x.array_r[: self._owned], -rates, forces)
        if self._pressed is not None and self._sign > 0:
            turning = self._pressed.turning(tractions, self._first_points())
            turning.mult(x, self._right)
            forces[: self._owned] -= self._right.array
            turning.destroy()

    def _first_points(self) -> Floats:
        """Return the present places of the nodes of the first surface of the loaded body, (facets, nodes, 3)."""
        unknowns = self._unknowns
        u = unknowns.state.x.array[unknowns.displacement_dofs_of_nodes] if self._sign > 0 else None
        return self._first.at(self._body.mesh.geometry.x, u).points

    def _slopes(self) -> Floats:
        return self._penalties * self._tractions()[1]

    def _add_transposed(self, values: Floats, forces: Floats) -> None:
        if self._pressed is not None:
            self._pressed.forces(values, self._first_points(), self._right)
        else:
            self._put_in_rows(values)
            self._force_matrix.multTranspose(self._left, self._right)
        forces[: self._owned] += self._right.array

    def _nodal_forces(self, tractions: Floats) -> Floats:
        forces = np.zeros(self._owned)
        self._add_transposed(tractions, forces)
        for friction in self._frictions:
            friction.add_forces(friction.tractions(self._u, tractions).vectors, forces)
        return forces

    def stiffness(self, free: PETSc.Vec) -> PETSc.Mat:
        """Return a new matrix, the derivative of the forces without the rows and columns of unknowns that are not free.

        Args:
            free: 1 for free unknowns, 0 for others.
        """
        slopes, gaps, pressed, tractions = self._slopes(), self._gap_matrix.copy(), self._pressed, self._tractions()[0]
        forces = self._force_matrix.copy() if pressed is None else pressed.force_matrix(self._first_points())
        self._put_in_rows(slopes)
        forces.diagonalScale(None, free)
        gaps.diagonalScale(self._left, free)
        product = forces.transposeMatMult(gaps)
        gaps.scale(-1.0)
        for friction in self._frictions:
            sheared = friction.stiffness(friction.tractions(self._u, tractions), gaps, free)
            product.axpy(1.0, sheared, _DIFFERENT)
            sheared.destroy()
        forces.destroy()
        gaps.destroy()
        if pressed is not None and self._sign > 0:
            turning = pressed.turning(tractions, self._first_points(), free)
            product.axpy(-1.0, turning, _DIFFERENT)
            turning.destroy()
        return product

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

    def reset(self) -> None:
        self._q: Floats = np.zeros(len(self._names) * (3 if self._law.has_vectors else 1)) + self._assumed
        self._before_update: Floats | None = None
        self._updates.forget()
        self._softening.reset()
        for friction in self._frictions:
            friction.reset()

    def begin_step(self, load: float) -> None:
        """Let slip begin with the last solution below a load factor."""
        for friction in self._frictions:
            friction.begin(load)

    def end_step(self, load: float) -> None:
        """Keep the present solution; slip may begin there."""
        for friction in self._frictions:
            friction.end(load, self._u, self._first_points(), self._tractions()[0])

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
            self._before_update = self._multipliers
            self._set_multipliers(self._updates.after(self._multipliers, np.concatenate(differences), active))
            if self._softening.after_update(max(sizes)):
                self._penalties = self._softening.share * self._first_penalties
                self._updates.forget()
            stiffened = [f.after_update(distance) for f, distance in zip(self._frictions, slipped, strict=True)]
            if any(stiffened):
                self._updates.forget()

        return max(sizes), apply

    @property
    def _multipliers(self) -> Floats:
        """All multipliers; pressures are the first."""
        return np.concatenate([self._q, *(friction.q.ravel() for friction in self._frictions)])

    def _set_multipliers(self, values: Floats) -> None:
        count = len(self._q)
        self._q = values[:count] if self._law.pulls else np.maximum(values[:count], 0.0)
        for friction in self._frictions:
            friction.q = values[count:].reshape(-1, 3)

    def halve_update(self) -> None:
        self._updates.forget()
        if self._before_update is not None:
            self._set_multipliers((self._before_update + self._multipliers) / 2)

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
        frictions = [
            self.reports.friction(f, f.tractions(self._u, tractions), tractions, jump, self._place_of, scales)
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
    def _node_places(self) -> Floats:
        """Places (scaled) of the nodes of all functions in the given mesh, (n, 3)."""
        first = gathered(self._first.at(self._body.given_nodes / self._body.length_scale), self._comm)
        places = np.zeros((len(self._names), 3))
        known = np.isin(first.nodes, self._names)
        places[np.searchsorted(self._names, first.nodes[known])] = first.points[known]
        return places

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
