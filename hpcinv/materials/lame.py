"""What the laws in Lamé's parameters have in common."""

from __future__ import annotations

from typing import Any

from hpcinv.materials.base import MaterialLaw


class LameLaw(MaterialLaw):
    """A law with the fields ``mu`` and ``lam``: ``kappa = lam + 2/3 mu``, and ``lam`` stiffens the dilatation."""

    replaceable = ("mu", "lam")
    bulk_measure = "lame"

    def shear_modulus(self, par: Any) -> Any:
        return par.mu

    def bulk_modulus(self, par: Any) -> Any:
        return par.lam + 2 / 3 * par.mu

    def dilatation_modulus(self, par: Any) -> Any:
        return par.lam
