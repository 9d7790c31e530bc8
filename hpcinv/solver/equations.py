"""The equations of a job on one body, with their solvers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property

from petsc4py import PETSc

from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import MeshError
from hpcinv.job.job import UNNAMED, Job
from hpcinv.mesh import Body
from hpcinv.model.assembly.system import System
from hpcinv.model.discrete_model import DiscreteModel
from hpcinv.model.weak_form import WeakForm
from hpcinv.on_demand import on_demand
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.equilibrium_path import Policy
from hpcinv.solver.linear.selection import Chooser
from hpcinv.solver.linear_solver import LinearSolver
from hpcinv.solver.load_stepping import AdaptiveSteps, equal_steps
from hpcinv.solver.observer import SILENT, Observer
from hpcinv.solver.predictor import Predictor
from hpcinv.solver.support_checks import check_agreement, check_held, check_not_enclosed, may_turn

_STIFF = "interfaces are too stiff for multigrid"


class Equations(DiscreteModel):
    """Equations of a reuse group of jobs on one body, and their solvers.

    A solver is made once for each weak form and used again, with its matrix pattern and symbolic factorization.

    Args:
        like: equations of another state of the body, whose spaces are used.
    """

    def __init__(self, job: Job, body: Body, timings: Timings, like: Equations | None = None) -> None:
        super().__init__(job, body, timings, like)
        self._like = like
        self._idle: dict[int, Equilibrium] = {}  # by the id of the weak form
        self._are_supports_checked = False

    def _update_parameters(self, job: Job) -> None:
        super()._update_parameters(job)
        with self.timings("set-up"), self._naming_job():
            check_agreement(job, self.body, self.supports)
        self._are_supports_checked &= not self._has_springs

    def check_supports(self, system: System | None = None) -> None:
        """Check that supports agree, hold the body and all its parts, and leave it its volume; collective.

        Args:
            system: equations; without them it is left open whether springs hold the body.

        Raises:
            MeshError: on all ranks, if they do not.
        """
        with self.timings("set-up"), self._naming_job():
            check_agreement(self.job, self.body, self.supports)
            if system is not None or not self._has_springs:
                springs = system if self._has_springs else None
                check_held(self.body, self.supports, springs, self.job.interfaces)
                if may_turn(self.body):
                    space = self.unknowns.displacement_space
                    on_demand("check of hinges")(self.body, self.supports, space, springs)
            check_not_enclosed(self.job, self.body)
        self._are_supports_checked = system is not None or not self._has_springs

    def take_supports_as_checked(self) -> None:
        """Leave the check of the supports out, since other equations of this body have had it."""
        self._are_supports_checked = True

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
        degree, against = self.job.discretisation.displacement, self.job.mesh.kind.against_multigrid
        against = against or (_STIFF if self.job.all_interfaces else "")
        stiffness = max(law.stiffness_ratio or 1.0 for law in self.job.laws.values())
        return Chooser(self.unknowns, degree, against_multigrid=against, stiffness=stiffness)

    def equilibrium(self, weak_form: WeakForm, observer: Observer = SILENT) -> Equilibrium:
        """Return the equations of a weak form with the solver of the job."""
        equilibrium = self._idle.pop(id(weak_form), None) or self._new_equilibrium(weak_form)
        for pins in weak_form.contacts.pins:
            pins.begin()
        equilibrium.linear.options.restore()
        weak_form.passages.forget()
        equilibrium.system.timings, equilibrium.observer = self.timings, observer
        if not self._are_supports_checked:
            try:
                self.check_supports(equilibrium.system)
            except MeshError:
                equilibrium.destroy()
                raise
        return equilibrium

    def _new_equilibrium(self, weak_form: WeakForm) -> Equilibrium:
        solver = self.job.solver
        like = next((idle.system for idle in self._idle.values()), None)
        with self._naming_job():
            if self.job.interfaces and not weak_form.contacts.pins:
                pins = on_demand("pins of free parts")(self.job, self.body, self.supports, weak_form)
                weak_form.contacts.pins = tuple(pins)
            system = System(weak_form, self.supports, self.timings, like)
        with self.timings("set-up"):
            self.chooser.analyse(solver, self.unknowns)
        options_of = f"{self.job.path or UNNAMED}: solver.petsc"
        linear = LinearSolver(system, solver.petsc, self.chooser.choose(solver), options_of)
        reuse = 0.3 if solver.reuse_tangent else 0.0
        return Equilibrium(system, linear, Predictor(system, linear), limit=solver.maximum_iterations, reuse=reuse)

    def release(self, equilibrium: Equilibrium) -> None:
        """Keep a solver for the next use, or destroy it if its weak form is not kept.

        Factors stay, and so does multigrid where it takes a small part of the memory; see `free_multigrid`.
        """
        weak_form = equilibrium.system.weak_form
        if any(weak_form is kept for kept in self._weak_forms.values()) and id(weak_form) not in self._idle:
            equilibrium.system.end_path()
            equilibrium.take_numbers()
            equilibrium.linear.release_preconditioner()
            self._idle[id(weak_form)] = equilibrium
            if not self.chooser.can_keep_multigrid:
                self.free_multigrid()
        else:
            equilibrium.destroy()

    def symmetric_factors(self) -> list[PETSc.PC]:
        """Return the factors L D Lᵀ of solvers that are not in use, with their inertia."""
        factors = (equilibrium.linear.symmetric_factors for equilibrium in self._idle.values())
        return [pc for pc in factors if pc is not None]

    def free_multigrid(self) -> None:
        """Free the memory of the multigrid hierarchies of solvers that are not in use."""
        for equilibrium in self._idle.values():
            equilibrium.linear.free_preconditioner()

    def destroy(self) -> None:
        for equilibrium in self._idle.values():
            equilibrium.destroy()
        self._idle.clear()

    @property
    def steps(self) -> Policy:
        """The steps of the job's strategy."""
        solver = self.job.solver
        if solver.strategy == "fixed":
            return equal_steps(solver.steps, solver.tolerance)
        first, least = solver.initial_step, solver.minimum_step
        if solver.strategy == "arc-length":
            arcs: Policy = on_demand("arc length")(first, least, solver.limit_points, solver.maximum_steps)
            return arcs
        return AdaptiveSteps(first, least)
