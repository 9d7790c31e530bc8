"""Pressures, gaps and resultants of an interface at the present state, for intervals, derivatives and free parts."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.facets import RegionFacets
from hpcinv.model.interfaces.interface_forces import InterfaceForces
from hpcinv.model.interfaces.node_gaps import NodeGaps


class MeasuredInterface(InterfaceForces):
    """The forces of one interface, with what others read of them. Methods are collective."""

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the mesh."""
        comm: MPI.Intracomm = self._comm
        return comm

    @property
    def body_length(self) -> float:
        """Length of the body, scaled."""
        return self._body.length

    @property
    def surfaces(self) -> tuple[RegionFacets, ...]:
        """Surfaces of the mesh, in the order of the job; only the first one on a rigid obstacle."""
        return self._regions

    @property
    def frame(self) -> tuple[Floats, Floats]:
        """Places (n, 3), scaled, of the nodes of all functions in the given mesh, and mean normals (n, 3) there."""
        return self._node_places, self._force_jump.normals

    @property
    def given_normals(self) -> tuple[Floats, Floats]:
        """Normals of the given mesh (n, 3) where its surfaces face each other, and their places (scaled)."""
        facing = self._given.areas > 0
        return self._given.normals[facing], self._node_places[facing]

    def _place_of(self, number: int) -> Floats:
        """Return the place (m) of the node of a function in the given mesh, on all ranks."""
        first, name = self._first.at(self._body.given_nodes), self._names[number]
        found = [first.points[row, k] for row, k in np.argwhere(first.nodes == name)[:1]]
        return next(place for places in self._comm.allgather(found) for place in places)

    @property
    def assumes_pressure(self) -> bool:
        """True if an assumption determines the pressure."""
        return self._sign < 0 and not self._law.pulls

    @property
    def finds_at(self) -> Booleans:
        """Whether each function presses with a pressure that the solve finds."""
        return np.asarray((self._tractions()[1] > 0.5) & (self._penalties > 0))

    @property
    def pressing(self) -> Ints:
        """Numbers of the functions whose pressures may act on the given shape."""
        return np.flatnonzero((self._force_jump.areas > 0) & (self._touching > 0))

    @property
    def penalties(self) -> Floats:
        """Present penalties of all functions, scaled."""
        return self._penalties

    @property
    def multipliers(self) -> Floats:
        """All multipliers; pressures are the first."""
        return np.concatenate([self._q, *(friction.q.ravel() for friction in self._frictions)])

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

    def jumps(self, x: PETSc.Vec) -> Floats:
        """Return the jumps of a vector of the unknowns: gaps of unloaded bodies fall by them; collective."""
        return self._products(x)

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

    @property
    def multiplier_places(self) -> tuple[Ints, Ints]:
        """Function of each multiplier, and its number among the multipliers of the function."""
        widths = [3 if self._law.has_vectors else 1, *(3 for _ in self._frictions)]
        firsts = np.cumsum([0, *widths])
        functions = [np.repeat(np.arange(len(self._names)), width) for width in widths]
        slots = [np.tile(np.arange(w) + f, len(self._names)) for w, f in zip(widths, firsts, strict=False)]
        return np.concatenate(functions), np.concatenate(slots)

    def incidence(self) -> tuple[Ints, Ints]:
        """Return pairs (k, 2) of functions and nodes on which they depend, and the nodes' unknowns (n, 3); collective.

        Nodes are numbered from 0. All ranks have all of them.
        """
        found = np.unique(np.concatenate([self._force_jump.incidence(), self._gap_jump.incidence()]), axis=0)
        nodes, numbers = np.unique(found[:, 1:], axis=0, return_inverse=True)
        return np.column_stack([found[:, 0], numbers.ravel()]), nodes

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
