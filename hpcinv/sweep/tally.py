"""How the cases of a sweep have ended so far, and the exit code that tells it."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hpcinv.batch.ledger.ledger import Ledger
    from hpcinv.sweep.plan import SweepPlan

_SHOWN = 10  # diagnoses


class Tally:
    """Of distinct cases, by what their records say."""

    def __init__(self, plan: SweepPlan, ledger: Ledger) -> None:
        self.verdicts: Counter[str] = Counter()  # of those that converged, by the certificate
        self.diagnoses: Counter[str] = Counter()  # of those that failed
        keys = dict.fromkeys(case.key for case in plan.cases)
        self.unfinished = len(keys)
        for _, record in ledger.records(keys):
            self.unfinished -= 1
            if record.converged:
                self.verdicts[record.statistics["certificate"]["verdict"]] += 1
            else:
                self.diagnoses[record.statistics.get("status", record.status)] += 1

    def lines(self) -> list[str]:
        """Text for people."""
        converged, failed = self.verdicts.total(), self.diagnoses.total()
        parts = [f"{converged} converged", f"{failed} failed", f"{self.unfinished} not finished"]
        lines = [", ".join(part for part in parts if not part.startswith("0 ")) or "no cases"]
        lines += [f"  certificate {verdict}: {count}" for verdict, count in sorted(self.verdicts.items())]
        lines += [f"  {count} failed: {status}" for status, count in self.diagnoses.most_common(_SHOWN)]
        return lines

    def exit_code(self, *, strict: bool) -> int:
        """3 if cases have failed, else 6 if a certificate fails, 7 if one is in between and ``strict``, else 0."""
        if self.diagnoses:
            return 3
        if self.verdicts["fail"]:
            return 6
        return 7 if strict and (self.verdicts["warning"] or self.verdicts["not decided"]) else 0
