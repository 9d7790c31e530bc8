"""How long the open cases of a sweep will take, from the times of those that are finished."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from functools import cache


def forecast(
    reuse_groups: Iterable[str], finished: Mapping[str, Sequence[float]], unknowns: Mapping[str, int]
) -> float | None:
    """Seconds that open cases take one after the other; ``None`` if nothing has been finished that could tell.

    A case takes the median of what the finished ones of its reuse group took. Where there are none, it takes that of
    the group with the nearest number of unknowns (by their ratio), in proportion to them.

    Args:
        reuse_groups: of each open case.
        finished: seconds of finished cases by their reuse group.
        unknowns: number of unknowns by reuse group; where it is not known a case takes what the median group does.
    """
    medians = {reuse_group: statistics.median(seconds) for reuse_group, seconds in finished.items() if seconds}
    if not medians:
        return None

    @cache
    def of(reuse_group: str) -> float:
        if reuse_group in medians:
            return medians[reuse_group]
        ratios = {s: unknowns[reuse_group] / unknowns[s] for s in medians if {s, reuse_group} <= unknowns.keys()}
        if not ratios:
            return statistics.median(medians.values())
        nearest = min(ratios, key=lambda s: abs(math.log(ratios[s])))
        return medians[nearest] * ratios[nearest]

    return sum(map(of, reuse_groups))


def in_words(seconds: float) -> str:
    """A duration in the unit that suits it, such as ``45 s``, ``12 min``, ``3.4 h`` or ``2.1 days``."""
    for limit, unit, name in ((100, 1, "s"), (100 * 60, 60, "min"), (72 * 3600, 3600, "h")):
        if seconds < limit:
            return f"{seconds / unit:.0f} {name}" if seconds >= 10 * unit else f"{seconds / unit:.1f} {name}"
    return f"{seconds / 86400:.1f} days"
