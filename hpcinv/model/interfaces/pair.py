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
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.errors import MeshError
from hpcinv.job.interfaces import Interface
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.contacts import ContactReport
from hpcinv.model.interfaces.facets import Facets, RegionFacets, gathered
from hpcinv.model.interfaces.jump import Jump
from hpcinv.model.interfaces.kinds import LAWS, assumption
from hpcinv.model.interfaces.nodal_functions import NodalFunctions
from hpcinv.model.interfaces.node_gaps import NodeGaps
from hpcinv.model.interfaces.pressed_segments import PressedSegments
from hpcinv.model.interfaces.segments import segments
from hpcinv.model.spaces import Unknowns

_DIFFERENT: Any = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN  # its stub has the wrong type
_OVERLAP = 2.0**-6
"""Overlap of unloaded bodies in contact that is refused, in lengths of the body."""
_ROUNDED = 2.0**-26
"""Overlap up to which the pressure of contact is rounded, in lengths of the body. Lowered, nodes that barely touch go
in and out of contact; raised, bodies that only touch press on each other."""
_NEAR = 2.0**-8
"""Gap of a given deformed shape, in lengths of the body, up to which its bodies touch. Raised, they press on each other
where they are apart; lowered, segmented surfaces do not touch."""
_MEMORY = 12
"""Updates whose differences accelerate the next one: nodes that supports hold leave multipliers that hardly move a gap,
which would settle by a tenth in each update. Raised, rounding errors of small differences are added."""


class SurfacePair:
    """One interface of a job in a weak form. Methods are collective.

    It takes the part of a contact among `Contacts`.

    Args:
        where: place in the job.
        label: ending of the names of its fields.
        sign: of the kinematics.
        modulus: typical shear modulus, scaled.

    Attributes:
        is_iterated: whether its tractions are found by iteration; else they are given.
        version: number of the pattern of `stiffness`.

    Raises:
        MeshError: on all ranks, if the surfaces do not face each other, or are apart.
    """

    depends_on_state = False
    """False: it exerts no force on the body as a whole."""
    has_uniform_penalty = False

    def __init__(
        self, where: str, label: str, spec: Interface, body: Body, unknowns: Unknowns, sign: int, modulus: float
    ) -> None:
        self.where, self.spec, self._label, self._law = where, spec, label, LAWS[spec.kind]
        self._body, self._unknowns, self._comm, self._sign = body, unknowns, body.mesh.comm, sign
        self.is_iterated, self.version = self._law.pulls or sign > 0 or spec.assumes_gap, 0
        first, second = (self._region(name) for name in spec.between)
        self._is_swapped = self._law.pulls and self._size(first) < self._size(second)
        if self._is_swapped:
            first, second = second, first
        self._first, self._second = first, second
        self._owned = unknowns.space.dofmap.index_map.size_local * unknowns.space.dofmap.index_map_bs
        corners = not self._law.has_vectors
        chosen = first.nodes[:, : first.kind.corner_count] if corners else first.nodes
        self._names: Ints = np.unique(np.concatenate(self._comm.allgather(np.unique(chosen))))
        self._functions = NodalFunctions(self._names, body, unknowns, corners=corners)
        self.update_modulus(modulus)
        self.reset()
        self._given, pressed = self._searched(body.given_nodes / body.length_scale, None)
        if not self._given.areas.any():
            self._refuse(*self._facets(body.given_nodes / body.length_scale))
        self._offsets: Floats = np.zeros(len(self._q))
        self._pressing: Booleans = np.zeros(0, dtype=np.bool_)
        self._force_jump = self._gap_jump = self._given
        self._place: tuple[Floats, Floats] | None = None
        self._set_jumps(self._given, self._given, pressed)

    def _region(self, name: str) -> RegionFacets:
        facets = self._body.boundary_facets(name, "An interface is between two regions of the boundary.")
        return RegionFacets(self._body, facets, self._unknowns)

    def _size(self, region: RegionFacets) -> float:
        """Return the mean radius of the facets.

        Bilateral kinds have their tractions on the coarser surface: on a finer one, nodes that supports hold leave
        tractions that hardly load the other body, and are not determined.
        """
        radii = region.at(self._body.given_nodes).radii
        total, count = self._comm.allreduce(float(radii.sum())), self._comm.allreduce(len(radii))
        size: float = round(total / max(count, 1), 12)
        return size

    def _facets(self, nodes: Floats, u: Floats | None = None) -> tuple[Facets, Facets]:
        return self._first.at(nodes, u), gathered(self._second.at(nodes, u), self._comm)

    def _jump(self, nodes: Floats, u: Floats) -> Jump:
        jump, pressed = self._searched(nodes, u)
        if pressed is not None:
            pressed.destroy()
        return jump

    def _searched(self, nodes: Floats, u: Floats | None) -> tuple[Jump, PressedSegments | None]:
        """Return the jumps where the geometry nodes are (scaled), plus a displacement of the nodes of its space."""
        first, second = self._facets(nodes, u)
        found = segments(first, second, self._law.reach * float(second.radii.max(initial=0.0)))
        corners = not self._law.has_vectors
        jump = Jump(self._names, corners=corners, first=first, second=second, segments=found, comm=self._comm)
        if not self._law.is_renewed:
            return jump, None
        return jump, PressedSegments(self._names, first, second, found, self._owned, self._comm)

    def _refuse(self, first: Facets, second: Facets) -> None:
        """Raise an error about surfaces that are not near each other."""
        (a, b), found = self.spec.between, segments(first, second, np.inf)
        nearest = found.gaps[np.abs(found.gaps).argmin()] if len(found.gaps) else np.inf
        gaps = np.array(self._comm.allgather(float(nearest)))
        gap = float(gaps[np.abs(gaps).argmin()] * self._body.length_scale)
        if not np.isfinite(gap):
            raise MeshError(
                f"{self.where}.between: '{a}' and '{b}' do not face each other",
                "Name two surfaces whose outer normals point to each other.",
            )
        what = "apart" if gap > 0 else "into each other"
        raise MeshError(
            f"{self.where}.between: '{a}' and '{b}' are {abs(gap):.3g} m {what}: they cannot be {self.spec.kind}",
            "Move the bodies together, or mesh them up to a common surface.",
        )

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
        self._penalties = np.where(areas > 0, self._stiffness / np.sqrt(np.where(areas > 0, areas, 1.0)), 0.0)
        self._left: PETSc.Vec = self._gap_matrix.createVecLeft()
        self._right: PETSc.Vec = self._gap_matrix.createVecRight()

    def destroy(self) -> None:
        """Free PETSc objects."""
        for name in ("_force_matrix", "_gap_matrix", "_left", "_right"):
            if name in vars(self):
                getattr(self, name).destroy()
        if "_pressed" in vars(self) and self._pressed is not None:
            self._pressed.destroy()

    def update_modulus(self, modulus: float) -> None:
        """Take another typical shear modulus (scaled)."""
        self._stiffness = self._law.penalty * modulus

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
        self._add_transposed(-self._tractions()[0], forces)

    def add_products(self, x: PETSc.Vec, forces: Floats) -> None:
        """Add the stiffness times a vector of the unknowns to residuals (owned unknowns at first)."""
        self._add_transposed(self._slopes() * self._products(x), forces)
        if self._pressed is not None and self._sign > 0:
            turning = self._pressed.turning(self._tractions()[0], self._first_points())
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
        return forces

    def stiffness(self, free: PETSc.Vec) -> PETSc.Mat:
        """Return a new matrix, the derivative of the forces without the rows and columns of unknowns that are not free.

        Args:
            free: 1 for free unknowns, 0 for others.
        """
        slopes, gaps, pressed = self._slopes(), self._gap_matrix.copy(), self._pressed
        forces = self._force_matrix.copy() if pressed is None else pressed.force_matrix(self._first_points())
        self._put_in_rows(slopes)
        forces.diagonalScale(None, free)
        gaps.diagonalScale(self._left, free)
        product = forces.transposeMatMult(gaps)
        forces.destroy()
        gaps.destroy()
        if pressed is not None and self._sign > 0:
            turning = pressed.turning(self._tractions()[0], self._first_points(), free)
            product.axpy(-1.0, turning, _DIFFERENT)
            turning.destroy()
        return product

    # What a given shape leaves undetermined.

    @property
    def assumes_pressure(self) -> bool:
        """True if an assumption determines the pressure."""
        return self._sign < 0 and not self._law.pulls

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

    def unit_forces(self, number: int) -> Floats:
        """Return the nodal forces (owned unknowns, scaled) of a unit pressure of a function."""
        unit = np.zeros(len(self._q))
        unit[number] = 1.0
        return self._nodal_forces(unit)

    def unloaded_gaps(self) -> NodeGaps:
        """Return the gaps of the unloaded bodies of an inverse problem at the nodes of both surfaces."""
        unknowns = self._unknowns
        u = unknowns.state.x.array[unknowns.displacement_dofs_of_nodes]
        return NodeGaps(*self._facets(self._body.mesh.geometry.x, -u), self._owned, self._comm)

    def with_pressures(self, report: ContactReport, pressures: Floats, scales: Scales) -> ContactReport:
        """Return a report with other pressures (scaled) of all functions."""
        pressure, multiplier = report.fields
        given = self._functions.made(multiplier.name, pressures * scales.stress)
        return replace(report, fields=(pressure, given))

    # The part of a contact.

    def passage(self, unknowns: Unknowns) -> None:
        """Return None: bodies that pass through each other are not followed."""

    def reset(self) -> None:
        self._q: Floats = np.zeros(len(self._names) * (3 if self._law.has_vectors else 1))
        self._before_update: Floats | None = None
        self._updates = list[tuple[Floats, Floats]]()

    def locate(self, *, measures: bool = False) -> None:
        """Renew the jumps at the present state, unless they are constant, or it has not changed since.

        Args:
            measures: whether gaps are needed of bodies with given pressures, too.
        """
        if not self._law.is_renewed:
            return
        unknowns, x = self._unknowns, self._body.mesh.geometry.x
        u = unknowns.state.x.array[unknowns.displacement_dofs_of_nodes]
        same = map(np.array_equal, self._place, (x, u)) if self._place is not None else (False, False)
        is_mesh_same, is_state_same = (self._comm.allreduce(part, op=MPI.LAND) for part in same)
        if is_mesh_same and (is_state_same or not (self.is_iterated or measures)):
            return
        self._place = x.copy(), u.copy()
        if self._sign < 0 and is_mesh_same:  # on a given shape forces are constant
            current, pressed, self._pressed = self._force_jump, self._pressed, None
        else:
            current, pressed = self._searched(x, u if self._sign > 0 else None)
        self._set_jumps(current, self._jump(x, -u) if self._sign < 0 else current, pressed)
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

    def change(self) -> tuple[float, Callable[[], None]]:
        """Return the change by an update, over the largest at which it has settled, and a function that makes it.

        The jumps are renewed in any case.
        """
        (after, slopes), gaps = self._tractions(), self._signed_gaps()
        forces = self._nodal_forces(after)
        pressing = slopes > 0
        changes = np.where(self._penalties > 0, np.abs(after - self._q), 0.0)
        size = float((changes / np.where(self._penalties > 0, self._penalties, 1.0)).max(initial=0.0))
        sizes = [size / self._tolerance]
        if self._law.is_renewed:
            self.locate()
            moved = np.where(pressing, np.abs(self._signed_gaps() - gaps), 0.0)
            sizes.append(float(moved.max(initial=0.0)) / self._tolerance)
            turned = np.abs(self._nodal_forces(after) - forces).max(initial=0.0), np.abs(forces).max(initial=0.0)
            difference, largest = (self._comm.allreduce(float(number), op=MPI.MAX) for number in turned)
            sizes.append(difference / (self._law.settled[1] * largest) if largest else 0.0)

        def apply() -> None:
            self._before_update, self._q = self._q, self._accelerated(after - self._q, pressing)

        return max(sizes), apply

    def _accelerated(self, change: Floats, pressing: Booleans) -> Floats:
        """Return the next multipliers, for the change that a plain update would make (Anderson's acceleration)."""
        if self._updates and not np.array_equal(pressing, self._pressing):
            self._updates = []
        self._pressing = pressing
        self._updates = [*self._updates[-_MEMORY:], (self._q, change)]
        q, changes = (np.array(part) for part in zip(*self._updates, strict=True))
        after: Floats = self._q + change
        if len(q) > 1:
            steps, differences = np.diff(q, axis=0), np.diff(changes, axis=0)
            shares = np.linalg.lstsq(differences.T, change, rcond=1e-10)[0]
            after = after - shares @ (steps + differences)
        return after if self._law.pulls else np.maximum(after, 0.0)

    def halve_update(self) -> None:
        self._updates = []
        if self._before_update is not None:
            self._q = (self._before_update + self._q) / 2

    def check_start(self) -> None:
        """Check the present state, the unloaded body's, before the first solve.

        Raises:
            MeshError: on all ranks, if bodies in contact overlap.
        """
        gaps, (a, b) = self._given.gaps, self.spec.between
        if self._law.pulls or self._sign < 0 or not gaps.min(initial=0.0) < -_OVERLAP * self._body.length:
            return
        worst = int(gaps.argmin())
        first = self._first.at(self._body.given_nodes)
        found = [first.points[row, k] for row, k in np.argwhere(first.nodes == self._names[worst])[:1]]
        place = next(part for parts in self._comm.allgather(found) for part in parts)
        raise MeshError(
            f"{self.where}.between: '{a}' and '{b}' of the unloaded bodies overlap by"
            f" {-gaps[worst] * self._body.length_scale:.3g} m at ({', '.join(f'{c:.4g}' for c in place + 0.0)}) m",
            "Move the bodies apart; a motion of a support may press them together.",
        )

    def restore(self, report: ContactReport, scales: Scales, transfer: Callable[[fem.Function], fem.Function]) -> None:
        """Set the multipliers to a solution's."""
        _, *components = report.fields
        values = [self._functions.values(transfer(component)) / scales.stress for component in components]
        self._q = -np.stack(values, axis=1).ravel() if self._law.has_vectors else values[0]
        self._updates = []

    def report(self, scales: Scales) -> ContactReport:
        """Return the results of the present state."""
        if not self.is_iterated:
            self.locate(measures=True)  # no update has measured the gaps there
        tractions, unit = self._tractions()[0], scales.stress
        gaps = self._signed_gaps() * self._sign
        if self._law.has_vectors:
            vectors = tractions.reshape(-1, 3)
            sizes, gaps = np.linalg.norm(vectors, axis=1), np.linalg.norm(gaps.reshape(-1, 3), axis=1)
            pressures = np.einsum("ni,ni->n", vectors, self._force_jump.normals)
            parts = {f"traction_{axis}": -vectors[:, i] for i, axis in enumerate("xyz")}
        else:
            pressures, sizes = tractions, np.abs(tractions)
            parts = {"multiplier": tractions}
        touched = self._force_jump.areas > 0
        widest = np.abs(gaps) if self._law.pulls else -gaps
        fields = [self._functions.made(f"interface_pressure{self._label}", pressures * unit, corners=True)]
        fields += [self._functions.made(f"interface_{n}{self._label}", v * unit) for n, v in parts.items()]
        force = self._total_force(tractions) * unit * scales.length**2
        shares = self._force_jump.areas / max(float(self._force_jump.areas.sum()), np.finfo(float).tiny)
        return ContactReport(
            where=self.where,
            region=self.spec.between[0],
            assumption=assumption(self.spec, self._sign),
            force=(float(force[0]), float(force[1]), float(force[2])),
            area=self._force_jump.area * float(shares[sizes > 0].sum()) * scales.length**2,
            penetration=float(widest[touched].max(initial=0.0)) * scales.length,
            distance=float(np.abs(gaps[sizes > 0.01 * sizes.max(initial=0.0)]).max(initial=0.0)) * scales.length,
            largest_pressure=float(sizes.max(initial=0.0)) * unit,
            tolerance=self._tolerance * scales.length,
            is_given=not self.is_iterated,
            penalty=None,
            fields=tuple(fields),
        )

    def _total_force(self, tractions: Floats) -> Floats:
        """Return the force (3,) on the first region of the job, scaled."""
        local = np.unique(self._first.local_nodes)
        local = local[local < self._unknowns.displacement_space.dofmap.index_map.size_local]
        dofs = self._unknowns.displacement_dofs_of_nodes[local]
        total: Floats = self._comm.allreduce(self._nodal_forces(tractions)[dofs].sum(axis=0), op=MPI.SUM)
        return -total if self._is_swapped else total


def pairs_of(
    interfaces: Sequence[Interface], body: Body, unknowns: Unknowns, sign: int, modulus: float
) -> list[SurfacePair]:
    """Return the interfaces of a job; collective.

    Args:
        sign: of the kinematics.
    """
    labels = [""] if len(interfaces) == 1 else [f"_{i}" for i in range(len(interfaces))]
    return [
        SurfacePair(f"interfaces[{i}]", label, spec, body, unknowns, sign, modulus)
        for i, (label, spec) in enumerate(zip(labels, interfaces, strict=True))
    ]
