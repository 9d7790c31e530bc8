"""Search for a discretisation whose quantities of interest are as accurate as the job demands."""

import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress

from hpcinv.base.parallel.left_for_run import available
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.signals import signals_recorded
from hpcinv.base.parallel.timings import Timings, peak
from hpcinv.base.quantity.written_units import written_units
from hpcinv.errors import Interrupted, MeshError
from hpcinv.job.job import Job
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.mesh import Body
from hpcinv.model.cell_layers import layers_of_cells
from hpcinv.model.spaces import Unknowns
from hpcinv.solver.observer import Observer, Stopped
from hpcinv.trust.accuracy.accuracy_record import AccuracyRecord, AccuracyStep, Ending
from hpcinv.trust.accuracy.assessment import UNTESTED, Assessment, Finding, assess, distance, hindsight
from hpcinv.trust.accuracy.decision import decide
from hpcinv.trust.accuracy.meshes import Meshes, Variant
from hpcinv.trust.accuracy.moving_regions import cut_regions, facet_shares, moved
from hpcinv.trust.accuracy.refinement_forecast import HIGHEST_DEGREE, RefinementForecast, Step
from hpcinv.trust.accuracy.trial import Trial, attempt
from hpcinv.trust.certificate.volume import WARN, unexplained_strain
from hpcinv.trust.discretisation.finer_solid import one_degree_more
from hpcinv.trust.discretisation.singular_edges import singular_edges

USABLE = 0.7  # share of the free memory before the first mesh is made
LEAST = 50e6  # bytes; from less memory in use, no prediction is made
MOST_STEPS = 15
MOST_TRIES = 5  # meshes that are made to find one within the limit of unknowns; more take longer to find none
SAFELY = 0.5  # share of the limit up to which unknowns are not counted; if larger, a mesh may exceed the limit
INTERFACE = 1.0  # order of errors by the border of a region that moves with the mesh; a larger one promises less error
MOSTLY = 0.5  # share of the error at singular edges from which lines name them; a larger one names fewer
TESTED = 0.1  # share of the error at singular edges from which one mesh proves nothing; a larger one trusts more
AVERAGES = ("mean", "rms", "integral")
TOLERANCE, FINEST = 1e-3, 1e-15  # tolerance of the solver as a share of the demand, and its smallest value


class RefinementMemory:
    """Memory of all ranks that a run has used so far, as a limit of the number of unknowns; collective.

    Args:
        fill: exponent of the memory by unknowns, as in `BodyKind`.
    """

    def __init__(self, comm: MPI.Intracomm, fill: float) -> None:
        self.comm, self.fill = comm, fill
        self.free = USABLE * available(comm) / comm.size
        self.first_peak = peak()

    def limit(self, unknowns: int) -> int:
        """Return the largest number of unknowns; ``unknowns`` is the largest number so far, also of an estimate."""
        used = max(peak() - self.first_peak, LEAST)
        ratio = self.comm.allreduce(self.free / used, op=MPI.MIN)
        return int(unknowns * ratio ** (1 / self.fill))


class Search:
    """Search for a discretisation that meets the demands of a job; its methods are collective.

    Attributes:
        best: the discretisation with the smallest estimated error, or the last one if none reached the full load.
        promise: assessment of the best discretisation.
        chosen: number of the row of the best discretisation.
    """

    best: Trial
    promise: Assessment
    chosen: int

    def __init__(
        self, job: Job, comm: MPI.Intracomm, timings: Timings, note: Callable[[str], None], observer: Observer
    ) -> None:
        self.job, self.comm, self.timings = job, comm, timings
        self.note, self.observer = note, observer
        self.memory = RefinementMemory(comm, job.mesh.kind.fill)
        self.meshes = Meshes(job, comm)
        self.unseen_order: float | None = None
        degree = job.discretisation.displacement
        self.highest = max(HIGHEST_DEGREE, degree) if job.mesh.kind.raises_degree else degree
        self.last: Trial | None = None
        self.findings: list[Finding] = []
        self.assessments: list[Assessment] = []
        self.steps: list[Step] = []
        self.rows: list[AccuracyStep] = []
        self.shares: Mapping[str, float] = {}
        self.moving: set[str] = set()

    def _sampled(self) -> list[QuantityOfInterest]:
        """Return the demanded quantities on regions that are not integrated."""
        demanded = [q for q in self.job.quantities if q.name in self.job.accuracy and q.on is not None]
        return [q for q in demanded if not (q.uses_quadrature and q.reduce in AVERAGES)]

    def run(self) -> tuple[AccuracyRecord | None, Trial]:
        """Solve until the demands are met or cannot be met; return the record and the best trial.

        There is no record if the full load was not reached on the job's mesh.

        Raises:
            MeshError: the same on every rank.
            Interrupted: a stop was requested on some rank.
        """
        begin, first = time.perf_counter(), self.meshes.first
        body = self._build(first)
        one_shape = self.meshes.have_one_shape(body)
        if not one_shape:  # straight cells would have more error of their geometry than of all else
            body = self._curved(body)
        sampled = self._sampled()
        averaged = any(q.reduce in AVERAGES for q in sampled)  # over nodes, so that the distribution of nodes matters
        if averaged:
            self.unseen_order = 1.0
        elif sampled or self.job.regions or not one_shape:
            self.unseen_order = 2.0
        self.may_mark = body.source.kind == "tetrahedron" and one_shape and not averaged
        needs_two = self.unseen_order is not None or self._has_singular_edges(body)
        if needs_two and (coarser := self.meshes.coarser()) is not None:
            with suppress(MeshError):  # it may lack regions of the job
                self._attempt(coarser, self._build(coarser), self._degree)
        try:
            if not self._attempt(first, body, self._degree):
                return None, self.best
            with signals_recorded():
                ending = self._improve()
        except Stopped:  # what an earlier mesh gave is written
            ending = Ending.STOPPED
        seconds = time.perf_counter() - begin
        bounds, certain = self.promise.bounds, self.promise.certain
        return AccuracyRecord(self.job.accuracy, self.rows, self.chosen, bounds, certain, ending, seconds), self.best

    def _curved(self, body: Body) -> Body:
        """Return the job's mesh with curved cells, if it may have them and none is inside out."""
        straight = self.meshes.job
        if body.source.degree == 1 and self.meshes.curve():
            try:
                return self._build(self.meshes.first)
            except MeshError:
                self.meshes.job = straight
        return body

    def _has_singular_edges(self, body: Body) -> bool:
        """Return whether an estimate on one mesh may prove nothing."""
        with suppress(MeshError):  # of supports without facets: the model says more about them
            return singular_edges(self.job, body) is not None
        return False

    def _improve(self) -> Ending:
        """Try better discretisations; raises ``Stopped`` on all ranks if that is asked for."""
        while self.assessments[-1].excess > 1:
            if self.assessments[-1].layer_excess > 1:
                return Ending.LAYER
            if len(self.rows) >= MOST_STEPS:
                return Ending.STEPS
            choice = self._next()
            if choice is None:
                return Ending.LIMIT
            last_trial = self.last
            if not self._attempt(*choice):
                return Ending.UNSOLVED
            self._check_degree(last_trial)
        return Ending.MET

    def _check_degree(self, last_trial: Trial | None) -> None:
        """Return to the lower degree if a higher one has not reduced the error, which happens on some meshes."""
        (*_, earlier, last), (*_, lower, higher) = self.assessments, self.steps
        if higher.degree > lower.degree and last.excess > earlier.excess:
            self.highest, self.last = lower.degree, last_trial
            for known in (self.findings, self.assessments, self.steps):
                known.pop()

    def _attempt(self, variant: Variant, body: Body, degree: int) -> bool:
        """Solve and estimate one discretisation; return ``False`` if it did not reach the full load."""
        begin, last_trial = time.perf_counter(), self.last
        try:
            trial = attempt(self._job_in(variant, degree), variant, body, self.timings, self.observer, last_trial)
        except Stopped:
            if self.assessments:
                raise
            raise self._interrupted() from None
        if not self.assessments:
            self.best = trial
        if trial.estimate is None:
            return False
        corrected = {name: trial.estimate.corrected[name] for name in self.job.accuracy}
        values = {name: trial.quantities[name] for name in self.job.accuracy}
        mesh = 0 if last_trial is None else self.findings[-1].mesh + (last_trial.variant is not variant)
        limit, is_singular = trial.estimate.limit, not self.job.accuracy.keys().isdisjoint(trial.estimate.unreliable)
        ratio, is_reliable = self._ratio(variant, degree), (limit is None or limit.is_reliable) and not is_singular
        needs_test = self._needs_test(trial)
        self.findings.append(Finding(mesh, variant.size, degree, values, corrected, ratio, is_reliable, needs_test))
        previous = self.assessments[-1] if self.assessments else None
        if last_trial is None or last_trial.variant is not variant:
            shares = facet_shares(body)
            self.moving |= moved(self.shares, shares) | set(cut_regions(body, self.job.regions))
            self.shares = shares
        if self.moving:
            self.unseen_order = INTERFACE
        layer = {name: error.size for name, error in trial.estimate.layer.items() if name in self.job.accuracy}
        assessment = assess(self.findings, self.job.accuracy, self.unseen_order, previous, layer)
        self.last = trial
        self.assessments.append(assessment)
        self.steps.append(trial.step)
        self._add_row(trial, time.perf_counter() - begin)
        if len(self.assessments) == 1 or assessment.excess <= self.promise.excess:
            self.best, self.promise, self.chosen = trial, assessment, len(self.rows) - 1
        return True

    def _needs_test(self, trial: Trial) -> bool:
        """Return whether an estimate proves nothing by itself; unexplained volumes only count on the first mesh."""
        assert trial.estimate is not None
        if trial.estimate.limit is not None and trial.estimate.limit.share >= TESTED:
            return True
        return not self.findings and (unexplained_strain(trial.equations, trial.solution) or 0.0) > WARN

    def _ratio(self, variant: Variant, degree: int) -> float:
        """Return the least ratio of errors to the last step's errors that singular edges allow, 0 without them.

        Where they hold enough of the error to need a test, it is the ratio of the errors there.
        """
        if self.last is None or self.last.estimate is None or (limit := self.last.estimate.limit) is None:
            return 0.0
        last_size, new_size = self.last.variant.size, variant.size
        whole = limit.share if limit.share >= TESTED else 1.0
        if variant is self.last.variant:
            refinement = 1.0
        elif last_size is None or new_size is None:
            if variant.ratio:
                return variant.ratio / whole
            refinement = 2.0
        else:
            refinement = last_size / new_size
        return limit.least_remaining(refinement, self.last.step.degree, degree) / whole

    def _interrupted(self) -> Interrupted:
        where = f"stopped by a signal in step {len(self.rows) + 1} towards the accuracy demanded"
        return Interrupted(f"{where}; nothing was saved", "Run the job again.")

    def _add_row(self, trial: Trial, seconds: float) -> None:
        step, assessment = self.steps[-1], self.assessments[-1]
        errors, bounds = (
            {name: value if math.isfinite(value) else None for name, value in values.items()}
            for values in (assessment.errors, assessment.bounds)
        )
        assert trial.estimate is not None
        self.rows.append(
            AccuracyStep(
                mesh=trial.variant.origin,
                cells=step.cells,
                degree=step.degree,
                unknowns=step.unknowns,
                values=self.findings[-1].values,
                errors=errors,
                bounds=bounds,
                excess=assessment.excess if math.isfinite(assessment.excess) else None,
                left_out=trial.estimate.left_out,
                limit=self._limit_of(trial),
                factorizations=step.solve.count,
                seconds=seconds,
            )
        )
        units = {q.name: q.dimension.unit for q in self.job.quantities if q.dimension is not None}
        self.note(self.rows[-1].described(units, written_units(self.job.data)))

    def _limit_of(self, trial: Trial) -> str:
        """Return text on what limits the rate: a singular edge that has most of the error, regions that move."""
        limit, texts = trial.estimate and trial.estimate.limit, list[str]()
        if limit and limit.share >= MOSTLY:
            remedy = "; tetrahedra can be refined towards it, hexahedra cannot"
            texts.append(f"limited by the {limit.text}{'' if trial.step.cell == 'tetrahedron' else remedy}")
        if self.moving:
            names = ", ".join(f"'{name}'" for name in sorted(self.moving))
            texts.append(f"the border of {names} is not on the mesh, and moves with its cells: let cells end there")
        return "; ".join(texts)

    def _next(self) -> tuple[Variant, Body, int] | None:
        """Return mesh, body and degree of the next step; ``None`` if no choice within the limits helps much."""
        assert self.last is not None
        limit = min(self.job.solver.maximum_unknowns, self.memory.limit(self.steps[-1].estimate.unknowns))
        may_mark, allowed = self.may_mark, limit
        for _ in range(MOST_TRIES):
            decision = self._decide(allowed, may_mark)
            if decision is None:
                return None
            variant, degree = decision
            body = self.last.body if variant is self.last.variant else self._build(variant)
            body = body.raise_degree(degree)
            if (unknowns := self._unknowns(variant, body, degree, limit)) <= limit:
                return variant, body, degree
            if may_mark:  # cells that keep the mesh conforming may be more than was predicted
                may_mark = False
            else:
                allowed = int(allowed * limit / unknowns)
        return None

    def _decide(self, limit: int, may_mark: bool) -> tuple[Variant, int] | None:
        """Return mesh and degree of the next step, as `decide`."""
        assert self.last is not None
        excess, estimate = self.assessments[-1].excess, self.last.estimate
        known = math.isfinite(excess)
        if not known and may_mark and not self.findings[-1].is_proof:
            # A mesh that is refined towards the edges is a second one, too.
            excess = max(UNTESTED * max(hindsight(self.findings[-1:], self.job.accuracy)), UNTESTED)
            known = True
        forecast = RefinementForecast(
            self.steps,
            hindsight(self.findings, self.job.accuracy),
            excess if known else UNTESTED,
            estimate.limit if estimate else None,
        )
        # A higher degree on the one mesh would not be a test.
        highest = self.highest if math.isfinite(self.assessments[-1].excess) else self.last.step.degree
        return decide(self.meshes, self.last, forecast, limit=limit, highest=highest, known=known, may_mark=may_mark)

    def _unknowns(self, variant: Variant, body: Body, degree: int, limit: int) -> int:
        """Return the number of unknowns; far below the limit it is predicted by the cells."""
        last = self.steps[-1]
        predicted = last.unknowns * sum(body.partition.cells) / last.cells * (degree / last.degree) ** 3
        if predicted < SAFELY * limit:
            return int(predicted)
        job = self._job_in(variant, degree)
        return Unknowns(body.mesh, degree, job.pressure_degree, layers_of_cells(job, body)).size

    def _build(self, variant: Variant) -> Body:
        with self.timings("mesh"):
            return self.meshes.build(variant)

    @property
    def _degree(self) -> int:
        return self.job.discretisation.displacement

    def _job_in(self, variant: Variant, degree: int) -> Job:
        """Return the job in a discretisation, with the tolerance that the demands need."""
        job = self.meshes.job_on(variant)
        for _ in range(degree - self._degree):
            job = one_degree_more(job)
        tolerance = min(job.solver.tolerance, self._tolerance())
        return job.model_copy(update={"solver": job.solver.model_copy(update={"tolerance": tolerance})})

    def _tolerance(self) -> float:
        if self.last is None:
            return 1.0
        size, values = self.last.solution.largest_displacement, self.findings[-1].values
        shares = [demand / max(size, distance(values[name], 0.0)) for name, demand in self.job.accuracy.items()]
        return max(TOLERANCE * min(shares), FINEST)
