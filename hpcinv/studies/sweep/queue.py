"""Queue of a sweep: a group of ranks takes next the open case that is nearest to its last one, on the same line first.

A line holds cases whose numbers lie on a straight line, such as those along one axis of a grid: one power series serves
many of them (`hpcinv.studies.sweep.parameter_series`).
"""

import itertools
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hpcinv.mesh.source import Floats
from hpcinv.output.run_directory import RunDirectory, as_yaml
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.claims import Claim
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.task import BatchTask, Pause
from hpcinv.studies.sweep.neighbours import ParameterSpace, is_equal
from hpcinv.studies.sweep.sweep_plan import SweepPlan

LEAST_AHEAD = 8
"""Open cases on a line from which a power series is worth its solves. Raised, shorter axes take more factorizations."""
MOST_CLAIMED = 256
"""Cases that a group claims at once. Raised, the log of the store has fewer entries, of more cases each."""
LONGEST_BLOCK = 120.0
"""Seconds that the cases claimed at once may take together. Raised, groups wait longer for each other at the end."""
_SHARES = 8  # a group claims at most this part of its share of the open cases: 1/8
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
    """Cases of a reuse group: their places in the queue, their points, and their numbers, (cases, numbers)."""

    places: np.ndarray
    points: Floats
    numbers: Floats


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
        groups = [*plan.cases.reuse_groups]
        distinct = {key: place for place, key in enumerate(plan.cases.keys)}
        self._cases = plan.cases.chosen(sorted(distinct.values(), key=lambda place: (groups[place], place)))
        self._keys = [*self._cases.keys]
        self._reuse_groups = np.array([*self._cases.reuse_groups])
        self._members: dict[str, _Members] = {}  # of each reuse group
        self._open = np.ones(len(self._cases), dtype=bool)
        self._line = np.zeros(len(self._cases), dtype=bool)  # the cases of the present line
        for group, cases in itertools.groupby(enumerate(self._cases.numbers), lambda case: self._reuse_groups[case[0]]):
            places, numbers = zip(*cases, strict=True)
            points = np.stack([*map(ParameterSpace(numbers).point, numbers)])
            self._members[str(group)] = _Members(np.array(places), points, np.array(numbers).reshape(len(places), -1))
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
        directory = RunDirectory(claim.run, as_yaml(self.plan.content(case)), claimed=True)
        point, ahead = self._last_point(), self._ahead()
        return SweepTask(
            case.title, self.plan.job(case), claim, case.reuse_group, point, directory, case.numbers, ahead
        )

    def _ahead(self) -> Ahead | None:
        """Return the farthest open case on the line of the last one, which is the present line from now on."""
        self._choose_line()
        left = np.flatnonzero(self._line & self._open)
        if len(left) < LEAST_AHEAD:
            return None
        members = self._last_members
        places = np.searchsorted(members.places, left)
        distances = np.linalg.norm(members.points[places] - self._last_point(), axis=1)
        case = self._cases[left[np.argmax(distances)]]
        return Ahead(self.plan.content(case), case.numbers, len(left))

    def _choose_line(self) -> None:
        if not (self._line[self._last] and (self._line & self._open).any()):
            self._line = self._best_line()

    def _best_line(self) -> np.ndarray:
        """Return the cases on that line through the last one on which most cases are open."""
        line = np.zeros(len(self._cases), dtype=bool)
        group = self._last_members
        is_open = self._open[group.places]
        if is_open.sum() < LEAST_AHEAD:
            return line
        members, numbers = group.places[is_open], group.numbers[is_open]
        here = group.numbers[np.searchsorted(group.places, self._last)]
        ways = np.where(is_equal(numbers, here), 0.0, numbers - here)
        ways = ways[:, ways.any(axis=0)]
        ways /= np.abs(ways).max(axis=0, initial=0.0)
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        # The largest component is positive, of two almost equal ones the first.
        leading = (np.abs(ways) > 0.999 * np.abs(ways).max(axis=1, keepdims=True)).argmax(axis=1)
        ways *= np.sign(np.take_along_axis(ways, leading[:, None], axis=1))
        _, directions, counts = np.unique(np.round(ways, 9) + 0.0, axis=0, return_inverse=True, return_counts=True)
        line[members[directions.reshape(-1) == counts.argmax()]] = True
        line[self._last] = True
        return line

    def _last_point(self) -> Floats:
        members = self._last_members
        point: Floats = members.points[np.searchsorted(members.places, self._last)]
        return point

    @property
    def _last_members(self) -> _Members:
        return self._members[str(self._reuse_groups[self._last])]

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
        members, points, _ = self._last_members
        if (eligible & self._line).any():
            eligible = eligible & self._line
        if eligible[members].any():
            distances = np.linalg.norm(points - self._last_point(), axis=1)
            return int(members[np.argmin(np.where(eligible[members], distances, np.inf))])
        names, counts = np.unique(self._reuse_groups[eligible], return_counts=True)
        return int(np.flatnonzero(eligible & (self._reuse_groups == names[np.argmax(counts)]))[0])

    def _read_states(self) -> None:
        states = self.ledger.states(self._keys)
        self._states = [states[key] for key in self._keys]
        self._open = np.array([state.name != "finished" for state in self._states])
        self._deaths = np.array([state.died for state in self._states])


def _start_text(record: CaseRecord) -> str:
    """Return what a line on a case says about its start, and about a series that was made of it."""
    start = "" if not record.start else f", from a {'power series' if record.by_series else 'guess'}"
    return f"{start}; {record.remark}" if record.remark else start
