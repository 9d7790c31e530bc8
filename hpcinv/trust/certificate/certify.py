"""Certificate of a run: all registered checks, in their order, for each solution."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.quantity_of_interest import QuantityOfInterest, QuantityValue
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.observer import SILENT, Observer, freeing, stop_if_asked
from hpcinv.trust.certificate.check import Certificate, Line
from hpcinv.trust.discretisation.estimate import Correction, Estimate
from hpcinv.trust.stability.forward_factors import ForwardFactors


@dataclass
class CheckedRun:
    """What checks judge, and what earlier checks found for later ones.

    Attributes:
        solutions: one, or both of a round trip; the certificate is on the body that the first one found.
        computed: values of the job's quantities of interest.
        estimate: of the first solution's discretisation error, if it has been made.
        observer: of the return solve, and of a solve in finer spaces; it is also asked whether to stop.
        rest_correction: for a further state, the correction of the rest shape by the estimate of the given one.
        deviation: standard deviation (m) of the shape by errors of the given surface, 0 if it is not known.
        announce: called with what a long check takes, when that is known.
        lines: of the checks that were made, by their kind.
        forward: factors of the forward tangent at the first solution.
    """

    equations: Equations
    solutions: Sequence[Solution]
    computed: Mapping[str, QuantityValue]
    estimate: Estimate | None = None
    observer: Observer = SILENT
    rest_correction: Correction | None = None
    deviation: float = 0.0
    announce: Callable[[str], None] = lambda _: None
    lines: dict[type[Check], Sequence[Line]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.solution = self.solutions[0]
        self.forward = ForwardFactors(self.equations, self.solution)
        self.has_unknown_loads = bool(self.solution.constraints)

    def free(self) -> None:
        """Free factors that checks have used; those that are needed again are made again."""
        self.forward.destroy()
        if self.solution.job.certificate.level != "off":  # derivatives can use multigrid
            self.equations.free_multigrid()


class Check(ABC):
    """A check, which yields lines of the certificate. A module of `hpcinv.trust.certificate` registers it.

    Attributes:
        name: shown while it is made.
        order: checks are made in this order. Later ones may use the lines, estimate and factors of earlier ones.
        has_switch: whether the job has a switch for it, and its line says that it is off.
    """

    name: ClassVar[str]
    order: ClassVar[int]
    has_switch: ClassVar[bool] = False

    def applies(self, run: CheckedRun) -> bool:
        """Return whether it is made; without an override, unless the job switches its certificate off."""
        return self.has_switch or run.solution.job.certificate.level != "off"

    @abstractmethod
    def lines(self, run: CheckedRun) -> Iterable[Line]:
        """Return its lines; collective."""


def checks() -> list[type[Check]]:
    """Return all registered checks in their order."""
    return sorted(Check.__subclasses__(), key=lambda kind: kind.order)


def certify(run: CheckedRun, begins: Callable[[str], None] = lambda _: None) -> tuple[Certificate, Estimate | None]:
    """Check the solutions of a run; collective.

    Args:
        begins: called with the name of each check when it begins.

    Returns:
        The certificate, and the estimate of the discretisation error, if one was made.

    Raises:
        Stopped: on all ranks, before a check or within a long one, if the observer asks to stop.
    """
    equations = run.equations
    comm = equations.body.mesh.comm
    equations.put(run.solution)
    with equations.timings.as_one("certificate"), freeing(run.free):
        for kind in checks():
            check = kind()
            if not check.applies(run):
                continue
            # Also since the check before may have been cut short, so that its lines say nothing.
            stop_if_asked(comm, run.observer)
            begins(check.name)
            started = time.perf_counter()
            made = [replace(line, state=run.solution.state) for line in check.lines(run)]
            seconds = comm.allreduce(time.perf_counter() - started, op=MPI.MAX)
            run.lines[kind] = [replace(line, seconds=seconds) for line in made[:1]] + made[1:]
    return Certificate(tuple(line for made in run.lines.values() for line in made)), run.estimate


def certify_all(
    equations: Sequence[Equations],
    solutions: Sequence[Solution],
    quantities: Sequence[QuantityOfInterest],
    values: Mapping[str, QuantityValue],
    estimate: Estimate | None,
    deviations: Mapping[str, float],
    detail: Callable[[str], None],
    observer: Observer,
) -> tuple[Certificate, Estimate | None]:
    """Check the solutions: together if they belong to one analysis, else state by state; collective.

    Args:
        equations: of each solution.
        quantities: quantities of interest of the job.
        values: their values, by the names of the parts where a quantity is between two states.
        observer: as of `CheckedRun`.
        deviations: standard deviations (m) of shapes by errors of the given surface, by state, where they are known.
    """
    if not solutions[0].state:
        deviation = deviations.get("", 0.0)
        run = CheckedRun(equations[0], solutions, values, estimate, observer, deviation=deviation, announce=detail)
        return certify(run, detail)
    lines: list[Line] = []
    for own_equations, solution in zip(equations, solutions, strict=False):
        state_quantities = {q.name: values[q.name] for q in solution.job.quantities}
        detail(solution.state)
        rest_correction = estimate.correction if estimate and not solution.is_on_given_mesh else None
        deviation = deviations.get(solution.state, 0.0)
        run = CheckedRun(own_equations, [solution], state_quantities, None, observer, rest_correction, deviation)
        certificate, solution_estimate = certify(run)
        lines += certificate.lines
        estimate = (
            estimate.joined(solution_estimate) if estimate and solution_estimate else estimate or solution_estimate
        )
    return Certificate(tuple(lines)), estimate.of_quantities(quantities) if estimate else None
