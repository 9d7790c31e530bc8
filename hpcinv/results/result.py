"""What a run gives back: the recovered shape, the fields that belong to it, and how it was reached."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hpcinv.parallel.runtime import MPI

if TYPE_CHECKING:
    from dolfinx.fem import Function

    from hpcinv.accuracy import Record
    from hpcinv.certificate import Certificate, Estimate
    from hpcinv.effects import Direction
    from hpcinv.job.job import Job
    from hpcinv.mesh import Body
    from hpcinv.results.totals import Totals
    from hpcinv.sensitivity.analysis import Sensitivities
    from hpcinv.solver.equilibrium import Solve
    from hpcinv.solver.linear.selection import Used

type Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Leg:
    """One direction of an analysis, solved.

    Attributes:
        mesh_nodes: coordinates of the local geometry nodes of the mesh it was solved on, (n, 3) in m.
        u: displacement ``x - X`` at those nodes, (n, 3) in m.
        displacement: the same as a finite-element function, in m.
        pressure: pressure of the mixed form in Pa, else ``None``.
        J: mean volume ratio of each cell, piecewise constant.
        cauchy_stress: mean Cauchy stress of each cell in Pa, piecewise constant, (3, 3).
        J_range: smallest and largest volume ratio at any quadrature point.
        strain_energy: energy stored in the body, in J.
        solves: every solve of the method, failed ones too.
        load: load factor at which it is a solution, 1 if all went well.
        linear: the linear solver, where one was asked.
    """

    direction: Direction
    mesh_nodes: Floats
    u: Floats
    displacement: Function
    pressure: Function | None
    J: Function
    cauchy_stress: Function
    J_range: tuple[float, float]
    strain_energy: float
    solves: tuple[Solve, ...]
    load: float = 1.0
    linear: Used | None = None

    @property
    def sign(self) -> int:
        """The other body is the mesh moved by ``sign * u``."""
        return 1 if self.direction == "forward" else -1

    @property
    def other_nodes(self) -> Floats:
        """Coordinates of the nodes in the body that was looked for, (n, 3) in m."""
        return self.mesh_nodes + self.sign * self.u

    @property
    def reference_nodes(self) -> Floats:
        return self.mesh_nodes if self.direction == "forward" else self.other_nodes

    @property
    def current_nodes(self) -> Floats:
        return self.other_nodes if self.direction == "forward" else self.mesh_nodes

    @property
    def largest_displacement(self) -> float:
        """Over the nodes of all ranks, in m; collective."""
        comm = self.displacement.function_space.mesh.comm
        return float(comm.allreduce(float(np.linalg.norm(self.u, axis=1).max(initial=0.0)), op=MPI.MAX))

    @property
    def factorizations(self) -> int:
        return sum(s.factorizations for s in self.solves)


@dataclass(frozen=True, repr=False)
class Result:
    """A finished run.

    Attributes:
        legs: one for each direction that was solved; the first is on the mesh that the job gives.
        certificate: what the answer is worth.
        quantities: the job's quantities of interest by name.
        errors: distances (``comparison``): from the job's expected shape, and what a round trip failed to close.
        estimate: estimated discretisation errors, ``None`` if they were not asked for.
        sensitivities: derivatives by numbers of the job, ``None`` if it asks for none.
        statistics: what ``summary.json`` holds.
        directory: where it was written, if anywhere.
        accuracy: how the job's demands on it were met, if it has any.
        totals: size, volume, mass and load of the meshed part.
    """

    job: Job
    body: Body
    legs: tuple[Leg, ...]
    certificate: Certificate
    quantities: Mapping[str, Any] = field(default_factory=dict)
    errors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    estimate: Estimate | None = None
    sensitivities: Sensitivities | None = None
    statistics: Mapping[str, Any] = field(default_factory=dict)
    directory: Path | None = None
    accuracy: Record | None = None
    totals: Totals | None = None

    @property
    def shape(self) -> Floats:
        """Coordinates of the local geometry nodes in the body that was looked for, (n, 3) in m."""
        return self.legs[0].other_nodes

    def to_dict(self) -> dict[str, Any]:
        """All numbers of the run as plain data, the same on every rank: what ``summary.json`` holds."""
        return copy.deepcopy(dict(self.statistics))

    def __repr__(self) -> str:
        """Five lines; not collective."""
        statistics = self.statistics
        mesh, leg = statistics.get("mesh", {}), statistics.get("legs", [{}])[0]
        lines = statistics.get("certificate", {}).get("lines", ())
        doubts = [line["name"] for line in lines if line["verdict"] not in ("pass", "not checked")]
        values = ", ".join(f"{name} = {_short(value)}" for name, value in list(self.quantities.items())[:_SHOWN])
        more = len(self.quantities) - _SHOWN
        return "\n".join(
            (
                f"Result of '{self.job.job}': {self.job.analysis} analysis, {statistics.get('status', 'not finished')}",
                f"  mesh: {mesh.get('cells')} cells, {mesh.get('unknowns')} unknowns;"
                f" largest displacement {_short(leg.get('largest_displacement'))} m",
                f"  certificate: {self.certificate.verdict.value}" + (f" ({'; '.join(doubts)})" if doubts else ""),
                f"  quantities: {values or 'none'}" + (f", and {more} more" if more > 0 else ""),
                f"  directory: {self.directory or 'none, nothing was written'}",
            )
        )


_SHOWN = 6  # quantities in a line


def _short(value: Any) -> str:
    """A number or a vector with a few digits."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_short, value))}]"
    return "not known" if value is None else f"{value:.6g}"
