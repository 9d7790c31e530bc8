"""Interface of unknown numbers of loads, supports or paths, with as many equations for them."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from inspect import isabstract
from typing import Any, ClassVar

import numpy as np
from petsc4py import PETSc

from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.model.discrete_model import DiscreteModel


class Border(ABC):
    """Unknown numbers q on which the equilibrium ``R(x, q) = 0`` depends, and equations ``C(x, q) = 0`` for them.

    A subclass is registered, and taken for each job for which `of_job` returns some. Methods are collective.

    Attributes:
        order: of a kind among all unknown numbers.
        count: number of unknowns, and of equations.
        least: displacement (scaled) that rounding errors of C let count as none.
        least_load: load factor below which the numbers cannot be put in.
        load: the load factor, if that is the number; such a border is the last one.
    """

    count: int
    least: float = 0.0
    least_load: float = 0.0
    load: float | None = None
    order: ClassVar[int]

    @classmethod
    @abstractmethod
    def of_job(cls, job: Job, equations: DiscreteModel, system: System) -> "Iterable[Border]":
        """Return the unknown numbers of this kind of a job, on the mesh as it lies."""

    @abstractmethod
    def reports(self, load: float) -> Sequence[ConstraintReport]:
        """Return the reports of the present state, a solution at a load factor, with as many numbers in order."""

    def adopt(self, reports: Sequence[ConstraintReport]) -> None:
        """Take the numbers of a solution at full load, which the system is in, and put them in."""
        self.recover(1.0)

    @property
    def units(self) -> Floats:
        """SI values of scaled units of the numbers, as reports have them."""
        return np.ones(self.count)

    def equations_on_mesh(self, load: float) -> Floats:
        """Return C at the present state on the mesh as it lies now."""
        return self.equations(load)

    def rates(self, parameter: Parameter, job: Job) -> Floats:
        """Return the explicit derivatives of C at full load by a number of the job, zero for others."""
        return np.zeros(self.count)

    @abstractmethod
    def put(self, load: float) -> None:
        """Put the present numbers into the system, whose load factor is ``load``."""

    @abstractmethod
    def kept_numbers(self) -> Any:
        """Return the present numbers for `restore`."""

    @abstractmethod
    def restore(self, numbers: Any) -> None:
        """Take numbers that `kept_numbers` returned; they are not put into the system."""

    @abstractmethod
    def change(self, change: Floats) -> None:
        """Change the numbers by ``Δq``; they are not put into the system."""

    @abstractmethod
    def recover(self, load: float) -> None:
        """Set the numbers that the present state has, an equilibrium at this load factor, such as a checkpoint."""

    def begin_path(self) -> None:  # noqa: B027  (most need nothing)
        """Let C lead from its value at the present state, where the system's path begins, to the value at full load."""

    @abstractmethod
    def equations(self, load: float) -> Floats:
        """Return C at the present state."""

    def force_rates(self, rates: Floats) -> Floats:
        """Return the derivatives of C along rates of the nodal forces (scaled) of the owned unknowns."""
        return np.zeros(self.count)

    @abstractmethod
    def set_columns(self, columns: Sequence[PETSc.Vec], r: PETSc.Vec, load: float) -> None:
        """Set the columns to ``∂R/∂q`` at the present state, where R is ``r``."""

    @abstractmethod
    def linearise(self, load: float) -> Floats:
        """Return ``∂C/∂q`` (count, count) at the present state; `slopes` are from there until the next call."""

    def others_by_numbers(self) -> Floats | float:
        """Return the derivatives (n, count) of the equations of earlier borders by these numbers, as `set_columns`."""
        return 0.0

    def size(self, change: Floats) -> float:
        """Return the size of a change by which a correction is measured too, relative to the norm of the state."""
        return 0.0

    @abstractmethod
    def slopes(self, direction: PETSc.Vec) -> Floats:
        """Return the derivatives ``∂C/∂x`` along a direction."""

    def destroy(self) -> None:  # noqa: B027  (most have none)
        """Free PETSc objects."""


def kinds_of_borders() -> list[type[Border]]:
    """Return the registered kinds of unknown numbers in their order."""
    found, kinds = list(Border.__subclasses__()), list[type[Border]]()
    while found:
        kind = found.pop()
        found += kind.__subclasses__()
        kinds += [] if isabstract(kind) else [kind]
    return sorted(kinds, key=lambda kind: kind.order)
