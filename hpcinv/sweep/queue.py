"""Queue of a sweep: a group of ranks takes next the open case that is nearest to its last one."""

import time
from dataclasses import dataclass

import numpy as np

from hpcinv.batch.ledger.case_record import CaseRecord
from hpcinv.batch.ledger.ledger import Claim, Ledger
from hpcinv.batch.task import BatchTask, Pause
from hpcinv.mesh.source import Floats
from hpcinv.output.run_directory import RunDirectory, as_yaml
from hpcinv.sweep.neighbours import ParameterSpace
from hpcinv.sweep.sweep_plan import SweepPlan

_REFUSALS = 20  # failed claims after which all states are read again, since other groups work on these cases


@dataclass(frozen=True)
class SweepTask(BatchTask):
    """A case of a sweep, its point in the space of its reuse group, and its run directory."""

    reuse_group: str
    point: Floats
    directory: RunDirectory


class Queue:
    """Queue of the open cases of a sweep; on the first rank of a group.

    Within a reuse group the nearest open case is next, so that the solutions of its neighbours give good guesses and
    models are seldom rebuilt. Groups of ranks begin at different positions of the list, and share only the ledger.

    Args:
        begin: share of the list of cases at which this group begins, from 0 to 1.
        patience: seconds to wait for cases that others hold, after which dead holders are known.
    """

    def __init__(self, plan: SweepPlan, ledger: Ledger, *, begin: float, patience: float) -> None:
        self.plan, self.ledger, self.patience = plan, ledger, patience
        distinct = {case.key: case for case in plan.cases}
        self._cases = sorted(distinct.values(), key=lambda case: (case.reuse_group, case.number))
        self._reuse_groups = np.array([case.reuse_group for case in self._cases])
        self._members: dict[str, tuple[np.ndarray, Floats]] = {}  # of each reuse group, and their points
        for reuse_group in dict.fromkeys(case.reuse_group for case in self._cases):
            members = np.flatnonzero(self._reuse_groups == reuse_group)
            numbers = [self._cases[i].numbers for i in members]
            self._members[reuse_group] = members, np.stack([*map(ParameterSpace(numbers).point, numbers)])
        self._deadline: float | None = None  # of a wait for cases that others hold
        self._last = min(int(begin * len(self._cases)), len(self._cases) - 1)
        self._read_states()

    def next(self) -> SweepTask | Pause | None:
        """Claim a case; ``None`` if all are finished or held by living processes."""
        while self._open.any():
            if claim := self._claim():
                self._deadline = None
                return self._task(claim)
            self._read_states()
            if any(state.name == "open" for state in self._states):
                continue
            now = time.monotonic()
            if self._deadline is None:
                self._deadline = now + self.patience
            is_doubtful = any(state.name == "running" and not state.living for state in self._states)
            return Pause.WAIT if is_doubtful and now <= self._deadline else None
        return None

    def report(self, task: SweepTask, record: CaseRecord) -> str:
        line = f"{task.title}: "
        if not record.converged:
            return line + record.status
        line += f"{record.seconds:.2f} s, certificate {record.verdict}" + (", from a guess" if record.start else "")
        warnings = (record.statistics.get("body") or {"warnings": []})["warnings"]
        return "; ".join([line, *(f"warning: {text}" for text in warnings)])

    def _task(self, claim: Claim) -> SweepTask:
        case = self._cases[self._last]
        directory = RunDirectory(claim.run, as_yaml(self.plan.content(case)), claimed=True)
        return SweepTask(case.title, self.plan.job(case), claim, case.reuse_group, self._last_point(), directory)

    def _last_point(self) -> Floats:
        members, points = self._members[self._cases[self._last].reuse_group]
        point: Floats = points[np.searchsorted(members, self._last)]
        return point

    def _claim(self) -> Claim | None:
        """Claim a case, the last one from now on, in one pass over those that seem to be open; ``None`` if all fail."""
        tried, refusals = ~self._open, 0
        while not tried.all():
            # Cases with which processes died come last, so that the others are solved first.
            left = ~tried
            number = self._nearest(left & (self._deaths == self._deaths[left].min()))
            claim = self.ledger.claim(self._cases[number].key)
            if claim is not None:
                self._open[number], self._last = False, number
                return claim
            tried[number] = True
            refusals += 1
            if refusals % _REFUSALS == 0:
                self._read_states()
                tried |= ~self._open
        return None

    def _nearest(self, eligible: np.ndarray) -> int:
        """Return the nearest case of the same reuse group, else the first one of the group with most cases."""
        if eligible[self._last]:
            return self._last
        members, points = self._members[self._cases[self._last].reuse_group]
        if eligible[members].any():
            distances = np.linalg.norm(points - self._last_point(), axis=1)
            return int(members[np.argmin(np.where(eligible[members], distances, np.inf))])
        names, counts = np.unique(self._reuse_groups[eligible], return_counts=True)
        return int(np.flatnonzero(eligible & (self._reuse_groups == names[np.argmax(counts)]))[0])

    def _read_states(self) -> None:
        states = self.ledger.states([case.key for case in self._cases])
        self._states = [states[case.key] for case in self._cases]
        self._open = np.array([state.name != "finished" for state in self._states])
        self._deaths = np.array([state.died for state in self._states])
