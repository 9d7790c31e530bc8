"""Which case a group of ranks takes next: one near to what it has just solved, and far from what other groups do."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from hpcinv.batch.task import BatchTask, Pause
from hpcinv.output.run_directory import RunDirectory
from hpcinv.sweep.neighbours import Floats, Space

if TYPE_CHECKING:
    from hpcinv.batch.ledger.ledger import Claim, Ledger
    from hpcinv.batch.ledger.record import CaseRecord
    from hpcinv.sweep.plan import Case, SweepPlan

_REFUSALS = 20  # in a row, until all cases are looked at again: others are at work here


@dataclass(frozen=True)
class SweepTask(BatchTask):
    """A case of a sweep, its place in its reuse group, and where its run leaves checkpoints and results."""

    reuse_group: str
    point: Floats
    directory: RunDirectory


class Queue:
    """The cases of a sweep that are not known to be finished; it lives on the first rank of a group.

    Within a reuse group the nearest open case is next, so that its neighbours' solutions are of use and models are
    seldom changed; groups of ranks begin at different places in the list, and meet nowhere but in the ledger.

    Args:
        ledger: where cases are claimed.
        begin: share of the list of cases, from 0 to 1, at which this group begins.
        patience: seconds to wait for cases that others hold: who does not live any more is known by then.
    """

    def __init__(self, plan: SweepPlan, ledger: Ledger, *, begin: float, patience: float) -> None:
        self.plan, self.ledger, self.patience = plan, ledger, patience
        distinct = {case.key: case for case in plan.cases}
        listed = sorted(distinct.values(), key=lambda case: (case.reuse_group, case.number))
        self._cases = listed
        self._reuse_groups = np.array([case.reuse_group for case in listed])
        self._spaces: dict[str, Space] = {}
        self._members: dict[str, tuple[np.ndarray, Floats]] = {}
        for reuse_group in dict.fromkeys(case.reuse_group for case in listed):
            members = np.flatnonzero(self._reuse_groups == reuse_group)
            self._spaces[reuse_group] = space = Space([listed[i].numbers for i in members])
            self._members[reuse_group] = members, np.stack([space.point(listed[i].numbers) for i in members])
        self._deadline: float | None = None  # of a wait for others
        self._last = min(int(begin * len(listed)), len(listed) - 1)
        self._look()

    def next(self) -> SweepTask | Pause | None:
        """Claim a case; ``None`` when all are finished, or in the hands of others who live."""
        while self._open.any():
            if found := self._claim():
                self._deadline = None
                return self._task(*found)
            self._look()
            if self._may_be_claimed():
                continue
            now = time.monotonic()
            if self._deadline is None:
                self._deadline = now + self.patience
            return Pause.WAIT if self._is_in_doubt() and now <= self._deadline else None
        return None

    def report(self, task: SweepTask, record: CaseRecord) -> str:
        line = f"{task.title}: "
        if not record.converged:
            return line + record.status
        line += f"{record.seconds:.2f} s, certificate {record.verdict}" + (", from a guess" if record.start else "")
        warnings = (record.statistics.get("body") or {"warnings": []})["warnings"]
        return "; ".join([line, *(f"warning: {text}" for text in warnings)])

    def _task(self, case: Case, claim: Claim) -> SweepTask:
        text = yaml.safe_dump(_plain(self.plan.content(case)), sort_keys=False, allow_unicode=True)
        directory = RunDirectory(claim.run, text, claimed=True)
        point = self._spaces[case.reuse_group].point(case.numbers)
        return SweepTask(case.title, self.plan.job(case), claim, case.reuse_group, point, directory)

    def _may_be_claimed(self) -> bool:
        return any(state.name == "open" for state in self._states)

    def _is_in_doubt(self) -> bool:
        """Whether a case is held by someone of whom it is not known whether he lives."""
        return any(state.name == "running" and not state.living for state in self._states)

    def _claim(self) -> tuple[Case, Claim] | None:
        """One pass over the cases that seem to be open."""
        tried, refusals = ~self._open, 0
        while not tried.all():
            # What has cost others their lives comes last: it should not cost ours before the rest is done.
            left = ~tried
            number = self._nearest(left & (self._deaths == self._deaths[left].min()))
            claim = self.ledger.claim(self._cases[number].key)
            if claim is not None:
                self._open[number], self._last = False, number
                return self._cases[number], claim
            tried[number] = True
            refusals += 1
            if refusals % _REFUSALS == 0:
                self._look()
                tried |= ~self._open
        return None

    def _nearest(self, eligible: np.ndarray) -> int:
        """Of the same reuse group if there is one; else the first case of that with most of them."""
        if eligible[self._last]:
            return self._last
        members, points = self._members[self._reuse_groups[self._last]]
        if eligible[members].any():
            here = points[np.searchsorted(members, self._last)]
            distances = np.where(eligible[members], np.linalg.norm(points - here, axis=1), np.inf)
            return int(members[np.argmin(distances)])
        names, counts = np.unique(self._reuse_groups[eligible], return_counts=True)
        return int(np.flatnonzero(eligible & (self._reuse_groups == names[np.argmax(counts)]))[0])

    def _look(self) -> None:
        """See how far everybody is, ourselves included."""
        found = self.ledger.states([case.key for case in self._cases])
        self._states = [found[case.key] for case in self._cases]
        self._open = np.array([state.name != "finished" for state in self._states])
        self._deaths = np.array([state.died for state in self._states])


def _plain(value: Any) -> Any:
    """As YAML has it."""
    if isinstance(value, Mapping):
        return {key: _plain(v) for key, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
