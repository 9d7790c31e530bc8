"""Checks of numbers of loads and supports that the solve found: their equations, and stability of remote motions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.constraints import solved_borders
from hpcinv.solver.constraints.remote_motions import RemoteMotion
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, skipped, topic, upper_bound_line
from hpcinv.trust.certificate.stability import STABILITY

_WARN, _FAIL = 1e-8, 1e-5
"""Residual of an equation, relative to the larger volume or to the forces on a region; larger ones accept
wrong volumes and loads."""
_POTENTIAL = 1e-8
"""Asymmetry of a stiffness that rounding errors leave; raised, moments count as loads with a potential."""
CAVITY = topic(
    "equation of cavity '…', relative to its volume",
    "How well the pressure that was found meets the given volume, gas or windkessel of a cavity.",
    "Lower solver.tolerance.",
    computed="difference from the given [volume, gas law or windkessel](../how-to/cavities.md), over the volume",
    thresholds="above 1e-8; above 1e-5",
)
REMOTE_LOAD = topic(
    "balance of the remote load on '…', relative to its forces",
    "How well force and moment on a rigid region are balanced by the computed motion.",
    "Lower solver.tolerance.",
    computed="forces and moments that are left, over the forces on the region",
    thresholds="above 1e-8; above 1e-5",
)
NUMBER = topic(
    "constraint of '…', relative to its terms",
    "How well the number that was found meets the constraint of an effect.",
    "Lower solver.tolerance.",
    computed="the constraint of an effect of a [plugin](../how-to/extend.md), over the sum of its terms' sizes",
    thresholds="above 1e-8; above 1e-5",
)
STABLE_MOTIONS = topic(
    "stability of remote loads: unstable motions",
    STABILITY.meaning,
    STABILITY.remedy,
    STABILITY.remedy_if_undecided,
    computed="negative eigenvalues of the stiffness against these motions",
    thresholds=STABILITY.thresholds,
)


TOPICS = {"cavities": CAVITY, "remote_loads": REMOTE_LOAD, "constraints": NUMBER}
"""by the section of the summary that has the numbers"""


class UnknownLoadCheck(Check):
    """Check the equations of all numbers that the solve found."""

    name, order = "unknown loads", 40

    def applies(self, run: CheckedRun) -> bool:
        return super().applies(run) and run.has_unknown_loads

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        for report in run.solution.constraints:
            topic = TOPICS[report.section].placed(report.label)
            yield upper_bound_line(topic, report.residual, _WARN, _FAIL, note=report.note)


class RemoteLoadStabilityCheck(Check):
    """Look for unstable motions of regions under remote loads.

    A body is stable if it is stable with these motions held, and the stiffness (6 n, 6 n) that it has against changes
    of the n motions is positive definite: the number of negative eigenvalues of the whole tangent is the sum of both.
    """

    name, order = "remote loads", 120

    def applies(self, run: CheckedRun) -> bool:
        is_asked = super().applies(run) and run.solution.job.certificate.stability
        return is_asked and bool(run.solution.remote_loads)

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        equations, solution, forward = run.equations, run.solution, run.forward
        with forward.tangent() as equilibrium:
            borders = solved_borders(solution.job, solution.constraints, equations, equilibrium.system)
            motions = [border for border in borders if isinstance(border, RemoteMotion)]
            bordered = BorderedSolver(equilibrium.system, equilibrium.linear, motions)
            is_solved = bordered.linearise(1.0)
            stiffness = bordered.condensed
            bordered.destroy()
            for border in borders:
                border.destroy()
        if not is_solved:
            yield skipped(STABLE_MOTIONS, "the tangent could not be factorized")
            return
        symmetric, skew = (stiffness + stiffness.T) / 2, (stiffness - stiffness.T) / 2
        unstable = int(np.count_nonzero(np.linalg.eigvalsh(symmetric) <= 0.0))
        asymmetry = float(np.linalg.norm(skew) / np.linalg.norm(symmetric))
        rule, note = "no negative eigenvalue of the stiffness against these motions", ""
        if asymmetry > _POTENTIAL:
            note = f"loads without a potential (asymmetry {asymmetry:.1g}): only the symmetric part was checked"
        verdict = (Verdict.WARN if note else Verdict.FAIL) if unstable else Verdict.PASS
        yield Line(STABLE_MOTIONS, float(unstable), "", rule, verdict, note)
