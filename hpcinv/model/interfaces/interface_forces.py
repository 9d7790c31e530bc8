"""Two surfaces of one mesh in an interface: their jumps, and the forces and stiffness of multipliers there.

At each function ``N_i`` of the first surface a gap ``g_i`` is measured (`Jump`), and a traction ``λ_i`` acts,

    R ← R - B_fᵀ λ,      λ = law(q - ε s g),      g = c + s B_g u,

where the rows of ``B_f`` are jumps on the loaded bodies. ``B_g`` are jumps where the gap is measured: there ``s = 1``,
or on unloaded bodies of inverse problems, whose places are ``x - u``, ``s = -1``. Jumps are constant during a solve.
They, and ``q ← λ`` (augmented Lagrangian, Uzawa), are renewed between solves until they have settled. The kinds are in
`hpcinv.model.interfaces.kinds`.

Source: Puso & Laursen (2004), doi:10.1016/j.cma.2004.06.001; Simo & Laursen (1992), doi:10.1016/0045-7949(92)90540-G.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.errors import MeshError
from hpcinv.job.interfaces import Interface
from hpcinv.mesh import Body
from hpcinv.mesh.regions import sides_of
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.accelerated import AcceleratedUpdates
from hpcinv.model.interfaces.entries import DIFFERENT_PATTERN
from hpcinv.model.interfaces.facets import Facets, RegionFacets, gathered
from hpcinv.model.interfaces.friction import frictions_of
from hpcinv.model.interfaces.given_pressures import given_pressures
from hpcinv.model.interfaces.interface_reports import InterfaceReports
from hpcinv.model.interfaces.jump import Jump
from hpcinv.model.interfaces.kinds import LAWS
from hpcinv.model.interfaces.nodal_functions import NodalFunctions
from hpcinv.model.interfaces.one_body import OneBody, one_body_of
from hpcinv.model.interfaces.opposite import Opposite, OppositeObstacle, OppositeSurface
from hpcinv.model.interfaces.pressed_segments import PressedSegments
from hpcinv.model.interfaces.refused_surfaces import refuse_surfaces
from hpcinv.model.interfaces.softening import Softening
from hpcinv.model.obstacle_contact import first_penalty
from hpcinv.model.obstacle_surface import ObstacleSurface
from hpcinv.model.spaces import Unknowns
from hpcinv.physics.effects.contact import Contact

_ROUNDED = 2.0**-26
"""Overlap up to which the pressure of contact is rounded, in lengths of the body. Lowered, nodes that barely touch go
in and out of contact; raised, bodies that only touch press on each other."""
_NEAR = 2.0**-8
"""Gap of a given deformed shape, in lengths of the body, up to which its bodies touch. Raised, they press on each other
where they are apart; lowered, segmented surfaces do not touch."""


class InterfaceForces:
    """The forces of one interface of a job in a weak form. Methods are collective.

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
        sides = sides_of(body.regions, spec.between)
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

    def reset(self) -> None:
        self._q: Floats = np.zeros(len(self._names) * (3 if self._law.has_vectors else 1)) + self._assumed
        self._before_update: Floats | None = None
        self._updates.forget()
        self._softening.reset()
        for friction in self._frictions:
            friction.reset()

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
        if self._obstacle is not None:
            self._obstacle.effect = effect
        names = ("rest_gap", "touches_within", "known", "pressure")
        self.spec = self.spec.model_copy(update={name: getattr(effect, name) for name in names})

    @property
    def _node_places(self) -> Floats:
        """Places (scaled) of the nodes of all functions in the given mesh, (n, 3)."""
        first = gathered(self._first.at(self._body.given_nodes / self._body.length_scale), self._comm)
        places = np.zeros((len(self._names), 3))
        known = np.isin(first.nodes, self._names)
        places[np.searchsorted(self._names, first.nodes[known])] = first.points[known]
        return places

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
            product.axpy(1.0, sheared, DIFFERENT_PATTERN)
            sheared.destroy()
        forces.destroy()
        gaps.destroy()
        if pressed is not None and self._sign > 0:
            turning = pressed.turning(tractions, self._first_points(), free)
            product.axpy(-1.0, turning, DIFFERENT_PATTERN)
            turning.destroy()
        return product
