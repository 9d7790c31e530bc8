"""The path of equilibria to the full load: one engine for all policies that say where it goes next.

A `Policy` proposes states. The `EquilibriumPath` corrects them, reports each solve once with all that it took, and
returns to earlier states. A run that is resumed begins with the load of its checkpoint.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

from hpcinv.model.outcome import Outcome
from hpcinv.on_demand import on_demand
from hpcinv.solver.equilibrium import Equilibrium, Kept
from hpcinv.solver.newton import Solve

type Solves = Generator[Solve, None, None]


class Policy(ABC):
    """Where a path goes next."""

    @abstractmethod
    def solves(self, path: EquilibriumPath) -> Solves:
        """Yield the reports of solves from the present place of a path on; collective.

        The state is always the state of the last accepted solve. The last solve is accepted at load factor 1, or its
        outcome is the reason why the full load was not reached.
        """

    def in_second_direction(self) -> Policy:
        """Return the policy of a round trip's second direction."""
        return self


@dataclass(frozen=True)
class PolicyOnDemand(Policy):
    """A policy that is imported when a path follows it.

    Attributes:
        made: its name in `hpcinv.on_demand`.
        settings: its fields, in order.
    """

    made: str
    settings: tuple[Any, ...]

    def solves(self, path: EquilibriumPath) -> Solves:
        policy: Policy = on_demand(self.made)(*self.settings)
        return policy.solves(path)


@dataclass
class EquilibriumPath:
    """The path of equilibria, as far as it has been followed; methods are collective.

    Attributes:
        tolerance: estimated error of the state at full load.
        cases: number of load cases; no step crosses the end of one.
        load: load factor at which the present state is a solution.
        passed: number of limit points between the unloaded body and the present state.
        last: last solve that was reported.
        spent: factorizations that are not part of a report yet.
        has_near_factors: whether the present factors belong to a tangent near the one at the present state.
        earlier: solves before it, after which it goes on. By default it takes the first step of the policy.
    """

    equilibrium: Equilibrium
    tolerance: float
    cases: int = 1
    load: float = 0.0
    passed: int = 0
    last: Solve | None = None
    spent: int = 0
    has_near_factors: bool = False
    earlier: tuple[Solve, ...] = ()

    def follow(self, policy: Policy, effort: float = math.inf) -> Solves:
        """Yield the solves of a policy, until they have taken more factorizations than ``effort``."""
        for solve in limited(policy.solves(self), effort):
            self.last = solve
            yield solve

    def begin(self) -> None:
        """Let loads and ways past obstacles begin at the present state."""
        self.equilibrium.system.begin_unloaded()
        self.equilibrium.depart(self.load)

    def target(self, step: float) -> float:
        """Return the load factor after a step, at most the end of the present load case."""
        end = min((math.floor(self.load * self.cases + 1e-9) + 1) / self.cases, 1.0)
        # A remainder of rounding errors is not a separate step.
        return end if self.load + step > end - 1e-9 / self.cases else self.load + step

    def solve(self, load: float, tolerance: float, **options: Any) -> Solve:
        """Correct the present state, to a tolerance on the way or to the tolerance of the full load.

        Args:
            options: of `Equilibrium.solve`.
        """
        return self.equilibrium.solve(load, self.tolerance if load == 1.0 else tolerance, **options)

    def place(self) -> Kept:
        """Return the present state and its numbers, for `return_to`."""
        return self.equilibrium.kept()

    def return_to(self, place: Kept) -> None:
        """Return to the state of the last accepted solve, or to an earlier one; `load` is its load factor."""
        self.equilibrium.restore(place)
        self.equilibrium.depart(self.load)

    def report(self, solve: Solve, strategy: str | None = None) -> Solve:
        """Return a solve as it is reported: with its strategy, and with the factorizations since the last report."""
        solve = replace(solve, factorizations=solve.factorizations + self.spent, strategy=strategy or solve.strategy)
        self.spent = 0
        self.load = solve.load if solve.outcome.accepted else self.load
        self.passed += solve.limit_point
        self.last = solve
        return solve


def limited(solves: Solves, effort: float) -> Solves:
    """Yield solves until they have taken too many factorizations, which is the outcome of one more then."""
    spent = 0
    with closing(solves):
        for solve in solves:
            yield solve
            spent += solve.factorizations
            if spent > effort and not (solve.outcome.accepted and solve.load == 1.0):
                yield Solve(solve.load, Outcome.STEP_LIMIT, (), 0, strategy=solve.strategy)
                return
