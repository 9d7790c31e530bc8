"""Shares of the states of a job, so that teams of ranks solve different states at the same time.

The rest shape comes from the given state, which each team solves by itself; the further states are independent of each
other, except for those that begin at one another.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from hpcinv.errors import OutputError
from hpcinv.job.identification import Observation
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.job.states import StateSpec

_OF_STATE = re.compile(r"states\[(\d+)\](.*)")


@dataclass(frozen=True)
class StateShare:
    """Some states of a job.

    Attributes:
        states: numbers of the states in the whole job, in its order; ``None`` for all.
    """

    whole: Job
    states: tuple[int, ...] | None = None

    def job(self, job: Job) -> Job:
        """Return a job like the whole one with these states only."""
        if self.states is None:
            return job
        names = [self.whole.states[i].name for i in self.states]
        return job.with_(
            {
                "states": [job.data["states"][i] for i in self.states],
                "quantities": [q for q in job.data.get("quantities", ()) if q.get("state", names[0]) in names],
                "sensitivities": {
                    numbers[0].key: replace(numbers[0], ties=tuple(numbers[1:])).tied_keys
                    for p in job.differentiated
                    if (numbers := self._numbers(p))
                },
            }
        )

    def number(self, parameter: Parameter) -> Parameter | None:
        """Return the number that stands for a parameter in that job, ``None`` if all are of states that it has not."""
        return next(iter(self._numbers(parameter)), None)

    def _numbers(self, parameter: Parameter) -> list[Parameter]:
        """Return the numbers, with their keys in that job, that change there with a parameter."""
        return [
            replace(number, key=own)
            for number in (parameter, *parameter.ties)
            if (own := self._own(number.key)) is not None
        ]

    def _own(self, key: str) -> str | None:
        match = _OF_STATE.fullmatch(key)
        if self.states is None or match is None:
            return key
        number, rest = int(match[1]), match[2]
        return f"states[{self.states.index(number)}]{rest}" if number in self.states else None

    def has(self, observation: Observation, *, first: bool) -> bool:
        """Return whether the share predicts an observation; ``first``: whether it also does the rest shape's."""
        if self.states is None:
            return True
        quantity = next((q for q in self.whole.quantities if q.name == observation.quantity), None)
        name = observation.state if quantity is None else quantity.state
        state = next((i for i, state in enumerate(self.whole.states) if state.name == name), None)
        shared = state is None or _is_common(self.whole.states[state])
        return first if shared else state in self.states


def teams_of(ranks: int, ranks_per_state: int) -> int:
    """Return the number of teams; raises ``OutputError`` if the ranks cannot be divided into teams of that size."""
    if ranks_per_state < 1 or ranks % ranks_per_state:
        raise OutputError(
            f"--ranks-per-state {ranks_per_state}: {ranks} ranks cannot be divided into teams of that size",
            f"Start a multiple of {max(ranks_per_state, 1)} ranks.",
        )
    return ranks // ranks_per_state


def shares_of(job: Job, teams: int) -> list[StateShare]:
    """Divide the states of a job.

    Raises:
        OutputError: there are not so many states that are independent of each other.
    """
    if teams == 1:
        return [StateShare(job)]
    common = [i for i, state in enumerate(job.states) if _is_common(state)]
    chains = _chains(job.states)
    if teams > len(chains):
        count = f"{len(chains)} further states that do" if len(chains) != 1 else "one further state that does"
        raise OutputError(
            f"--ranks-per-state: {teams} teams of ranks, but {count} not begin at another one",
            f"Give each more ranks, so that there are at most {max(len(chains), 1)} teams.",
        )
    parts: list[list[int]] = [[] for _ in range(teams)]
    for chain in sorted(chains, key=len, reverse=True):
        min(parts, key=len).extend(chain)
    return [StateShare(job, tuple(sorted([*common, *part]))) for part in parts]


def _is_common(state: StateSpec) -> bool:
    return state.given or state.is_rest


def _chains(states: Sequence[StateSpec]) -> list[list[int]]:
    """Return the numbers of the further states, those together that begin at one another."""
    names = {state.name: i for i, state in enumerate(states)}

    def origin(i: int) -> int:
        start_number: Any = names.get(states[i].start or "")
        return i if start_number is None or _is_common(states[start_number]) else origin(start_number)

    chains: dict[int, list[int]] = {}
    for i, state in enumerate(states):
        if not _is_common(state):
            chains.setdefault(origin(i), []).append(i)
    return list(chains.values())
