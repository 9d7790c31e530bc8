"""Queue of a sweep: a group of ranks takes next the open case that is nearest to its last one, on the same line first.

A line holds cases whose numbers lie on a straight line, such as those along one axis of a grid: one power series serves
many of them (`hpcinv.studies.sweep.parameter_series`).
"""

import bisect
import itertools
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hpcinv.mesh.source import Floats, Ints
from hpcinv.output.run_directory import RunDirectory, as_yaml
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.claims import Claim
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.task import BatchTask, Pause
from hpcinv.studies.sweep.case_lines import CaseLines
from hpcinv.studies.sweep.nearest_case import NearestCase
from hpcinv.studies.sweep.neighbours import ParameterSpace
from hpcinv.studies.sweep.sweep_plan import CaseReader, SweepPlan

LEAST_AHEAD = 8
"""Open cases on a line from which a power series is worth its solves. Raised, shorter axes take more factorizations."""
MOST_CLAIMED = 256
"""Cases that a group claims at once. Raised, the log of the store has fewer entries, of more cases each."""
LONGEST_BLOCK = 120.0
"""Seconds that the cases claimed at once may take together. Raised, groups wait longer for each other at the end."""
_SHARES = 8  # a group claims at most this part of its share of the open cases: 1/8
_NO_CASES: Ints = np.zeros(0, dtype=np.int64)
_REFUSALS = 20  # failed claims after which all states are read again, since other groups work on these cases


@dataclass(frozen=True)
class Ahead:
    """The farthest open case on a line, and the number of open cases there."""

    content: Mapping[str, Any]
    numbers: tuple[float, ...]
    count: int


@dataclass(frozen=True)
class SweepTask(BatchTask):
    """A case of a sweep.

    Attributes:
        point: its point in the space of its reuse group.
        numbers: its numbers, as of `Case`.
        ahead: the farthest open case on its line; ``None`` if few are open there.
    """

    reuse_group: str
    point: Floats
    directory: RunDirectory
    numbers: tuple[float, ...]
    ahead: Ahead | None


class _Members(NamedTuple):
    """Cases of a reuse group: their places in the queue, which follow each other, their points, and lines of many."""

    places: slice
    points: Floats
    nearest: NearestCase
    lines: CaseLines


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
        self._reader = CaseReader(plan)
        groups = [*plan.cases.reuse_groups]
        distinct = {key: place for place, key in enumerate(plan.cases.keys)}
        self._cases = plan.cases.chosen(sorted(distinct.values(), key=lambda place: (groups[place], place)))
        self._keys = [*self._cases.keys]
        self._members: list[_Members] = []  # of each reuse group
        self._open = np.ones(len(self._cases), dtype=bool)
        self._line = _NO_CASES  # the cases of the present line, in order
        cases = zip(self._cases.reuse_groups, self._cases.numbers, strict=True)
        for _, group in itertools.groupby(cases, lambda case: case[0]):
            numbers = np.array([own for _, own in group], dtype=np.float64)
            begin_of_group = self._members[-1].places.stop if self._members else 0
            places = slice(begin_of_group, begin_of_group + len(numbers))
            points = ParameterSpace(numbers).point(numbers)
            self._members.append(_Members(places, points, NearestCase(points), CaseLines(numbers, LEAST_AHEAD)))
        self._ends = [members.places.stop for members in self._members]
        self._block = deque[tuple[int, Claim]]()  # claimed cases, the next one first
        self._block_size, self._solved, self._seconds = 0, 0, 0.0
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
        self._solved, self._seconds = self._solved + 1, self._seconds + record.seconds
        line = f"{task.title}: "
        if not record.converged:
            return line + record.status
        line += f"{record.seconds:.2f} s, certificate {record.verdict}" + _start_text(record)
        warnings = (record.statistics.get("body") or {"warnings": []})["warnings"]
        return "; ".join([line, *(f"warning: {text}" for text in warnings)])

    def _task(self, claim: Claim) -> SweepTask:
        case = self._cases[self._last]
        job = self._reader.job(self._cases.points[case.number])
        directory = RunDirectory(claim.run, as_yaml(job.data), claimed=True)
        point, ahead = self._last_point(), self._ahead()
        return SweepTask(case.title, job, claim, case.reuse_group, point, directory, case.numbers, ahead)

    def _ahead(self) -> Ahead | None:
        """Return the farthest open case on the line of the last one, which is the present line from now on."""
        self._choose_line()
        left = self._line[self._open[self._line]]
        if len(left) < LEAST_AHEAD:
            return None
        members = self._last_members
        distances = np.linalg.norm(members.points[left - members.places.start] - self._last_point(), axis=1)
        case = self._cases[left[np.argmax(distances)]]
        return Ahead(self.plan.content(case), case.numbers, len(left))

    def _choose_line(self) -> None:
        """Keep the present line while the last case is on it and others are open, else take the best one."""
        place = np.searchsorted(self._line, self._last)
        is_on_it = place < len(self._line) and self._line[place] == self._last
        if not (is_on_it and self._open[self._line].any()):
            self._line = self._best_line()

    def _best_line(self) -> Ints:
        """Return the cases on that line through the last one on which most cases are open."""
        members = self._last_members
        lines = [members.places.start + line for line in members.lines.through(self._last - members.places.start)]
        counts = [np.count_nonzero(self._open[line]) for line in lines]
        return lines[int(np.argmax(counts))] if any(counts) else _NO_CASES

    def _last_point(self) -> Floats:
        members = self._last_members
        point: Floats = members.points[self._last - members.places.start]
        return point

    @property
    def _last_members(self) -> _Members:
        return self._members[bisect.bisect_right(self._ends, self._last)]

    def _claim(self) -> Claim | None:
        """Return the claim of a case, the last one from now on; ``None`` if no open case can be had."""
        if not self._block:
            self._claim_block()
        if not self._block:
            return None
        self._last, claim = self._block.popleft()
        self._open[self._last] = False
        return claim

    def _claim_block(self) -> None:
        """Claim the next cases, in one pass over those that seem to be open."""
        tried, refusals = ~self._open, 0
        size = self._next_block_size()
        while not tried.all():
            # Cases with which processes died come last, so that the others are solved first.
            left = ~tried
            fewest = self._deaths[left].min()
            numbers = self._chain(left & (self._deaths == fewest), 1 if fewest else size)
            claims = {claim.key: claim for claim in self.ledger.claim_all(self._keys[number] for number in numbers)}
            if claims:
                self._block.extend((n, claims[self._keys[n]]) for n in numbers if self._keys[n] in claims)
                self._block_size = size
                return
            tried[numbers] = True
            refusals += 1
            if refusals % _REFUSALS == 0:
                self._read_states()
                tried |= ~self._open

    def _next_block_size(self) -> int:
        """Return the number of cases to claim at once: few at first, at the end, and where cases take long."""
        share = int(self._open.sum()) // (_SHARES * max(self.ledger.holder_count(), 1))
        pace = LONGEST_BLOCK * self._solved / self._seconds if self._seconds > 0 else MOST_CLAIMED
        return max(1, int(min(2 * self._block_size, share, pace, MOST_CLAIMED)))

    def _chain(self, eligible: np.ndarray, size: int) -> list[int]:
        """Return the cases that are taken next, one after the other, if all eligible ones can be had."""
        present = self._last, self._line, self._open.copy()
        numbers = list[int]()
        while eligible.any() and len(numbers) < size:
            self._last = self._nearest(eligible)
            eligible[self._last] = self._open[self._last] = False
            numbers.append(self._last)
            if len(numbers) < size:
                self._choose_line()
        self._last, self._line, self._open = present
        return numbers

    def _nearest(self, eligible: np.ndarray) -> int:
        """Return the nearest case on the present line, else of its reuse group, else the first of the largest group."""
        if eligible[self._last]:
            return self._last
        members = self._last_members
        first: int = members.places.start
        on_line = self._line[eligible[self._line]]
        if len(on_line):
            distances = np.linalg.norm(members.points[on_line - first] - self._last_point(), axis=1)
            return int(on_line[np.argmin(distances)])
        nearest = members.nearest.among(eligible[members.places], self._last_point())
        if nearest is not None:
            return first + nearest
        counts = np.add.reduceat(eligible, [members.places.start for members in self._members], dtype=np.int64)
        largest = self._members[int(np.argmax(counts))].places
        first = largest.start
        return first + int(np.argmax(eligible[largest]))

    def _read_states(self) -> None:
        states = self.ledger.states(self._keys)
        self._states = [states[key] for key in self._keys]
        self._open = np.array([state.name != "finished" for state in self._states])
        self._deaths = np.array([state.died for state in self._states])


def _start_text(record: CaseRecord) -> str:
    """Return what a line on a case says about its start, and about a series that was made of it."""
    start = "" if not record.start else f", from a {'power series' if record.by_series else 'guess'}"
    return f"{start}; {record.remark}" if record.remark else start
