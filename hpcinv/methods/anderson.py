"""Anderson acceleration."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import sqrt
from typing import ClassVar

from hpcinv.methods.update import Floats, Update


class Anderson(Update):
    """The step that removes the residual as far as the last ``memory`` changes ``ΔX``, ``Δr`` explain it:

        X ← X - ω r - (ΔX - ω Δr) γ,    γ = argmin |r - Δr γ|,

    a least-squares problem over all nodes, with ω = ``relaxation`` for what no earlier step explains. It is solved
    by orthogonalising the changes ``Δr`` from the newest to the oldest; one that newer ones explain to 8 digits would
    only carry noise and is left out.

    Sources: Anderson, J. ACM 12, 547–560, 1965, doi:10.1145/321296.321305;
    Walker and Ni, SIAM J. Numer. Anal. 49, 1715–1735, 2011, doi:10.1137/10078356X;
    Fang and Saad, Numer. Linear Algebra Appl. 16, 197–221, 2009, doi:10.1002/nla.617.
    """

    names: ClassVar = ("anderson",)

    _dependent = 1e-8

    def __init__(self, relaxation: float, memory: int, inner: Callable[[Floats, Floats], float]) -> None:
        super().__init__(relaxation, memory, inner)
        self._changes: deque[tuple[Floats, Floats]] = deque(maxlen=memory)
        self._before: tuple[Floats, Floats] | None = None

    def step(self, X: Floats, r: Floats) -> Floats:
        if self._before is not None:
            self._changes.append((X - self._before[0], r - self._before[1]))
        self._before = X.copy(), r.copy()
        step, rest = 0 * X, r
        for q, s in self._orthonormal():
            share = self.inner(q, rest)
            step, rest = step - share * s, rest - share * q
        return step - self.relaxation * rest

    def _orthonormal(self) -> list[tuple[Floats, Floats]]:
        """The changes of r, orthonormal, each with the change of X that belongs to it."""
        pairs: list[tuple[Floats, Floats]] = []
        for dX, dr in reversed(self._changes):
            q, s, size = dr, dX, self._norm(dr)
            for q_i, s_i in [*pairs, *pairs]:  # once leaves rounding errors, twice is enough
                share = self.inner(q_i, q)
                q, s = q - share * q_i, s - share * s_i
            left = self._norm(q)
            if left > self._dependent * size:
                pairs.append((q / left, s / left))
        return pairs

    def _norm(self, a: Floats) -> float:
        return sqrt(self.inner(a, a))
