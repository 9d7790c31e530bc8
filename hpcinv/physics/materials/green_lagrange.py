"""Laws whose exponent is a quadratic form of the Green–Lagrange strain."""

import re
from typing import Literal

from pydantic import Field

from hpcinv.physics.materials.isochoric import IsochoricLaw

_POWERS = {"I1": "-2/3", "I2": "-4/3", "I4": "-2/3", "I5": "-4/3", "I8": "-2/3"}
"""Powers of ``J`` that turn invariants of ``C`` into invariants of ``C_bar``; for I8 of orthogonal directions."""
_INVARIANT = re.compile(r"\b(I[1-8])\w*")


class GreenLagrangeLaw(IsochoricLaw):
    """A law of the strain ``E = (C - I)/2``, or of ``E = (C_bar - I)/2`` with ``C_bar = J^(-2/3) C``."""

    strain: Literal["total", "isochoric"] = Field(default="total", exclude_if=lambda strain: strain == "total")
    """strain in the exponent: of C (total), or of C_bar (isochoric); the same where the volume cannot change, where
    isochoric is more robust: cells of the mixed form keep their stiffness although their volume changes a little"""

    @property
    def own_formula(self) -> str:
        if self.strain == "total":
            return self.formula
        return _INVARIANT.sub(lambda match: f"({match[0]}*J**({_POWERS[match[1]]}))", self.formula)
