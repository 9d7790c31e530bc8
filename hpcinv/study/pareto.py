"""Which runs are worth their time: the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence


def front(points: Sequence[tuple[float | None, float | None]]) -> list[bool]:
    """Of points (cost, error), which no other one beats: none costs as little and errs as little, and one of both less.

    A point with a ``None`` is not on the front.
    """
    known = [(cost, error) for cost, error in points if cost is not None and error is not None]
    return [
        cost is not None
        and error is not None
        and not any(c <= cost and e <= error and (c, e) != (cost, error) for c, e in known)
        for cost, error in points
    ]
