"""Penalty of contact that follows the solves: softer after one that failed, stiffer where updates are slow.

A slender body gives way to a pressure by far more than its modulus says, and Newton's method leaves it where surfaces
that begin to touch are as stiff as the material. Updates of the pressure find the same solution with any penalty.
"""

from hpcinv.model.outcome import Outcome

_FACTOR = 8.0
"""Change of the penalty after a solve that failed. Raised, fewer solves fail; surfaces overlap more in load steps."""
_SOFTEST = 2.0**-15  # bodies are as soft that are 30 times as long as thick
_SLOW = 0.1  # share of the change before, above which an update is slow
STIFF = (Outcome.DIVERGED, Outcome.INVERTED, Outcome.ITERATION_LIMIT, Outcome.OUTSIDE_LAW)


class Softening:
    """Share of the first penalty at present, in ``share``."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin with the first penalty."""
        self.share, self._before = 1.0, float("inf")

    def after_failure(self, outcome: Outcome) -> bool:
        """Follow a solve that failed; return whether the share has changed."""
        before = self.share
        if outcome in STIFF:
            self.share = max(self.share / _FACTOR, _SOFTEST)
        elif outcome is Outcome.PASSED_THROUGH:
            self.share = min(self.share * _FACTOR, 1.0)
        return self.share != before

    def after_update(self, size: float) -> bool:
        """Follow an update of the pressures of a size; return whether the share has changed."""
        is_slow, self._before = size > _SLOW * self._before, size
        if not is_slow or self.share == 1.0:
            return False
        self.share, self._before = min(self.share * _FACTOR, 1.0), float("inf")
        return True
