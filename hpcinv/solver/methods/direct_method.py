"""The direct method: equilibrium is formulated on the given body and solved by one continuation in the load."""

from collections.abc import Iterator
from dataclasses import replace

from hpcinv.model.constraint_report import ConstraintReport
from hpcinv.model.outcome import Outcome
from hpcinv.physics.effects import Direction
from hpcinv.solver.constraints import borders_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.equilibrium_path import EquilibriumPath, Solves
from hpcinv.solver.load_stepping import AdaptiveSteps
from hpcinv.solver.methods.fallbacks import reach
from hpcinv.solver.methods.method import UNLOADED, Guess, Method, Start
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SILENT, Observer

AUGMENTATION = "augmentation"
"""Strategy of the solves in which the pressures of rigid obstacles, or their nearest points, settle."""
_MOST_UPDATES = 100  # of contacts
_MOST_HALVINGS = 4
"""Halvings of an update of the contacts without a solution; raised, hopeless solves end later."""


class UnknownLoads:
    """The unknown numbers of a job, which its solves find with the state; there may be none.

    The load factor leads from the unloaded body to what is given, with all loads.
    """

    def __init__(self, equations: Equations, equilibrium: Equilibrium) -> None:
        self._borders = borders_of(equations.job, equations, equilibrium.system)
        equilibrium.take_numbers(self._borders)

    def reports(self, load: float) -> tuple[ConstraintReport, ...]:
        """Return what the present state, a solution at a load factor, says about them; collective."""
        return tuple(report for border in self._borders for report in border.reports(load))


class DirectMethod(Method):
    """Direct method for forward and inverse problems (doi:10.1007/s00366-021-01597-z)."""

    def __init__(self, equations: Equations, direction: Direction, observer: Observer = SILENT) -> None:
        self.equilibrium = equations.equilibrium(equations.weak_form(direction), observer)
        self.equations, self.direction = equations, direction
        self.unknown_loads = UnknownLoads(equations, self.equilibrium)
        is_first, steps = direction == equations.job.directions[0], equations.steps
        self.steps = steps if is_first else steps.in_second_direction()

    def solves(self, start: Start = UNLOADED) -> Solves:
        self.reached_load = start.load
        equations, contacts = self.equations, self.equilibrium.system.weak_form.contacts
        tolerance = equations.job.solver.tolerance
        self.check_start(start)
        cases = self._begin(start)
        if contacts.is_iterated and start.load == 1.0:  # a checkpoint has no contact pressures
            self.reached_load = 0.0
            yield (solve := self.equilibrium.solve(1.0, tolerance, begins_near=True))
            if solve.outcome.accepted:
                yield from self._augment(tolerance)
            return
        # The other strategies are chosen for the path that they take, which a guess would skip.
        is_path_free = isinstance(self.steps, AdaptiveSteps) and not contacts.is_iterated
        if is_path_free and start.guess is not None and start.load == 0.0:
            yield (solve := self._solve_from(start.guess))
            if solve.outcome.accepted or solve.outcome is Outcome.INTERRUPTED:
                return
        passed = sum(solve.limit_point for solve in start.solves)
        path = EquilibriumPath(self.equilibrium, tolerance, cases, start.load, passed)
        if contacts.depends_on_path:  # with other steps, it would have another solution
            path.earlier = start.solves
        for solve in reach(path, equations, self.direction, self.steps):
            is_last = solve.outcome.accepted and solve.load == 1.0 and contacts.is_iterated
            if solve.outcome.accepted and not is_last:
                self.reached_load = solve.load
            yield solve
            if is_last:
                yield from self._augment(tolerance)

    def _begin(self, start: Start) -> int:
        """Put the state with which the solves begin; return the number of load cases on the way from there."""
        cases = self.equations.job.case_count
        self.equilibrium.system.begin_contacts()
        self.equilibrium.system.resume_contacts(start.slips, self.equations.scales)
        if start.origin is not None:
            self.equations.put_fields(start.origin)
            self.equilibrium.begin_path()
            if start.solution is not None:
                self.equations.put_fields(start.solution)
            cases = 1
        if start.load > 0.0:
            self.equilibrium.numbers.recover(start.load)
        return cases

    def _solve_from(self, guess: Guess) -> Solve:
        """Solve at the full load from a guess; the body is unloaded again if that fails."""
        self.equilibrium.depart(0.0)
        solve = guess.solve(self.equations, self.equilibrium)
        if solve.outcome.accepted:
            self.reached_load = 1.0
        else:
            self.equations.unload()
        return solve

    def _augment(self, tolerance: float) -> Iterator[Solve]:
        """Yield solves at the full load, each after an update of the contacts, until one would change them no more.

        If a solve fails, half of its update is taken back: slender bodies whose edge of contact lies between nodes have
        no solution near the state with the whole one.

        Pressures and jumps change little: each solve begins with the tangent of the one before.

        The present state is a solution at the full load, which is reached when the contacts have settled.

        Source: Uzawa's method for contact, Simo & Laursen (1992), doi:10.1016/0045-7949(92)90540-G.
        """
        system = self.equilibrium.system
        for _ in range(_MOST_UPDATES):
            system.set_load(1.0)
            if not system.update_contacts():
                system.weak_form.contacts.check_balance(self.equations.scales)
                self.reached_load = 1.0
                return
            for halvings in range(_MOST_HALVINGS + 1):
                solve = self.equilibrium.solve(1.0, tolerance, begins_near=True, keeps=halvings == 0)
                yield replace(solve, strategy=AUGMENTATION)
                if solve.outcome.accepted or solve.outcome is Outcome.INTERRUPTED:
                    break
                system.halve_contact_update()
            if not solve.outcome.accepted:
                return
        yield Solve(1.0, Outcome.CONTACT_LIMIT, (), 0, strategy=AUGMENTATION)

    def can_restart_after(self, solve: Solve) -> bool:
        contacts = self.equilibrium.system.weak_form.contacts
        is_between = contacts.is_iterated and solve.load == 1.0
        return solve.outcome.accepted and not is_between

    def min_mesh_J(self) -> float:
        return self.equilibrium.system.min_mesh_J()
