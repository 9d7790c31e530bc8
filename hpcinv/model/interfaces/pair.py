"""Two surfaces of one mesh in an interface: multipliers that a solver updates between solves, forces and stiffness.

At each function ``N_i`` of the first surface a gap ``g_i`` is measured (`Jump`), and a traction ``λ_i`` acts,

    R ← R - B_fᵀ λ,      λ = law(q - ε g),      g = c ± B_g u,

where the rows of ``B_f`` and ``B_g`` are jumps on the body of the forces, and on the body of the gap. Both are constant
during a solve. They, and ``q ← λ`` (augmented Lagrangian, Uzawa), are renewed between solves until they have settled.
Each kind has its measure of the gap and of the law:

=======  ==============================  ===========================
kind     gap                             law
=======  ==============================  ===========================
tied     jump of the displacement        λ, three components
=======  ==============================  ===========================

Source: Puso & Laursen (2004), doi:10.1016/j.cma.2004.06.001; Simo & Laursen (1992), doi:10.1016/0045-7949(92)90540-G.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.errors import MeshError
from hpcinv.job.interfaces import Interface
from hpcinv.mesh import Body
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.contacts import ContactReport
from hpcinv.model.interfaces.facets import Facets, RegionFacets, gathered
from hpcinv.model.interfaces.jump import Jump
from hpcinv.model.interfaces.segments import segments
from hpcinv.model.spaces import Unknowns

_TOUCHING = 0.25
"""Distance of surfaces, in radii of their largest facet, up to which they are tied. Raised, bodies that are apart are
tied; lowered, curved surfaces with different meshes are refused."""
_STIFF = 2.0**12
"""Penalty of bilateral kinds, in shear moduli over the length of a facet; raised, fewer updates are needed, and the
tangent is worse conditioned."""
_CLOSED = 2.0**-42
"""Gap of bilateral kinds, in lengths of the body, that counts as zero. Lowered, rounding errors prevent an end."""
_MEMORY = 12
"""Updates whose differences accelerate the next one: nodes that supports hold leave multipliers that hardly move a gap,
which would settle by a tenth in each update. Raised, rounding errors of small differences are added."""
_WHERE_SHOWN = 3  # digits of lengths in messages


class SurfacePair:
    """One interface of a job in a weak form. Methods are collective.

    It takes the part of a contact among `Contacts`.

    Args:
        where: place in the job.
        label: ending of the names of its fields.
        modulus: typical shear modulus, scaled.

    Raises:
        MeshError: on all ranks, if the surfaces do not face each other, or are apart.
    """

    depends_on_state = False
    """False: it exerts no force on the body as a whole."""
    has_uniform_penalty = False
    is_iterated = True
    version = 0
    """number of the pattern of `stiffness`"""

    def __init__(self, where: str, label: str, spec: Interface, body: Body, unknowns: Unknowns, modulus: float) -> None:
        self.where, self.spec, self._label = where, spec, label
        self._body, self._unknowns, self._comm = body, unknowns, body.mesh.comm
        first, second = (self._region(name) for name in spec.between)
        self._is_swapped = spec.kind != "contact" and self._size(first) < self._size(second)
        if self._is_swapped:
            first, second = second, first
        self._first, self._second = first, second
        self._owned = unknowns.space.dofmap.index_map.size_local * unknowns.space.dofmap.index_map_bs
        chosen = first.nodes if spec.kind == "tied" else first.nodes[:, : first.kind.corner_count]
        self._names: Ints = np.unique(np.concatenate(self._comm.allgather(np.unique(chosen))))
        self._q: Floats = np.zeros(self._rows)
        self._before_update: Floats | None = None
        self._updates = list[tuple[Floats, Floats]]()
        self.update_modulus(modulus)
        self._given = self._jump(body.given_nodes / body.length_scale)
        self._force_jump = self._gap_jump = self._given
        self._set_matrices()

    @property
    def _rows(self) -> int:
        return 3 * len(self._names)

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

    def _jump(self, nodes: Floats, u: Floats | None = None) -> Jump:
        """Return the jumps where the geometry nodes are (scaled), plus a displacement of the nodes of its space."""
        first, second = self._first.at(nodes, u), gathered(self._second.at(nodes, u), self._comm)
        reach = _TOUCHING * float(second.radii.max(initial=0.0))
        found = segments(first, second, reach)
        if not self._comm.allreduce(len(found.weights)):
            self._refuse(first, second)
        corners = self.spec.kind != "tied"
        return Jump(self._names, corners=corners, first=first, second=second, segments=found, comm=self._comm)

    def _refuse(self, first: Facets, second: Facets) -> None:
        """Raise an error about surfaces that are not near each other."""
        length, (a, b) = self._body.length_scale, self.spec.between
        found = segments(first, second, np.inf)
        size = np.abs(found.gaps)
        gap = found.gaps[size.argmin()] if len(size) else np.inf
        gaps = np.array(self._comm.allgather(float(gap)))
        gap = gaps[np.abs(gaps).argmin()] * length
        if not np.isfinite(gap):
            raise MeshError(
                f"{self.where}.between: '{a}' and '{b}' do not face each other",
                "Name two surfaces whose outer normals point to each other, the finer one first.",
            )
        what = "apart" if gap > 0 else "into each other"
        raise MeshError(
            f"{self.where}.between: '{a}' and '{b}' are {abs(gap):.{_WHERE_SHOWN}g} m {what}: they cannot be tied",
            "Move the bodies together, or mesh them up to a common surface.",
        )

    def _set_matrices(self) -> None:
        self._destroy_matrices()
        self.version += 1
        self._force_matrix = self._force_jump.vector_matrix(self._owned, means=False)
        self._gap_matrix = self._gap_jump.vector_matrix(self._owned, means=True)
        areas = np.repeat(self._force_jump.areas, 3)
        self._penalties = np.where(areas > 0, self._stiffness / np.sqrt(np.where(areas > 0, areas, 1.0)), 0.0)
        self._left: PETSc.Vec = self._gap_matrix.createVecLeft()
        self._right: PETSc.Vec = self._gap_matrix.createVecRight()

    def _destroy_matrices(self) -> None:
        for name in ("_force_matrix", "_gap_matrix", "_left", "_right"):
            if name in vars(self):
                getattr(self, name).destroy()

    def update_modulus(self, modulus: float) -> None:
        """Take another typical shear modulus (scaled)."""
        self._stiffness = _STIFF * modulus

    @property
    def _tolerance(self) -> float:
        return _CLOSED * self._body.length

    def _on_all_ranks(self, vector: PETSc.Vec) -> Floats:
        return np.concatenate(self._comm.allgather(np.array(vector.array)))

    def _put_in_rows(self, values: Floats) -> None:
        start, end = self._left.getOwnershipRange()
        self._left.array[:] = values[start:end]

    def _products(self, x: PETSc.Vec) -> Floats:
        """Return the changes of all gaps by a vector of the unknowns."""
        self._gap_matrix.mult(x, self._left)
        return self._on_all_ranks(self._left)

    def _gaps(self) -> Floats:
        return self._products(self._unknowns.state.x.petsc_vec)

    def _law(self, trial: Floats) -> tuple[Floats, Floats]:
        """Return tractions and their derivatives by the trial tractions ``q - ε g``."""
        return trial, np.ones_like(trial)

    def _tractions(self) -> tuple[Floats, Floats]:
        return self._law(self._q - self._penalties * self._gaps())

    def add_forces(self, forces: Floats) -> None:
        """Subtract the nodal forces of the tractions from residuals (owned unknowns at first)."""
        self._add_transposed(-self._tractions()[0], forces)

    def add_products(self, x: PETSc.Vec, forces: Floats) -> None:
        """Add the stiffness times a vector of the unknowns to residuals (owned unknowns at first)."""
        self._add_transposed(self._slopes() * self._products(x), forces)

    def _slopes(self) -> Floats:
        return self._penalties * self._tractions()[1]

    def _add_transposed(self, values: Floats, forces: Floats) -> None:
        self._put_in_rows(values)
        self._force_matrix.multTranspose(self._left, self._right)
        forces[: self._owned] += self._right.array

    def stiffness(self, free: PETSc.Vec) -> PETSc.Mat:
        """Return a new matrix, the derivative of the forces without the rows and columns of unknowns that are not free.

        Args:
            free: 1 for free unknowns, 0 for others.
        """
        slopes = self._slopes()
        forces, gaps = self._force_matrix.copy(), self._gap_matrix.copy()
        self._put_in_rows(slopes)
        forces.diagonalScale(None, free)
        gaps.diagonalScale(self._left, free)
        product = forces.transposeMatMult(gaps)
        forces.destroy()
        gaps.destroy()
        return product

    # The part of a contact.

    def passage(self, unknowns: Unknowns) -> None:
        """Return None: bodies that pass through each other are not followed."""

    def reset(self) -> None:
        self._q = np.zeros(self._rows)
        self._before_update, self._updates = None, []

    def locate(self) -> None:
        """Renew the jumps at the present state, unless they are constant."""

    def change(self) -> tuple[float, Callable[[], None]]:
        """Return the change by an update, over the largest at which it has settled, and a function that makes it."""
        after = self._tractions()[0]
        changes = np.abs(after - self._q) / np.where(self._penalties > 0, self._penalties, np.inf)

        def apply() -> None:
            self._before_update, self._q = self._q, self._accelerated(after - self._q)

        return float(changes.max(initial=0.0)) / self._tolerance, apply

    def _accelerated(self, change: Floats) -> Floats:
        """Return the next multipliers, for the change that a plain update would make (Anderson's acceleration)."""
        self._updates = [*self._updates[-_MEMORY:], (self._q, change)]
        q, changes = (np.array(part) for part in zip(*self._updates, strict=True))
        after: Floats = self._q + change
        if len(q) > 1:
            steps, differences = np.diff(q, axis=0), np.diff(changes, axis=0)
            shares = np.linalg.lstsq(differences.T, change, rcond=1e-10)[0]
            after = after - shares @ (steps + differences)
        return after

    def halve_update(self) -> None:
        self._updates = []
        if self._before_update is not None:
            self._q = (self._before_update + self._q) / 2

    def check_start(self) -> None:
        """Check the present state before the first solve."""

    def restore(self, report: ContactReport, scales: Scales, transfer: Callable[[fem.Function], fem.Function]) -> None:
        """Set the multipliers to a solution's."""
        _, *components = report.fields
        mine = np.zeros((len(self._names), 3))
        nodes, places = self._own_nodes
        for axis, component in enumerate(components):
            mine[places, axis] = transfer(component).x.array[nodes] / scales.stress
        self._q = np.asarray(self._comm.allreduce(mine, op=MPI.SUM)).ravel()

    @property
    def _own_nodes(self) -> tuple[Ints, Ints]:
        """Owned nodes of the displacement that have a function, and the numbers of the functions."""
        local, places = self._local_nodes
        is_owned = local < self._unknowns.displacement_space.dofmap.index_map.size_local
        return local[is_owned], places[is_owned]

    @property
    def _local_nodes(self) -> tuple[Ints, Ints]:
        index_map = self._unknowns.displacement_space.dofmap.index_map
        count = index_map.size_local + index_map.num_ghosts
        numbers = index_map.local_to_global(np.arange(count, dtype=np.int32))
        local = np.flatnonzero(np.isin(numbers, self._names))
        return local, np.searchsorted(self._names, numbers[local])

    def report(self, scales: Scales) -> ContactReport:
        """Return the results of the present state."""
        tractions, jump = self._tractions()[0].reshape(-1, 3), self._force_jump
        gaps = np.linalg.norm(self._gaps().reshape(-1, 3), axis=1)
        pressures = -np.einsum("ni,ni->n", tractions, jump.normals) * scales.stress
        force = self._total_force() * scales.stress * scales.length**2
        widest = float(gaps.max(initial=0.0)) * scales.length
        fields = [self._at_vertices(f"interface_pressure{self._label}", pressures)]
        fields += [
            self._at_nodes(f"interface_traction_{axis}{self._label}", tractions[:, i] * scales.stress)
            for i, axis in enumerate("xyz")
        ]
        return ContactReport(
            where=self.where,
            region=self.spec.between[0],
            assumption=f"tied to '{self.spec.between[1]}'",
            force=(float(force[0]), float(force[1]), float(force[2])),
            area=jump.area * scales.length**2,
            penetration=widest,
            distance=widest,
            largest_pressure=float(np.linalg.norm(tractions, axis=1).max(initial=0.0)) * scales.stress,
            tolerance=self._tolerance * scales.length,
            is_given=False,
            penalty=None,
            fields=tuple(fields),
        )

    def _total_force(self) -> Floats:
        """Return the force (3,) on the first surface, scaled."""
        forces = np.zeros(self._owned)
        self._add_transposed(self._tractions()[0], forces)
        local = np.unique(self._first.local_nodes)
        local = local[local < self._unknowns.displacement_space.dofmap.index_map.size_local]
        dofs = self._unknowns.displacement_dofs_of_nodes[local]
        total: Floats = self._comm.allreduce(forces[dofs].sum(axis=0), op=MPI.SUM)
        return -total if self._is_swapped else total

    def _at_nodes(self, name: str, values: Floats) -> fem.Function:
        function = fem.Function(fem.functionspace(self._body.mesh, self._unknowns.scalar_elements[0]), name=name)
        nodes, places = self._local_nodes
        function.x.array[nodes] = values[places]
        return function

    def _at_vertices(self, name: str, values: Floats) -> fem.Function:
        function = fem.Function(fem.functionspace(self._body.mesh, ("Lagrange", 1)), name=name)
        vertices = vertex_count(self._body.source.kind)
        nodes, places = self._local_nodes
        nodal = np.zeros(len(self._unknowns.displacement_dofs_of_nodes))
        nodal[nodes] = values[places]
        dofs = self._unknowns.displacement_space.dofmap.list[:, :vertices]
        function.x.array[function.function_space.dofmap.list] = nodal[dofs]
        return function

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._destroy_matrices()


def pairs_of(interfaces: Sequence[Interface], body: Body, unknowns: Unknowns, modulus: float) -> list[SurfacePair]:
    """Return the interfaces of a job; collective."""
    labels = [""] if len(interfaces) == 1 else [f"_{i}" for i in range(len(interfaces))]
    return [
        SurfacePair(f"interfaces[{i}]", label, spec, body, unknowns, modulus)
        for i, (label, spec) in enumerate(zip(labels, interfaces, strict=True))
    ]
