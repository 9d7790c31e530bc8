"""Intervals of quantities next to their values, as errors are: in the text of a run, its report and the dossier."""

from __future__ import annotations

from typing import Any

from hpcinv.output.text_report import intervals_of
from hpcinv.pages.reports.run_page import quantity_rows

INTERVAL = {"of": "gap", "low": 0.5, "high": 0.52, "unit": "m", "by": "contact pressures"}
OPEN = INTERVAL | {"of": "force", "high": None}
SUMMARY: dict[str, Any] = {
    "certificate": {"lines": [{"interval": INTERVAL}, {"interval": OPEN}, {}], "estimate": None},
    "quantities": {"gap": 0.51, "force": 1.0, "other": 2.0},
    "quantity_units": {"gap": "m", "force": "N", "other": "m"},
    "job": {"quantities": []},
}


def shown(value: float, digits: int = 6) -> str:
    return f"{value:.{digits}g}"


def test_interval_of_a_quantity_is_shown_with_its_cause() -> None:
    assert list(intervals_of(SUMMARY, "gap", shown)) == [("0.5 to 0.52", "over all contact pressures")]
    assert list(intervals_of(SUMMARY, "force", shown)) == [("0.5 to no end", "over all contact pressures")]
    assert list(intervals_of(SUMMARY, "other", shown)) == []


def test_report_and_dossier_have_intervals_among_the_deviations() -> None:
    rows = {row["name"]: row["deviations"] for row in quantity_rows(SUMMARY)}
    assert rows["gap"] == [("500 mm to 520 mm", "over all contact pressures")]
    assert rows["other"] == []
