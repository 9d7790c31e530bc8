"""Aitken's dynamic relaxation, which is also the augmentation of Rausch, Genet and Humphrey."""

from __future__ import annotations

from typing import ClassVar

from hpcinv.methods.update import Floats, Update


class Aitken(Update):
    """``X ← X - ω r`` with one ω for all nodes, the secant slope along the last step:

        ω = ΔX·Δr / Δr·Δr,    ΔX, Δr: last changes of X and r.

    With ``ΔX = -ω r`` this is ``ω_{k+1} = -ω_k r_k·(r_{k+1} - r_k) / |r_{k+1} - r_k|²``, the vector form of Aitken's
    delta-squared process by Irons and Tuck. The augmented method of Rausch et al. has the same formula (their β is
    this ω), so ``rausch`` is another name for it. The first step has ω = ``relaxation``.

    Sources: Irons and Tuck, Int. J. Numer. Methods Eng. 1, 275–277, 1969, doi:10.1002/nme.1620010306;
    Küttler and Wall, Comput. Mech. 43, 61–72, 2008, doi:10.1007/s00466-008-0255-5;
    Rausch, Genet and Humphrey, J. Biomech. 58, 227–231, 2017, doi:10.1016/j.jbiomech.2017.04.021.
    """

    names: ClassVar = ("aitken", "rausch")

    _before: tuple[Floats, Floats] | None = None

    def step(self, X: Floats, r: Floats) -> Floats:
        if self._before is not None:
            dX, dr = X - self._before[0], r - self._before[1]
            square = self.inner(dr, dr)
            if square > 0:
                self.relaxation = self.inner(dX, dr) / square
        self._before = X.copy(), r.copy()
        return -self.relaxation * r
