"""Base class of the laws in Lamé's parameters."""

from typing import Any

from hpcinv.physics.materials.material_law import MaterialLaw


class LameLaw(MaterialLaw):
    """A law with the fields ``mu`` and ``lam``, where ``kappa = lam + 2/3 mu``; ``lam`` is the volumetric modulus."""

    replaceable = ("mu", "lam")
    bulk_measure = "lame"

    def bulk_modulus(self, par: Any) -> Any:
        return par.lam + 2 / 3 * par.mu

    def volumetric_modulus(self, par: Any) -> Any:
        return par.lam
