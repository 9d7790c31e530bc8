"""Balance of parts that contact alone holds: pressure must balance their loads."""

from __future__ import annotations

from collections.abc import Iterator

from hpcinv.model.contacts import MOST_UNBALANCED
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, topic

BALANCE = topic(
    "balance of free parts",
    "Whether the pressure of contact balances the loads of parts that nothing else holds.",
    "Hold the motion by a support, or correct the loads.",
    computed="force and moment that springs along the free motions take, by the contact's force",
    thresholds="never; above 1e-6",
)


class BalanceCheck(Check):
    """Check the balance of parts that contact alone holds."""

    name, order = "free parts", 33

    def applies(self, run: CheckedRun) -> bool:
        return super().applies(run) and bool(run.solution.job.interfaces)

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        pins = run.equations.weak_form(run.solution.direction).contacts.pins
        if not pins:
            return
        worst = max(pin.balance for pin in pins)
        parts = ", ".join(f"with '{pin.region}' along {pin.count} motions" for pin in pins)
        note = (
            f"parts {parts}; outer nodes of the contact stay where they were in the mean; their stability is unchecked"
        )
        verdict = Verdict.PASS if worst <= MOST_UNBALANCED else Verdict.FAIL
        yield Line(BALANCE, worst, "", f"fail above {MOST_UNBALANCED:.1g}", verdict, note)
