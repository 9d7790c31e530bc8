"""Weight."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import Acceleration, DensityField, Triple
from hpcinv.physics.effects.effect import Configuration, Effect, Kinematics


class Gravity(Effect):
    """Uniform gravity, the dead load ``rho g`` per volume.

    ``density_in: reference`` means ``rho0`` per undeformed volume, ``∫ rho0 g·v dV``: the default, since tabulated
    densities are properties of the unloaded material. ``density_in: current`` means ``rho`` per deformed volume,
    ``∫ rho g·v dv``: for a density measured on the loaded body. The two agree if the volume does not change.
    """

    example: ClassVar = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": "1 g/cm^3"}

    attached: ClassVar = frozenset({"density"})

    effect: Literal["gravity"] = "gravity"
    acceleration: Triple[Acceleration]
    """acceleration of free fall, along x, y and z"""
    density: DensityField
    """mass density, not negative (of a body in a fluid: the difference of the two; if it is the lighter one, with the
    acceleration turned round)"""
    density_in: Configuration = "reference"
    """configuration whose volume the density refers to"""

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        weight = load * par.density * sum(g * v[i] for i, g in enumerate(par.acceleration))
        return k.dm(weight, self.density_in)
