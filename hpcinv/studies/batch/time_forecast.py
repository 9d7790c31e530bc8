"""Time that the open cases of a batch will take, predicted from the times of those that are finished."""

import math
import statistics
from collections.abc import Mapping
from functools import cache

from hpcinv.studies.batch.outcomes import Outcome


def remaining_seconds(
    reuse_groups: Mapping[str, str], outcomes: Mapping[str, Outcome], unknowns: Mapping[str, int] | None = None
) -> float | None:
    """Return the seconds that the unfinished cases take one after the other; ``None`` if nothing is known.

    A case takes the median of the finished ones of its reuse group. Where there are none, it takes the median of the
    group with the nearest number of unknowns (by their ratio), times that ratio; where that number is not known, the
    median over the groups.

    Args:
        reuse_groups: of all cases by key.
        outcomes: of the finished ones by key.
        unknowns: number of unknowns by reuse group, where it is known before a case is finished.
    """
    finished: dict[str, list[float]] = {}
    sizes = dict(unknowns or {})
    for key, outcome in outcomes.items():
        finished.setdefault(reuse_groups[key], []).append(outcome.seconds)
        if outcome.unknowns is not None:
            sizes.setdefault(reuse_groups[key], outcome.unknowns)
    medians = {reuse_group: statistics.median(seconds) for reuse_group, seconds in finished.items()}
    if not medians:
        return None

    @cache
    def seconds_of(reuse_group: str) -> float:
        if reuse_group in medians:
            return medians[reuse_group]
        ratios = {s: sizes[reuse_group] / sizes[s] for s in medians if {s, reuse_group} <= sizes.keys()}
        if not ratios:
            return statistics.median(medians.values())
        nearest = min(ratios, key=lambda s: abs(math.log(ratios[s])))
        return medians[nearest] * ratios[nearest]

    return sum(seconds_of(group) for key, group in reuse_groups.items() if key not in outcomes)


def duration_text(seconds: float) -> str:
    """Return a duration in the unit that suits it, such as ``45 s``, ``12 min``, ``3.4 h`` or ``2.1 days``."""
    for limit, unit, name in ((100, 1, "s"), (100 * 60, 60, "min"), (72 * 3600, 3600, "h")):
        if seconds < limit:
            return f"{seconds / unit:.0f} {name}" if seconds >= 10 * unit else f"{seconds / unit:.1f} {name}"
    return f"{seconds / 86400:.1f} days"
