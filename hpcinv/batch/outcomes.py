"""Ends of cases that not their own process alone can bring about: too long, with what that leaves."""

from __future__ import annotations

import contextlib
import shutil
from typing import TYPE_CHECKING

from hpcinv.batch.forecast import in_words
from hpcinv.batch.ledger.record import CaseRecord

if TYPE_CHECKING:
    from hpcinv.batch.ledger.ledger import Claim


def overdue_record(limit: float | None, retry: str, claim: Claim) -> CaseRecord:
    """The record of a case that took longer than its limit (s); ``retry``: the command that opens it again."""
    seconds = limit or 0.0
    advice = f"Raise 'limit' and open it again with '{retry}', or take larger steps or a coarser mesh."
    return CaseRecord(f"took longer than its limit of {in_words(seconds)}", advice, {}, seconds, claim.attempt)


def remove_run(claim: Claim) -> None:
    """Remove what a case has left in its directory."""
    shutil.rmtree(claim.run, ignore_errors=True)
    with contextlib.suppress(OSError):  # there may be those of earlier rounds
        claim.run.parent.rmdir()
