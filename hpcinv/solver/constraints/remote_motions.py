"""Motion of a region under a remote load as six unknown numbers, with the balance of force and moment.

With the nodal forces ``r`` that hold the region, and arms ``a`` from the reference point to its nodes in the loaded
body, the equations are

    Σ r = λ f,      Σ a × r = λ m.

That is the principle of virtual work for rigid virtual motions of the loaded region: the force works on the
displacement of the reference point, the moment on the spin.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np
from petsc4py import PETSc

from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.job.support import RemoteLoad, Support
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.constraint_report import ConstraintReport, RemoteReport
from hpcinv.model.discrete_model import DiscreteModel
from hpcinv.solver.border import Border


class RemoteMotion(Border):
    """Motion of one region under a remote load, on the mesh as it lies; collective.

    Args:
        number: of the support in the job, which has this load or the motion that it causes.
    """

    count, order = 6, 0

    @classmethod
    def of_job(cls, job: Job, equations: DiscreteModel, system: System) -> Iterable[RemoteMotion]:
        return [cls(system, *item, equations.scales) for item in job.remote_loads.items()]

    def __init__(self, system: System, number: int, spec: RemoteLoad, scales: Scales) -> None:
        self._system, self._number, self._spec, self._length = system, number, spec, scales.length
        self._sign = system.weak_form.kinematics.sign
        self._unit = unit = scales.stress * scales.length**2
        self._load = np.concatenate([np.array(spec.force) / unit, np.array(spec.moment) / (unit * scales.length)])
        self._face = system.supports.remote_faces[number]
        self._face.begin(np.array(spec.about) / scales.length)

    def put(self, load: float) -> None:
        self._system.move_region(self._number, partial(self._face.displacement, sign=self._sign), load)

    def kept_numbers(self) -> tuple[Floats, Floats]:
        return self._face.turn, self._face.move

    def restore(self, numbers: tuple[Floats, Floats]) -> None:
        self._face.turn, self._face.move = numbers

    def change(self, change: Floats) -> None:
        self._face.change(change)

    def recover(self, load: float) -> None:
        self._face.recover(self._system.state.x.array[self._face.dofs], self._sign)

    def equations(self, load: float) -> Floats:
        return self._wrench(self._nodal_forces(load)) - load * self._load

    def set_columns(self, columns: Sequence[PETSc.Vec], r: PETSc.Vec, load: float) -> None:
        for column, unit in zip(columns, np.eye(6), strict=True):
            rate = partial(self._face.rate, sign=self._sign, change=unit)
            self._system.lift_region(column, self._number, rate, load)
            column.scale(-1.0)

    def linearise(self, load: float) -> Floats:
        by_numbers = np.zeros((6, 6))
        if self._sign > 0:  # the loaded body turns
            forces, arms = self._nodal_forces(load), self._face.arms(1)
            for k, spin in enumerate(np.eye(3)):
                by_numbers[3:, 3 + k] = self._face.sum(np.cross(np.cross(spin, arms), forces))
        return by_numbers

    def slopes(self, direction: PETSc.Vec) -> Floats:
        return self.force_rates(self._system.force_rates(direction))

    def force_rates(self, rates: Floats) -> Floats:
        return self._wrench(rates[self._face.dofs])

    def rates(self, parameter: Parameter, job: Job) -> Floats:
        place, is_own = parameter.place, parameter.where == f"{job.place('supports')}[{self._number}]"
        if isinstance(parameter.owner, Support) and place[0] == "remote" and parameter.where in job.owners and is_own:
            return self.number_rates(str(place[1]), int(place[2]))
        return np.zeros(self.count)

    def number_rates(self, key: str, axis: int) -> Floats:
        """Return the derivative of C at full load by a number (SI) of the load, with the present motion of the region.

        With another reference point, arms of moments are others.
        """
        rates = np.zeros(6)
        if key == "about":
            turn = self._face.turn if self._sign > 0 else np.eye(3)
            force = self._face.sum(self._nodal_forces(1.0))
            rates[3:] = -np.cross(turn[:, axis], force) / self._length
        else:
            place = axis if key == "force" else 3 + axis
            rates[place] = -1.0 / (self._unit if key == "force" else self._unit * self._length)
        return rates

    def reports(self, load: float) -> Sequence[ConstraintReport]:
        forces, arms = self._nodal_forces(load), self._face.arms(self._sign)
        missing = self._wrench(forces) - load * self._load
        sizes = [float(self._face.sum(np.linalg.norm(v, axis=1))) for v in (forces, np.cross(arms, forces))]
        parts = zip(np.split(missing, 2), sizes, strict=True)
        residual = max(float(np.linalg.norm(part)) / size if size else 0.0 for part, size in parts)
        motion = self._face.motion(self._sign, self._length)
        return [RemoteReport(self._face.region, self._number, self._spec, motion, residual)]

    def _nodal_forces(self, load: float) -> Floats:
        return np.asarray(self._system.forces(load)[self._face.dofs])

    def _wrench(self, forces: Floats) -> Floats:
        """Return force and moment of nodal forces (n, 3) on the region."""
        wrench: Floats = self._face.sum(np.concatenate([forces, np.cross(self._face.arms(self._sign), forces)], axis=1))
        return wrench
