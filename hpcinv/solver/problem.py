"""The discrete model of a job: spaces, supports and scales on one body, and the equations of either direction."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property

from dolfinx.fem import Function
from petsc4py import PETSc

from hpcinv.assembly.system import System
from hpcinv.effects import Direction
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import UNNAMED, Job
from hpcinv.job.states import given_on_current
from hpcinv.kinematics.kinematics import ForwardKinematics, InverseKinematics
from hpcinv.mesh import Body
from hpcinv.mesh.moved import placed
from hpcinv.mesh.source import Floats
from hpcinv.model.field_checks import check_fields, shear_modulus
from hpcinv.model.fields import BodyFields
from hpcinv.model.layers import layers_of_cells
from hpcinv.model.scene import Scene
from hpcinv.model.spaces import Unknowns
from hpcinv.model.supports import Supports
from hpcinv.parallel.runtime import MPI
from hpcinv.parallel.timings import Timings
from hpcinv.quantity.nondimensional import Scales, power_of_two
from hpcinv.solver.arc_length import ArcLengthSteps
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.hinge_checks import check_hinges
from hpcinv.solver.linear.selection import Chooser
from hpcinv.solver.linear_solver import LinearSolver
from hpcinv.solver.load_stepping import AdaptiveSteps, FixedSteps, Steps
from hpcinv.solver.observer import SILENT, Observer
from hpcinv.solver.predictor import Predictor
from hpcinv.solver.support_checks import check_agreement, check_held, check_not_enclosed

KINEMATICS = {kind.direction: kind for kind in (ForwardKinematics, InverseKinematics)}


class Model:
    """Spaces, supports, scales and scenes of a job, and of other jobs of the same reuse group (`reuse_group_of`).

    Scenes and the equations on them are made once and used again, with their compiled kernels, the pattern of the
    matrix and its symbolic factorization.

    Args:
        like: a model of another state of the body, whose spaces are used.

    Attributes:
        given: displacement (scaled) of the state in which fibres, fields and densities are given on the current body;
            ``None`` if that is the state of this model, or nothing is given so.

    Raises:
        JobError: on all ranks, if the quadrature is not enough for the cells of the mesh.
        MeshError: on all ranks, if the mesh lacks what the job names, or a field is not admissible on it.
    """

    def __init__(self, job: Job, body: Body, timings: Timings, like: Model | None = None) -> None:
        self.job, self.body, self.timings = job, body, timings
        self._scenes: dict[tuple[Direction, bool], Scene] = {}
        self._idle: dict[int, Equilibrium] = {}  # by the scene
        self._like = like
        self.given: Function | None = None
        self._carried: Function | None = None  # kept for the next use, since scenes refer to it
        self.is_of_given_mesh = True
        self.quadrature_degree = _quadrature(job, body.source.kind)
        with timings("set-up"):
            self.fields: BodyFields = BodyFields(body) if like is None else like.fields
            check_fields(job, self.fields)
            self.scales = self._scales()
            self.unknowns: Unknowns = (
                Unknowns(body.mesh, job.discretisation.displacement, job.pressure_degree, layers_of_cells(job, body))
                if like is None
                else like.unknowns
            )
            self.supports = Supports(job, body, self.unknowns)
        self._are_supports_checked = False

    def update_parameters(self, job: Job, timings: Timings) -> None:
        """Change to another job of the same reuse group, on the mesh as the job gives it.

        Raises:
            MeshError: as the constructor; the model cannot be used afterwards.
        """
        self.job, self.timings = job, timings
        with timings("set-up"):
            check_fields(job, self.fields)
            self.scales = self._scales()
            self.supports.update_parameters(job)
            with self._naming_job():
                check_agreement(job, self.body, self.supports)
            self._are_supports_checked &= not self._has_springs
            for scene in self._scenes.values():
                scene.update_parameters(job, self.scales)
                scene.contacts.reset()

    def check_supports(self, system: System | None = None) -> None:
        """Check that supports agree, hold the body and all its parts, and leave it its volume; collective.

        Args:
            system: equations of a scene, without which it is left open whether springs hold the body.

        Raises:
            MeshError: on all ranks, if they do not.
        """
        with self.timings("set-up"), self._naming_job():
            check_agreement(self.job, self.body, self.supports)
            if system is not None or not self._has_springs:
                springs = system if self._has_springs else None
                check_held(self.body, self.supports, springs)
                check_hinges(self.body, self.supports, self.unknowns.displacement_space, springs)
            check_not_enclosed(self.job, self.body)
        self._are_supports_checked = system is not None or not self._has_springs

    @contextmanager
    def _naming_job(self) -> Iterator[None]:
        """Add the file of the job, and its state if there are several, to a ``MeshError`` about supports."""
        file = "" if self.job.path is None else f"{self.job.path}: "
        state = f"in state '{self.job.state}': " if self.job.state else ""
        try:
            yield
        except MeshError as error:
            raise MeshError(f"{file}{state}{error.message}", error.advice) from None

    @property
    def _has_springs(self) -> bool:
        return any(effect.holds for effect in self.job.effects)

    @cached_property
    def chooser(self) -> Chooser:
        """The rule by which the linear solver is chosen; collective at the first access."""
        if self._like is not None:
            return self._like.chooser
        return Chooser(self.unknowns, self.job.discretisation.displacement)

    def _scales(self) -> Scales:
        return Scales(self.body.length_scale, power_of_two(shear_modulus(self.job, self.fields)))

    def scene(self, direction: Direction, known: Function | None = None, quadrature: int | None = None) -> Scene:
        """Return the scene in one direction; it is evaluated at the coordinates of the mesh at that time.

        Args:
            known: as for `Scene`.
            quadrature: quadrature degree, by default the degree of the job.
        """
        is_kept = known is None and quadrature is None
        key = direction, self.given is not None
        if is_kept and key in self._scenes:
            return self._scenes[key]
        known = self.given if known is None else known
        kinematics, degree = KINEMATICS[direction], quadrature or self.quadrature_degree
        with self.timings("compile"):
            scene = Scene(self.job, self.fields, self.unknowns, kinematics, degree, self.scales, known)
        if is_kept:
            self._scenes[key] = scene
        return scene

    def given_displacement(self) -> Function | None:
        """Return `given` in m."""
        if self.given is None:
            return None
        u = self.given.copy()
        u.x.array[:] *= self.scales.length
        return u

    def carry(self, u: Function | None) -> None:
        """Solve for another state than the given one, with what is given there attached to the material points.

        Args:
            u: displacement (m) of the given state; ``None`` if the model's state is the given one.
        """
        self.is_of_given_mesh = u is None
        parts = (*self.job.laws.values(), *self.job.effects, *self.job.families.values())
        self.given = None
        if u is not None and any(True for part in parts for _ in given_on_current(part)):
            self.given = self._carried = self._carried or Function(self.unknowns.displacement_space)
            self.given.x.array[:] = u.x.array / self.scales.length

    @contextmanager
    def given_moved(self, along: Function | None, step: float) -> Iterator[None]:
        """Context with the given state's displacement a step along a rate (m) of it, where something is given there."""
        if along is None or self.given is None:
            yield
            return
        values = self.given.x.array
        before = values.copy()
        values += step / self.scales.length * along.x.array
        try:
            yield
        finally:
            values[:] = before

    def equilibrium(self, scene: Scene, observer: Observer = SILENT) -> Equilibrium:
        """Return the equations of a scene with the solver of the job."""
        equilibrium = self._idle.pop(id(scene), None)
        if equilibrium is None:
            solver = self.job.solver
            like = next((idle.system for idle in self._idle.values()), None)
            system = System(scene, self.supports, self.timings, like)
            linear = LinearSolver(
                system, solver.petsc, self.chooser.choose(solver), f"{self.job.path or UNNAMED}: solver.petsc"
            )
            equilibrium = Equilibrium(
                system,
                linear,
                Predictor(system, linear),
                limit=solver.maximum_iterations,
                reuse=0.3 if solver.reuse_tangent else 0.0,
            )
        equilibrium.linear.options.restore()
        scene.contacts.locate()
        scene.passages.forget()
        equilibrium.system.timings, equilibrium.observer = self.timings, observer
        if not self._are_supports_checked:
            try:
                self.check_supports(equilibrium.system)
            except MeshError:
                equilibrium.destroy()
                raise
        return equilibrium

    def release(self, equilibrium: Equilibrium) -> None:
        """Keep equations for the next use, or destroy them if the model does not keep their scene.

        Factors stay, and so does multigrid where it takes a small part of the memory; see `free_multigrid`.
        """
        scene = equilibrium.system.scene
        if any(scene is kept for kept in self._scenes.values()) and id(scene) not in self._idle:
            equilibrium.system.end_path()
            equilibrium.linear.release_preconditioner()
            self._idle[id(scene)] = equilibrium
            if not self.chooser.can_keep_multigrid:
                self.free_multigrid()
        else:
            equilibrium.destroy()

    def symmetric_factors(self) -> list[PETSc.PC]:
        """Return the factors L D Lᵀ that equations which are not in use have, with their inertia."""
        found = (equilibrium.linear.symmetric_factors for equilibrium in self._idle.values())
        return [pc for pc in found if pc is not None]

    def free_multigrid(self) -> None:
        """Free the memory of the multigrid hierarchies of equations that are not in use."""
        for equilibrium in self._idle.values():
            equilibrium.linear.free_preconditioner()

    def destroy(self) -> None:
        for equilibrium in self._idle.values():
            equilibrium.destroy()
        self._idle.clear()

    def solution(self) -> tuple[Function, Function | None]:
        """Return copies of the present displacement (m) and pressure (Pa; ``None`` in the displacement form)."""
        u, p = self.unknowns.displacement(), self.unknowns.pressure()
        u.x.array[:] *= self.scales.length
        if p is not None:
            p.x.array[:] *= self.scales.stress
        return u, p

    def largest_displacement(self) -> float:
        """Return the largest displacement of the present state at any degree of freedom, in m; collective."""
        u = self.unknowns.displacement().x.array.reshape(-1, 3)
        largest = float((u**2).sum(axis=1).max(initial=0.0)) ** 0.5 * self.scales.length
        return float(self.body.mesh.comm.allreduce(largest, op=MPI.MAX))

    @contextmanager
    def at(self, nodes: Floats, u: Function, p: Function | None) -> Iterator[None]:
        """Context in which the mesh lies at ``nodes`` and the state is a `solution`; both are restored at the end.

        Args:
            nodes: coordinates of the local geometry nodes, (n, 3) in m.
            u: displacement, in m.
            p: pressure, in Pa; ``None`` in the displacement form.
        """
        state = self.unknowns.state.x.array
        before = state.copy()
        with placed(self.body.mesh, nodes / self.body.length_scale):
            self.set_solution(u, p)
            try:
                yield
            finally:
                state[:] = before

    def set_solution(self, u: Function, p: Function | None) -> None:
        """Set the present state, from which the next solve begins, to a `solution`."""
        u, p = u.copy(), p.copy() if p is not None else None
        u.x.array[:] /= self.scales.length
        self.unknowns.set_displacement(u)
        if p is not None:
            p.x.array[:] /= self.scales.stress
            self.unknowns.set_pressure(p)

    @property
    def steps(self) -> Steps:
        solver, cases = self.job.solver, self.job.case_count
        if solver.strategy == "fixed":
            return FixedSteps(solver.steps, solver.tolerance, cases=cases)
        first, least = solver.initial_step, solver.minimum_step
        if solver.strategy == "arc-length":
            return ArcLengthSteps(first, least, solver.limit_points, solver.maximum_steps, cases=cases)
        return AdaptiveSteps(first, least, cases=cases)


def _quadrature(job: Job, kind: str) -> int:
    """Return the quadrature degree of a job on cells of one kind.

    Raises:
        JobError: it leaves motions of the cells without energy.
    """
    given, displacement = job.discretisation.quadrature, job.discretisation.displacement
    least = default_quadrature(kind, displacement)
    if given is not None and given < least:
        cells = {"tetrahedron": "tetrahedra", "hexahedron": "hexahedra"}[kind]
        raise JobError(
            f"{job.path or UNNAMED}: discretisation.quadrature: must be at least {least} on {cells} with displacements"
            f" of degree {displacement}, not {given}: with fewer points, cells have spurious motions without energy,"
            " which make the tangent singular or nearly so; raise it, or leave it out"
        )
    return given or least


def default_quadrature(kind: str, displacement: int) -> int:
    """Return the least degree that leaves no motion of a cell without energy, and keeps the order of convergence.

    It is ``2k - 2`` on simplices, and ``k + 1`` Gauss points in each direction on hexahedra.

    Source: Ciarlet, *The Finite Element Method for Elliptic Problems*, 2002, ch. 4, doi:10.1137/1.9780898719208.
    """
    return 2 * displacement if kind == "hexahedron" else max(2 * displacement - 2, 1)
