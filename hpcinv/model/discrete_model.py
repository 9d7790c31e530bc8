"""The discrete model of a job on one body: spaces, supports, scales and weak forms."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dolfinx.fem import Function

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.quantity.nondimensional import Scales, power_of_two
from hpcinv.errors import JobError
from hpcinv.job.job import UNNAMED, Job
from hpcinv.job.states import given_on_current
from hpcinv.mesh import Body
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.model.cell_layers import layers_of_cells
from hpcinv.model.contact_reports import ContactReport, SlipHistory
from hpcinv.model.field_checks import check_fields, shear_modulus
from hpcinv.model.fields import BodyFields
from hpcinv.model.spaces import Unknowns
from hpcinv.model.state import State
from hpcinv.model.supports import Supports
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.effects import Direction
from hpcinv.physics.kinematics.kinematics import ForwardKinematics, InverseKinematics

KINEMATICS = {kind.direction: kind for kind in (ForwardKinematics, InverseKinematics)}

_NEAR = 8.0
"""Ratio of stress scales up to which the present one stays, so that factors serve the next job. Raised, scaled moduli
may be far from 1, as the tolerances of singular tangents expect them."""


class DiscreteModel:
    """Spaces, supports, scales and weak forms of a reuse group of jobs (`reuse_group_of`) on one body.

    They are made once, with their programs. `put` sets the mesh's coordinates, the unknowns, the load factor, the
    parameters, the supports and the contacts. Apart from it, only a solver changes them.

    Args:
        like: the same of another state of the body, whose spaces are used.

    Attributes:
        job: of the present state.

    Raises:
        JobError: on all ranks, if the quadrature is not enough for the cells of the mesh.
        MeshError: on all ranks, if the mesh lacks what the job names, or a field is not admissible on it.
    """

    def __init__(self, job: Job, body: Body, timings: Timings, like: DiscreteModel | None = None) -> None:
        self.job, self.body, self.timings = job, body, timings
        self._weak_forms: dict[tuple[Direction, bool], WeakForm] = {}
        self._given_u: Function | None = None  # displacement of the given state, if something is given there (scaled)
        self._given_function: Function | None = None  # for the next use, since weak forms refer to it
        self._given_displacement: Function | None = None
        self._load, self._contacts = 0.0, tuple[ContactReport, ...]()  # of the present state
        self.quadrature_degree = _quadrature(job, body.source)
        body.move_to(body.given_nodes)
        with timings("set-up"):
            self.fields: BodyFields = BodyFields(body) if like is None else like.fields
            check_fields(job, self.fields)
            self.scales = self._scales()
            self.unknowns: Unknowns = (
                Unknowns(
                    body.mesh,
                    job.discretisation.displacement,
                    job.pressure_degree,
                    layers_of_cells(job, body),
                    has_directors=body.source.is_thin,
                )
                if like is None
                else like.unknowns
            )
            self.supports = Supports(job, body, self.unknowns)

    def put(self, state: State) -> None:
        """Put the mesh, the unknowns, the load factor, contacts and the numbers of the job into a state; collective.

        Raises:
            MeshError: on all ranks, if a field of the state's job is not admissible, or its supports contradict each
                other; nothing can be solved afterwards.
        """
        if state.job is not self.job:
            self.body.move_to(self.body.given_nodes)  # on which supports and fields are given
            self._update_parameters(state.job)
        self._attach(state.given_displacement)
        self.body.move_to(state.mesh_nodes)
        self._contacts = state.contacts
        for weak_form in self._weak_forms.values() if state.contacts else ():
            weak_form.contacts.restore(state.contacts, self.scales)
        self.put_load(state.load)
        self.put_fields(state.fields)

    def renew(self, job: Job, timings: Timings) -> None:
        """Begin another run, with the numbers of its job, on the given mesh and without displacement; collective.

        Raises:
            MeshError: as `put`.
        """
        self.timings = timings
        self.body.move_to(self.body.given_nodes)
        self._update_parameters(job)
        self._attach(None)
        self._contacts = ()
        self.put_load(0.0)
        self.unload()

    def put_load(self, load: float) -> None:
        """Set the load factor of all weak forms and of the supports, without a path from another state."""
        self._load = load
        for weak_form in self._weak_forms.values():
            weak_form.parameters.set_load(load)
        self.supports.scale(load)

    def put_fields(self, fields: tuple[Function, Function | None] | None, *, locates: bool = True) -> None:
        """Set the unknowns alone; the next solve begins with them.

        Args:
            fields: displacement (m) and pressure (Pa; ``None`` in the displacement form); ``None`` for zero.
            locates: whether contacts are searched there, which fields of the body do not need.
        """
        if fields is None:
            self.unload()
            return
        u, p = fields
        self.unknowns.set_displacement(u.x.array / self.scales.length)
        if p is not None:
            self.unknowns.set_pressure(p.x.array / self.scales.stress)
        if locates:
            self._locate_contacts()

    def put_displacement(self, values: Floats) -> None:
        """Set the displacement alone, by values (scaled) at the local degrees of freedom of its space."""
        self.unknowns.set_displacement(values)
        self._locate_contacts()

    def put_contacts(
        self, direction: Direction, reports: Sequence[ContactReport], transfer: Callable[[Function], Function]
    ) -> None:
        """Set the contacts of a direction alone to a solution's on another mesh, as `Contacts.restore`; collective."""
        self.weak_form(direction).contacts.restore(reports, self.scales, transfer)

    def slip_histories(self, direction: Direction, load: float) -> tuple[SlipHistory | None, ...]:
        """Return the histories of slip of all contacts for a solve that has reached a load factor, or none."""
        weak_form = self._weak_forms.get((direction, self._given_u is not None))
        return () if weak_form is None else weak_form.contacts.histories(load, self.scales)

    def unload(self) -> None:
        """Set displacement and pressure to zero."""
        self.unknowns.state.x.array[:] = 0.0
        self._locate_contacts()

    def put_unknowns(self, values: Floats) -> None:
        """Set all unknowns by scaled values of the owned ones, or of all local ones; collective."""
        state = self.unknowns.state.x
        state.array[: len(values)] = values
        state.scatter_forward()

    def impose_supports(self, direction: Direction) -> None:
        """Set the displacements that supports hold to the prescribed ones at full load; collective.

        Regions under remote loads, whose motions are unknown, stay where they are.

        Args:
            direction: of the present state.
        """
        state = self.unknowns.state.x
        unknown_motions = [(face.dofs, state.array[face.dofs]) for face in self.supports.remote_faces.values()]
        self.supports.scale(1.0, KINEMATICS[direction].sign)
        self.supports.impose(state.array)
        for dofs, values in unknown_motions:
            state.array[dofs] = values
        state.scatter_forward()

    def _locate_contacts(self) -> None:
        for weak_form in self._weak_forms.values():
            weak_form.contacts.locate()

    def state(self, load: float = 1.0) -> State:
        """Return the present state, with copies of its fields."""
        u, p = self.unknowns.displacement(), self.unknowns.pressure()
        u.x.array[:] *= self.scales.length
        if p is not None:
            p.x.array[:] *= self.scales.stress
        return State(
            job=self.job,
            mesh_nodes=self.body.nodes,
            displacement=u,
            pressure=p,
            load=load,
            given_displacement=self._given_displacement,
        )

    def unloaded(
        self,
        job: Job | None = None,
        nodes: Floats | None = None,
        given_displacement: Function | None = None,
        contacts: tuple[ContactReport, ...] = (),
    ) -> State:
        """Return the state without displacement and pressure.

        Args:
            job: of the state, by default the present one.
            nodes: where the mesh lies, (n, 3) in m, by default as it was given.
            given_displacement, contacts: as in `State`.
        """
        is_mixed = self.unknowns.p is not None
        return State(
            job=job or self.job,
            mesh_nodes=self.body.given_nodes if nodes is None else nodes,
            displacement=Function(self.unknowns.displacement_space, name="displacement"),
            pressure=Function(self.unknowns.pressure_space, name="pressure") if is_mixed else None,
            load=0.0,
            given_displacement=given_displacement,
            contacts=contacts,
        )

    def _update_parameters(self, job: Job) -> None:
        """Change to the numbers of another job of the same reuse group, on the mesh as it was given."""
        self.job = job
        with self.timings("set-up"):
            check_fields(job, self.fields)
            scales = self._scales()
            if not 1 / _NEAR <= scales.stress / self.scales.stress <= _NEAR:
                self.scales = scales
            self.supports.update_parameters(job)
            for weak_form in self._weak_forms.values():
                weak_form.update_parameters(job, self.scales)
                weak_form.contacts.reset()

    def _attach(self, given_displacement: Function | None) -> None:
        """Attach to the material what is given on the current body of the given state."""
        self._given_displacement, self._given_u = given_displacement, None
        if given_displacement is None:
            return
        parts = (*self.job.laws.values(), *self.job.effects, *self.job.families.values())
        if any(True for part in parts for _ in given_on_current(part)):
            self._given_u = self._given_function = self._given_function or Function(self.unknowns.displacement_space)
            self._given_u.x.array[:] = given_displacement.x.array / self.scales.length

    @property
    def has_attached(self) -> bool:
        """True if the present state is not the given one, and something is given on the current body of that."""
        return self._given_u is not None

    def weak_form(
        self, direction: Direction, given_u: Function | None = None, quadrature: int | None = None
    ) -> WeakForm:
        """Return the weak form in one direction, at the present load factor and with the present contacts.

        It is evaluated at the coordinates that the mesh has at that time. What exists does not change.

        Args:
            given_u: as for `WeakForm`.
            quadrature: quadrature degree, by default the degree of the job.
        """
        is_kept = given_u is None and quadrature is None
        key = direction, self._given_u is not None
        if is_kept and key in self._weak_forms:
            return self._weak_forms[key]
        given_u = self._given_u if given_u is None else given_u
        kinematics, degree = KINEMATICS[direction], quadrature or self.quadrature_degree
        with self.timings("programs"):
            weak_form = WeakForm(self.job, self.fields, self.unknowns, kinematics, degree, self.scales, given_u)
        weak_form.parameters.set_load(self._load)
        if self._contacts:
            weak_form.contacts.restore(self._contacts, self.scales)
        weak_form.contacts.locate()
        if is_kept:
            self._weak_forms[key] = weak_form
        return weak_form

    def largest_displacement(self) -> float:
        """Return the largest displacement of the present state at any degree of freedom, in m; collective."""
        u = self.unknowns.displacement().x.array.reshape(-1, 3)
        largest = float((u**2).sum(axis=1).max(initial=0.0)) ** 0.5 * self.scales.length
        return float(self.body.mesh.comm.allreduce(largest, op=MPI.MAX))

    def _scales(self) -> Scales:
        return Scales(self.body.length_scale, power_of_two(shear_modulus(self.job, self.fields)))


def _quadrature(job: Job, source: MeshSource) -> int:
    """Return the quadrature degree of a job on the cells of a mesh.

    Raises:
        JobError: it leaves motions of the cells without energy.
    """
    kind, degree, displacement = source.kind, job.discretisation.quadrature, job.discretisation.displacement
    least = default_quadrature(kind, displacement)
    if degree is not None and degree < least:
        cells = {"tetrahedron": "tetrahedra", "hexahedron": "hexahedra"}[kind]
        raise JobError(
            f"{job.path or UNNAMED}: discretisation.quadrature: must be at least {least} on {cells} of degree"
            f" {displacement}, not {degree}, or the tangent is nearly singular; raise it, or leave it out"
        )
    return source_of(source.body_kind).quadrature(source, degree or least)


def default_quadrature(kind: str, displacement: int) -> int:
    """Return the least degree that leaves no motion of a cell without energy, and keeps the order of convergence.

    It is ``2k - 2`` on simplices, and ``k + 1`` Gauss points in each direction on hexahedra.

    Source: Ciarlet, *The Finite Element Method for Elliptic Problems*, 2002, ch. 4, doi:10.1137/1.9780898719208.
    """
    return 2 * displacement if kind == "hexahedron" else max(2 * displacement - 2, 1)
