"""What a store has of the cases of a sweep."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcinv.sweep.holder import Holder
from hpcinv.sweep.ledger import Ledger

if TYPE_CHECKING:
    from hpcinv.sweep.plan import Plan
    from hpcinv.sweep.record import Record


def ledger_of(plan: Plan) -> Ledger:
    """The ledger of a sweep's store, for reading."""
    return Ledger(plan.store, Holder(plan.store))


def results(plan: Plan, ledger: Ledger) -> dict[str, Record]:
    """The records of finished cases by key, in the order of the sweep."""
    states = ledger.states(dict.fromkeys(case.key for case in plan.cases))
    finished = [key for key, state in states.items() if state.name == "finished"]
    return {key: record for key in finished if (record := ledger.record(key)) is not None}
