"""What the verification tests share: jobs written as data, their models, errors of fields measured by quadrature."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from helpers.command_line import NO_CERTIFICATE
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job, parse
from hpcinv.mesh import Body, build_body
from hpcinv.model.spaces import Unknowns
from hpcinv.model.weak_form import WeakForm
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SILENT

HERE = Path(__file__).parents[1] / "job.yaml"  # files of jobs are as if it lay there
BOX = "../meshes/box.py"


def digits(values: Any, form: str = ".1e") -> str:
    """Nested numbers as text with few digits."""
    if isinstance(values, (int, float, np.number)):
        return format(values, form)
    return f"[{', '.join(digits(value, form) for value in values)}]"


def job(**data: Any) -> Job:
    """A job as its file would give it; paths in it start from this directory.

    Tests of the physics switch the certificate off to save time; tests of the certificate switch it on.
    """
    return parse({"certificate": NO_CERTIFICATE, **data}, HERE)


class Solved:
    """The first solution of a job, with its weak form and body."""

    def __init__(self, job: Job, comm: MPI.Intracomm) -> None:
        self.job = job
        degree = job.discretisation.displacement
        self.body: Body = build_body(job.mesh, job.regions, comm, resolve=job.resolve, degree=degree)
        self.model = Equations(job, self.body, Timings())
        self.solves = self._solve(0)
        self.kinematics = self.weak_form.kinematics
        self.length = self.constant(self.body.length_scale)
        self.x = ufl.SpatialCoordinate(self.body.mesh) * self.length

    def _solve(self, direction_index: int) -> list[Solve]:
        self.weak_form: WeakForm = self.model.weak_form(self.job.directions[direction_index])
        solves = solve_direction(self.model, self.job.directions[direction_index], UNLOADED, SILENT).solves
        self.model.destroy()  # its matrices hold communicators, and a process has few of them
        assert solves[-1].outcome.accepted, solves[-1].outcome
        return list(solves)

    def again(self) -> np.ndarray:
        """Displacement (scaled) at the nodes after the second direction, solved on the body that the first found."""
        u = self.model.unknowns.geometry_values(self.model.state().displacement)
        self.model.put(self.model.unloaded(nodes=self.body.nodes + self.kinematics.sign * u))
        self._solve(1)
        return self.model.unknowns.geometry_values(self.model.unknowns.displacement())

    def constant(self, values: Any) -> fem.Constant:
        """Numbers that a kernel reads, so that other numbers need no other kernel."""
        return fem.Constant(self.body.mesh, np.asarray(values, dtype=np.float64))

    @property
    def displacement(self) -> Any:
        """Displacement in m."""
        return self.model.unknowns.u * self.length

    def integral(self, integrand: Any, degree: int = 8) -> float:
        """Integral over the mesh, in scaled lengths, by a quadrature of its own."""
        form = fem.form(integrand * ufl.dx(self.body.mesh, degree=degree))
        return float(self.body.mesh.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM))

    def relative_error(self, computed: Any, exact: Any) -> float:
        """Relative L² error of a field; the exact one must not vanish."""
        error = self.integral(ufl.inner(computed - exact, computed - exact))
        return float(np.sqrt(error / self.integral(ufl.inner(exact, exact))))

    @property
    def cauchy_stress(self) -> Any:
        """Cauchy stress in Pa, of a body of one law."""
        ((stress, _),) = self.weak_form.cauchy_stress
        return stress * self.constant(self.model.scales.stress)

    @property
    def strain_energy(self) -> float:
        """Energy in J."""
        return self.weak_form.means().strain_energy * self.model.scales.stress * self.body.length_scale**3


def box(divisions: Sequence[int] = (2, 2, 2), **parameters: Any) -> dict[str, Any]:
    """A unit cube."""
    nx, ny, nz = divisions
    return {"file": BOX, "parameters": {"nx": nx, "ny": ny, "nz": nz, **parameters}}


def deform(unknowns: Unknowns) -> None:
    """Set the state to smooth fields that do not solve the problem."""
    state = unknowns.state
    parts = [state] if unknowns.p is None else [state.sub(0), state.sub(1)]
    parts[0].interpolate(lambda x: 0.05 * np.stack([np.sin(2 * x[1]), x[0] * x[2], np.cos(x[0] + x[1])]))
    for pressure in parts[1:]:
        pressure.interpolate(lambda x: 0.3 * np.cos(x[0] - 2 * x[2]))
    state.x.scatter_forward()
