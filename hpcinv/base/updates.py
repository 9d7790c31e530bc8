"""Update rules of the fixed-point method: the part in which plain, relaxed and accelerated methods differ.

Jobs have their names, so no module is imported here that a check of a job does not need.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from math import sqrt
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from hpcinv.base.quantity.arrays import Floats


class Update(ABC):
    """Rule for the next step of a search for ``r(X) = 0``, from all points at which the residual is known.

    A proposed step may be shortened: each rule depends on the points themselves.

    Args:
        relaxation: share of the first correction ``-r`` that is taken.
        memory: number of earlier steps that are used.
        inner: inner product of two arrays of the shape of ``X``, over all ranks.

    Attributes:
        names: names of the rule in a job.
    """

    names: ClassVar[tuple[str, ...]]

    def __init__(self, relaxation: float, memory: int, inner: Callable[[Floats, Floats], float]) -> None:
        self.relaxation, self.memory, self.inner = relaxation, memory, inner

    @abstractmethod
    def step(self, X: Floats, r: Floats) -> Floats:
        """Return the step from ``X``, where the residual is ``r``."""


class Sellier(Update):
    """``X ← X - ω r`` with a constant relaxation ω; with ω = 1 Algorithm 2 of the paper.

    Sources: Sellier, J. Fluids Struct. 27, 1461–1470, 2011, doi:10.1016/j.jfluidstructs.2011.08.002;
    Mazier et al., Eng. Comput. 38, 4099–4113, 2022, doi:10.1007/s00366-021-01597-z.
    """

    names: ClassVar = ("sellier",)

    def step(self, X: Floats, r: Floats) -> Floats:
        return -self.relaxation * r


class Aitken(Update):
    """Aitken's dynamic relaxation ``X ← X - ω r`` with one ω for all nodes, the secant slope along the last step:

        ω = ΔX·Δr / Δr·Δr,    ΔX, Δr: last changes of X and r.

    With ``ΔX = -ω r`` this is ``ω_{k+1} = -ω_k r_k·(r_{k+1} - r_k) / |r_{k+1} - r_k|²``, the vector form of Aitken's
    delta-squared process by Irons and Tuck. The augmented method of Rausch et al. has the same formula (their β is
    this ω), so ``rausch`` is another name for it. The first step has ω = ``relaxation``.

    Sources: Irons and Tuck, Int. J. Numer. Methods Eng. 1, 275–277, 1969, doi:10.1002/nme.1620010306;
    Küttler and Wall, Comput. Mech. 43, 61–72, 2008, doi:10.1007/s00466-008-0255-5;
    Rausch, Genet and Humphrey, J. Biomech. 58, 227–231, 2017, doi:10.1016/j.jbiomech.2017.04.021.
    """

    names: ClassVar = ("aitken", "rausch")

    _previous: tuple[Floats, Floats] | None = None

    def step(self, X: Floats, r: Floats) -> Floats:
        if self._previous is not None:
            dX, dr = X - self._previous[0], r - self._previous[1]
            square = self.inner(dr, dr)
            if square > 0:
                self.relaxation = self.inner(dX, dr) / square
        self._previous = X.copy(), r.copy()
        return -self.relaxation * r


class Anderson(Update):
    """Anderson acceleration, by the last ``memory`` changes ``ΔX``, ``Δr``:

        X ← X - ω r - (ΔX - ω Δr) γ,    γ = argmin |r - Δr γ|,

    a least-squares problem over all nodes, with ω = ``relaxation`` for the rest of the residual. It is solved by
    orthogonalising the changes ``Δr`` from the newest to the oldest; changes that depend linearly on newer ones to 8
    digits are left out.

    Sources: Anderson, J. ACM 12, 547–560, 1965, doi:10.1145/321296.321305;
    Walker and Ni, SIAM J. Numer. Anal. 49, 1715–1735, 2011, doi:10.1137/10078356X;
    Fang and Saad, Numer. Linear Algebra Appl. 16, 197–221, 2009, doi:10.1002/nla.617.
    """

    names: ClassVar = ("anderson",)

    _dependent = 1e-8

    def __init__(self, relaxation: float, memory: int, inner: Callable[[Floats, Floats], float]) -> None:
        super().__init__(relaxation, memory, inner)
        self._changes: deque[tuple[Floats, Floats]] = deque(maxlen=memory)
        self._previous: tuple[Floats, Floats] | None = None

    def step(self, X: Floats, r: Floats) -> Floats:
        if self._previous is not None:
            self._changes.append((X - self._previous[0], r - self._previous[1]))
        self._previous = X.copy(), r.copy()
        step, rest = 0 * X, r
        for q, s in self._orthonormal():
            share = self.inner(q, rest)
            step, rest = step - share * s, rest - share * q
        return step - self.relaxation * rest

    def _orthonormal(self) -> list[tuple[Floats, Floats]]:
        """Return orthonormal combinations of the changes of r, each with the same combination of changes of X."""
        pairs: list[tuple[Floats, Floats]] = []
        for dX, dr in reversed(self._changes):
            q, s, size = dr, dX, self._norm(dr)
            for q_i, s_i in [*pairs, *pairs]:  # twice, because of rounding errors
                share = self.inner(q_i, q)
                q, s = q - share * q_i, s - share * s_i
            left = self._norm(q)
            if left > self._dependent * size:
                pairs.append((q / left, s / left))
        return pairs

    def _norm(self, a: Floats) -> float:
        return sqrt(self.inner(a, a))


UPDATES: dict[str, type[Update]] = {name: rule for rule in Update.__subclasses__() for name in rule.names}
"""rules by the names that jobs have for them"""
