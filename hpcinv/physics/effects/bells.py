"""Fields of few numbers: sums of bells around points in space."""

from collections.abc import Sequence
from typing import Any


def bells(x: Any, centres: Any, width: Any, count: int) -> Sequence[Any]:
    """Return ``exp(-|x - cᵢ|²/(2 w²))`` for each of the ``count`` points cᵢ."""
    import ufl  # not at the head: the check of a job needs none

    squares = [sum((x[i] - centres[number, i]) ** 2 for i in range(3)) for number in range(count)]
    return [ufl.exp(-square / (2 * width**2)) for square in squares]
