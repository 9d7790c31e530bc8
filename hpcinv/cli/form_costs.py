"""Parts of a job and their costs, measured on the job's mesh.

The cost of an effect is the cost of the whole job less the cost without it, so that it holds for effects that
add an integral as well as for those that change the law's.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import dolfinx.fem.petsc as fem_petsc
import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.code_cache import kept_in
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.model.assembly.tangent import tangent_of
from hpcinv.model.weak_form import WeakForm
from hpcinv.solver.equations import Equations

_ROUNDS = 7  # the fastest counts, since disturbances only lengthen a measurement


@dataclass(frozen=True)
class PartCosts:
    """One part of the job: its contributions to the forms, and its costs.

    Attributes:
        made: seconds of processor time to make the programs of residual and tangent.
        residual, tangent: seconds of processor time to assemble each of them once.
    """

    name: str
    integrals: Counter[str]
    constants: int
    fields: int
    made: float
    residual: float
    tangent: float

    @property
    def assembly(self) -> float:
        return self.residual + self.tangent

    def more_than(self, other: PartCosts, name: str) -> PartCosts:
        """Return the part that is in these and not in the others."""
        return PartCosts(name, **{key: mine - vars(other)[key] for key, mine in vars(self).items() if key != "name"})


@dataclass(frozen=True)
class Explanation:
    """Result of `explain`; ``rows`` are the laws and then each effect, ``total`` is the whole job.

    ``factorization`` (or preconditioner) and ``solution`` are the seconds that the linear solver takes in one Newton
    iteration.
    """

    direction: str
    cells: int
    displacements: int
    pressures: int
    families: tuple[str, ...]
    rows: tuple[PartCosts, ...]
    total: PartCosts
    linear_solver: str
    factorization: float
    solution: float

    @property
    def iteration(self) -> float:
        """Seconds of one Newton iteration with a new tangent."""
        return self.total.assembly + self.factorization + self.solution


def explain(job: Job, comm: MPI.Intracomm, note: Callable[[str], None] = lambda text: None) -> Explanation:
    """Measure the weak form of a job in the direction or state that is solved first; collective.

    Raises:
        MeshError: on all ranks, if the mesh lacks what the job names.
    """
    body = build_body(job.mesh, job.regions, comm, resolve=job.resolve, degree=job.discretisation.displacement)
    job = job.plan[0].job
    equations = Equations(job, body, Timings())
    equations.check_supports()
    direction = job.directions[0]

    def variant(*effects: Any) -> WeakForm:
        return Equations(job.model_copy(update={"effects": effects}), body, Timings()).weak_form(direction)

    everything = equations.weak_form(direction)
    weak_forms = {"the whole job": everything, "the laws alone": variant()}
    for i, (name, _) in enumerate(job.named_effects):
        others = (*job.effects[:i], *job.effects[i + 1 :])
        weak_forms[f"the job without {name}"] = variant(*others) if others else weak_forms["the laws alone"]
    made: dict[WeakForm, _Programs] = {}
    for name, weak_form in weak_forms.items():
        if weak_form not in made:
            note(f"making programs of {name}")
            made[weak_form] = _Programs(weak_form, equations.supports.conditions)
    measured = _measured(made)
    total, laws, *reduced_costs = (_part(weak_form, *measured[weak_form]) for weak_form in weak_forms.values())
    rows = [replace(laws, name=_laws(job))]
    for (where, effect), reduced in zip(job.named_effects, reduced_costs, strict=True):
        rows.append(total.more_than(reduced, f"{where} {effect.effect}"))  # type: ignore[attr-defined]
    linear_solver, factorization, solution = _linear_solver(equations, everything)
    displacements = equations.unknowns.displacement_space.dofmap
    n = displacements.index_map.size_global * displacements.index_map_bs
    return Explanation(
        direction=direction,
        cells=body.mesh.topology.index_map(3).size_global,
        displacements=n,
        pressures=equations.unknowns.size - n,
        families=tuple(name.removeprefix("fibres.") for name in job.families),
        rows=tuple(rows),
        total=total,
        linear_solver=linear_solver,
        factorization=factorization,
        solution=solution,
    )


class _Programs:
    """Residual and tangent, with programs that are made without a cache."""

    def __init__(self, weak_form: WeakForm, conditions: Sequence[fem.DirichletBC]) -> None:
        space, comm = weak_form.unknowns.space, weak_form.unknowns.mesh.comm
        directory = tempfile.TemporaryDirectory(prefix="hpcinv-explain-")
        with kept_in(Path(comm.bcast(directory.name))):
            comm.Barrier()
            start = _processor_seconds()
            self.residual, tangent = fem.form(weak_form.residual), tangent_of(weak_form)
            self.seconds = comm.bcast(_processor_seconds() - start)  # rank 0 makes the programs
        directory.cleanup()  # they are loaded
        self.vector = fem_petsc.create_vector(space)
        _, self.assemble_tangent = tangent.create_matrix(conditions)

    def assemble_residual(self) -> None:
        with self.vector.localForm() as local:
            local.set(0.0)
        fem_petsc.assemble_vector(self.vector, self.residual)


def _processor_seconds() -> float:
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _measured(made: Mapping[WeakForm, _Programs]) -> dict[WeakForm, tuple[float, float, float]]:
    """Measure assembly times, all weak forms in turn, so that a disturbance affects all of them; return all seconds."""
    best = {weak_form: [np.inf, np.inf] for weak_form in made}
    for _ in range(_ROUNDS):
        for weak_form, forms in made.items():
            for i, assemble in enumerate((forms.assemble_residual, forms.assemble_tangent)):
                best[weak_form][i] = min(best[weak_form][i], _seconds(forms.vector.comm.tompi4py(), assemble))
    return {weak_form: (forms.seconds, best[weak_form][0], best[weak_form][1]) for weak_form, forms in made.items()}


def _linear_solver(equations: Equations, weak_form: WeakForm) -> tuple[str, float, float]:
    """Return the name of the linear solver, and its seconds for one factorization (preconditioner) and one solution."""
    equilibrium = equations.equilibrium(weak_form)
    system, linear = equilibrium.system, equilibrium.linear
    comm, b = system.comm, system.rhs
    x = b.duplicate()
    times = []
    for _ in range(3):  # the first includes the symbolic analysis
        system.linearise(1.0)
        system.residual(b)
        factorization = _seconds(comm, linear.factorize)
        times.append((factorization, _seconds(comm, lambda: linear.back_substitute(b, x))))
    name = linear.configuration.name
    x.destroy()
    equilibrium.destroy()
    return name, min(f for f, _ in times[1:]), min(s for _, s in times[1:])


def _seconds(comm: MPI.Intracomm, work: Callable[[], object]) -> float:
    """Return the processor time of the slowest rank, which other work on the machine changes little; collective."""
    comm.Barrier()
    start = time.process_time()
    work()
    return float(comm.allreduce(time.process_time() - start, op=MPI.MAX))


def _part(weak_form: WeakForm, *seconds: float) -> PartCosts:
    """Return contents and costs of a weak form."""
    form = weak_form.residual
    kinds = {(i.integral_type(), i.subdomain_id()) for i in form.integrals()}
    integrals = Counter(_KINDS[kind] for kind, _ in kinds)
    constants = sum(int(np.prod(c.ufl_shape)) for c in form.constants())
    return PartCosts("whole job", integrals, constants, len(form.coefficients()) - 1, *seconds)


_KINDS = {"cell": "volume", "exterior_facet": "surface"}


def _laws(job: Job) -> str:
    named = [(where, law.law) for where, law in job.laws.items()]  # type: ignore[attr-defined]
    return ", ".join(law if where == "material" else f"{law} in {where.split('.', 1)[1]}" for where, law in named)
