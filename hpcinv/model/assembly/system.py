"""Residual and tangent of a weak form at a load factor, as PETSc vector and matrix."""

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any, Self

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.job.job import Job
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.admissibility import Admissibility
from hpcinv.model.assembly.tangent import Tangent, tangent_of
from hpcinv.model.assembly.tangent_moduli import Term
from hpcinv.model.contact_reports import SlipHistory
from hpcinv.model.outcome import Outcome
from hpcinv.model.supports import Supports
from hpcinv.model.weak_form import WeakForm
from hpcinv.on_demand import on_demand

_BALANCED = 1e-9
"""Nodal force, in shear moduli times the body's length squared, that does not hinder small load steps. With a larger
one, obstacles may press so much at the beginning of the path that no step is small enough."""


class System:
    """The discrete equations ``R(x, λ) = 0`` of one weak form under its supports, and their tangent ``K = ∂R/∂x``.

    Rows of prescribed unknowns are ``x_i - λ ū_i = 0``; in the other rows these unknowns have the prescribed values.

    The path of λ begins with the unloaded body, or with a state ``x_0`` of other loads and supports. From there it is
    ``R(x, 1) - (1 - λ) R(x_0, 1)``: the nodal forces that hold the body in that state are taken away, and prescribed
    unknowns go from their values there to ``ū_i``.

    Args:
        like: another system of the same unknowns. The tangent is assembled in the same way as there, with the same
            pattern, which takes as long to make as one assembly or two.

    Attributes:
        state: all unknowns x; residual and tangent are evaluated at them.
        rhs: a vector for residuals.
        director: unknowns of the matrix in a long thin shell; elsewhere they are at the nodes.
        tangents: number of assemblies of the tangent; outdated factors are recognized by it.
    """

    def __init__(self, weak_form: WeakForm, supports: Supports, timings: Timings, like: Self | None = None) -> None:
        self.weak_form, self.supports, self.timings = weak_form, supports, timings
        self.comm = weak_form.unknowns.mesh.comm
        self.state = weak_form.unknowns.state
        self.tangents, self._like = 0, like
        self._constraint: Any = None
        self._paired: Any = None
        self._path: tuple[npt.NDArray[np.float64], float] | None = None  # R(x_0, 1) and 1 - λ
        with timings("set-up"):
            self.rhs = fem_petsc.create_vector(weak_form.unknowns.space)
            is_thin = weak_form.unknowns.has_directors
            self.director = on_demand("unknowns of directors")(weak_form.unknowns, supports) if is_thin else None

    # Where only the tangent is needed, as for stability, neither residual nor checks are made.
    @cached_property
    def _residual(self) -> fem.Form:
        with self.timings("programs"):
            return fem.form(self.weak_form.residual)

    @cached_property
    def _admissibility(self) -> Admissibility:
        with self.timings("programs"):
            return Admissibility(self.weak_form)

    @cached_property
    def _tangent(self) -> Tangent:
        like = self._like
        with self.timings("programs"):
            tangent = like._tangent if like and "_tangent" in vars(like) else None
            return tangent_of(self.weak_form, like=tangent, director=self.director)

    @cached_property
    def _matrix(self) -> tuple[PETSc.Mat, Callable[..., None]]:
        tangent, like = self._tangent, self._like
        with self.timings("tangent"):
            _multiply_without_inodes()
            matrix, assemble = tangent.create_matrix(
                self.supports.conditions, like._tangent if like and like.tangents else None
            )
            if pairs := self.weak_form.contacts.stiff:
                self._paired = on_demand("tangent with interfaces")(matrix, assemble, pairs, self.supports.conditions)
                matrix, assemble = self._paired.matrix, self._paired.assemble
            if self.supports.sliding is not None:
                self._constraint = on_demand("constraints of slides")(matrix, self.supports.sliding)
            return matrix, assemble

    @property
    def matrix(self) -> PETSc.Mat:
        """The last assembled tangent; collective at the first access."""
        return self._matrix[0]

    @property
    def pattern(self) -> int:
        """Number of the pattern of the last assembled tangent, which interfaces change."""
        return 0 if self._paired is None else self._paired.pattern

    @property
    def note(self) -> str:
        """Remark on an unusual assembly of the tangent; empty if there is none."""
        return self._tangent.note

    def set_load(self, load: float) -> None:
        """Set the load factor λ of the weak form and its supports, or the share of the path from another state."""
        if self._path is not None:
            self._path = self._path[0], 1.0 - load
        self.weak_form.parameters.set_load(load if self._path is None else 1.0)
        self.supports.scale(load, self.weak_form.kinematics.sign)

    @property
    def is_on_path(self) -> bool:
        """True if the load factor leads from another state than the unloaded body."""
        return self._path is not None

    def begin_path(self) -> None:
        """Let the load factor lead from the present state, a solution for other loads, to the full load; collective."""
        self.end_path()
        self.set_load(1.0)
        self._forces(self.rhs)
        with self.rhs.localForm() as local:
            self._path = np.array(local.array), 1.0
        self.supports.begin_path(self.state.x.array)
        self.set_load(0.0)

    def begin_line(self, job: Job) -> None:
        """Let the load factor lead from the numbers of a job, with the present state as solution, to the present ones.

        All loads act in full on this path. Collective.
        """
        self.end_path()
        self.set_load(1.0)
        self.weak_form.begin_line(job)
        self.supports.begin_path(self.state.x.array)

    def begin_unloaded(self) -> None:
        """Let forces that press on the unloaded body at any load factor grow with it, on this path; collective.

        Load steps, however small, would begin far from equilibrium otherwise. A path from another state has them in it.
        """
        parameters, state = self.weak_form.parameters, self.state.x.array
        if self.is_on_path or not parameters.may_grow:
            return
        parameters.grow(growing=False)
        kept_state = state.copy()
        state[:] = 0.0
        self.weak_form.contacts.locate()
        largest = float(np.abs(self.forces(0.0)).max(initial=0.0))
        state[:] = kept_state
        parameters.grow(growing=self.comm.allreduce(largest, op=MPI.MAX) > _BALANCED)

    def end_path(self) -> None:
        """Let the load factor lead from the unloaded body again, with forces that act at any load factor."""
        parameters = self.weak_form.parameters
        parameters.grow(growing=False)
        if self._path is not None or parameters.is_on_line:
            self._path = None
            parameters.end_line()
            self.supports.end_path()

    def set_state(self, x: PETSc.Vec) -> None:
        """Set the state to ``x``."""
        x.copy(self.state.x.petsc_vec)
        self.state.x.scatter_forward()

    def set_values(self, values: npt.NDArray[np.float64]) -> None:
        """Set the state to values of the local unknowns, ghosts included."""
        self.state.x.array[:] = values

    def position(self) -> PETSc.Vec:
        """Return a copy of the present state."""
        x: PETSc.Vec = self.state.x.petsc_vec.copy()
        return x

    def residual(self, b: PETSc.Vec) -> None:
        """Assemble R at the present state and load into ``b``."""
        self._forces(b)
        with self.timings("residual"):
            if self.supports.prescribe_motion:
                self._add_lifting(b, self.state.x.array)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            self._set_held_rows(b, -self.supports.missing(self.state.x.array))

    def lift_rates(self, b: PETSc.Vec, rates: Sequence[npt.NDArray[np.float64]], load: float) -> None:
        """Lift as `lift` does for rates of prescribed values (of `Supports.rates`), at a load factor."""
        self.supports.prescribe(rates)
        self.lift(b)
        self.set_load(load)

    def lift_path_rates(self, b: PETSc.Vec, load: float) -> None:
        """Lift as `lift` does for the rates of prescribed values along the path, at a load factor."""
        self.supports.scale_rates(self.weak_form.parameters.load_rates(load))
        self.lift(b)
        self.supports.scale(load)

    def lift_region(self, b: PETSc.Vec, number: int, rate: Callable[[Floats], Floats], load: float) -> None:
        """Lift as `lift` does for rates (n, 3) at points of the region of one support, at a load factor."""
        self.supports.prescribe_on(number, rate)
        self.lift(b)
        self.supports.scale(load)

    def move_region(self, number: int, displacement: Callable[[Floats], Floats], load: float) -> None:
        """Prescribe displacements (n, 3), scaled, at points of the region of one support, at a load factor."""
        self.supports.move_region(number, displacement)
        self.supports.scale(load)

    def set_numbers(self, numbers: Iterable[tuple[int, str, float]]) -> None:
        """Set uniform quantities of laws and effects: by their place in the weak form and name, scaled."""
        for place, name, value in numbers:
            self.weak_form.parameters.set_number(place, name, value)

    def begin_contacts(self) -> None:
        """Begin a solve that finds pressures of contacts by iteration."""
        self.weak_form.contacts.begin()

    def resume_contacts(self, histories: Sequence[SlipHistory | None], scales: Scales) -> None:
        """Let slip of contacts go on from histories of a run before."""
        self.weak_form.contacts.resume(histories, scales)

    def locate_contacts(self) -> None:
        """Let contacts find what is nearest to the present state."""
        self.weak_form.contacts.locate()

    def begin_contact_step(self, load: float) -> None:
        """Let contacts find what is nearest, and slip begin with the last solution below a load factor."""
        self.weak_form.contacts.begin_step(load)
        self.locate_contacts()

    def end_contact_step(self, load: float) -> None:
        """Keep the present state, a solution at a load factor; slip of contacts may begin there."""
        self.weak_form.contacts.end_step(load)

    def follow_failure(self, outcome: Outcome) -> bool:
        """Let contacts adapt their penalties after a solve that failed; return whether it is to be made again."""
        return self.weak_form.contacts.follow_failure(outcome)

    def update_contacts(self) -> bool:
        """Update pressures of contacts, unless they have settled; return whether they had not."""
        return self.weak_form.contacts.update()

    def halve_contact_update(self) -> None:
        """Take back half of the last update of contacts, after which no solution was found."""
        self.weak_form.contacts.halve_update()

    def lift(self, b: PETSc.Vec) -> None:
        """Set ``b`` to the right-hand side of ``K x = b`` for the prescribed values, with the assembled K."""
        with self.timings("residual"):
            with b.localForm() as local:
                local.set(0.0)
                self._add_lifting(b, None)
                local.scale(-1.0)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            self._set_held_rows(b, self.supports.missing(None))

    def forces(self, load: float) -> npt.NDArray[np.float64]:
        """Return internal less external nodal forces (scaled) of the owned unknowns, without reactions of supports."""
        self.set_load(load)
        self._forces(self.rhs)
        self.rhs.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(self.rhs.array)

    def force_rates(self, direction: PETSc.Vec) -> npt.NDArray[np.float64]:
        """Return derivatives of `forces` along a direction of the state, at the present state and load; collective."""
        direction.copy(self._step.x.petsc_vec)
        self._step.x.scatter_forward()
        with self.timings("residual"):
            with self.rhs.localForm() as local:
                local.set(0.0)
                self._add_products(local.array)
            self.rhs.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(self.rhs.array)

    def tangent(self, *terms: Any) -> None:
        """Assemble K at the present state and load into ``matrix``, with the sum of some `term`."""
        with self.timings("tangent"):
            self._matrix[1](terms)
            if self._constraint is not None:
                self._constraint.apply(self._total_forces() if self.supports.is_curved else None)
        self.tangents += 1

    def term(self, term: Term) -> Any:
        """Return a bilinear form as `tangent` takes it; collective."""
        with self.timings("programs"):
            return self._tangent.term(term)

    def linearise(self, load: float) -> None:
        """Assemble K at the present state and a load factor."""
        self.set_load(load)
        self.tangent()

    def min_mesh_J(self) -> float:
        """Return the smallest determinant of the position map over all quadrature points; it must be positive."""
        return self._admissibility.min_mesh_J()

    def fault(self) -> Outcome | None:
        """Return the reason why the present state is not admissible, ``None`` if it is."""
        with self.timings("admissibility check"):
            return self._admissibility.fault()

    def fault_of_solution(self) -> Outcome | None:
        """Return the reason why the present state is not a physical solution, ``None`` if it may be one."""
        with self.timings("admissibility check"):
            return self._admissibility.fault_of_solution()

    def admissible_share(self, x: PETSc.Vec, step: PETSc.Vec) -> tuple[float, Outcome | None]:
        """Return the share of a step with which ``x - share * step`` is admissible, and the fault of a larger one.

        The share is that on which no point of the surface passes through an obstacle, halved at most ten times. The
        state is then the last one that was tried.
        """
        share, fault, trial = 1.0, None, x.duplicate()
        if passages := self.weak_form.passages:
            with self.timings("admissibility check"):
                self.set_state(x)
                start = passages.points()
                x.copy(trial)
                trial.axpy(-1.0, step)
                self.set_state(trial)
                if (share := passages.share(start)) < 1:
                    fault = Outcome.PASSED_THROUGH
        with self.timings("admissibility check"):
            for _ in range(10):
                x.copy(trial)
                trial.axpy(-share, step)
                self.set_state(trial)
                if (new_fault := self._admissibility.fault()) is None:
                    break
                fault, share = new_fault, share / 2
        trial.destroy()
        return share, fault

    def destroy(self) -> None:
        """Free PETSc objects."""
        if self._constraint is not None:
            self._constraint.destroy()
            self._constraint = None
        if self._paired is not None:
            self._paired.destroy()
        elif "_matrix" in self.__dict__:
            self.matrix.destroy()
        if self.director is not None:
            self.director.destroy()
        self.tangents = 0
        self.rhs.destroy()

    def _forces(self, b: PETSc.Vec) -> None:
        with self.timings("residual"), b.localForm() as local:
            local.set(0.0)
            fem_petsc.assemble_vector(b, self._residual)
            for pair in self.weak_form.contacts.stiff:
                pair.add_forces(local.array)
            if self._path is not None:
                forces, share = self._path
                local.array[:] -= share * forces

    def _total_forces(self) -> npt.NDArray[np.float64]:
        """Return nodal forces of the owned unknowns, without reactions of supports."""
        b = self.rhs.duplicate()  # PETSc may hold a residual in `rhs`
        self._forces(b)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        forces = np.array(b.array)
        b.destroy()
        return forces

    def _set_held_rows(self, b: PETSc.Vec, values: npt.NDArray[np.float64]) -> None:
        """Set the part of ``b`` in which nodes are held to local ``values``, which are zero elsewhere."""
        forces: npt.NDArray[np.float64] = b.array
        self.supports.free(forces)
        forces += self.supports.row_values(values)[: len(forces)]

    def _add_lifting(self, b: PETSc.Vec, x: npt.NDArray[np.float64] | None) -> None:
        """Add ``K (ū - x)`` with prescribed values ``ū``; ``ū - x`` is zero for free unknowns."""
        missing = self.supports.missing(x)
        if not self.comm.allreduce(missing.any(), op=MPI.LOR):  # after the first full step
            return
        self._step.x.array[:] = missing
        with b.localForm() as local:
            self._add_products(local.array)

    def _add_products(self, forces: npt.NDArray[np.float64]) -> None:
        """Add the tangent without supports, times `_step`, to forces on the local unknowns."""
        fem.assemble_vector(forces, self._step_form)
        for pair in self.weak_form.contacts.stiff:
            pair.add_products(self._step.x.petsc_vec, forces)

    @cached_property
    def _step(self) -> fem.Function:
        return fem.Function(self.weak_form.unknowns.space)

    @cached_property
    def _step_form(self) -> fem.Form:
        """The tangent times a step, which is cheaper to compile and to evaluate than the tangent."""
        with self.timings("programs"):
            return fem.form(ufl.derivative(self.weak_form.residual, self.state, self._step))


def _multiply_without_inodes() -> None:
    """Set PETSc's option to multiply matrices row by row, in 0.6 of the time of rows unrolled by threes.

    It holds for all later matrices, since matrices of multigrid read options without a prefix only.
    """
    options = PETSc.Options()
    if not options.hasName("mat_no_inode"):
        options.setValue("mat_no_inode", True)
