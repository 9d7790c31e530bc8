"""Sellier's fixed point, plain or relaxed."""

from __future__ import annotations

from typing import ClassVar

from hpcinv.methods.update import Floats, Update


class Sellier(Update):
    """``X ← X - ω r`` with a constant relaxation ω; with ω = 1 the paper's Algorithm 2.

    Sources: Sellier, J. Fluids Struct. 27, 1461–1470, 2011, doi:10.1016/j.jfluidstructs.2011.08.002;
    Mazier et al., Eng. Comput. 38, 4099–4113, 2022, doi:10.1007/s00366-021-01597-z.
    """

    names: ClassVar = ("sellier",)

    def step(self, X: Floats, r: Floats) -> Floats:
        return -self.relaxation * r
