"""Transverse shear of a shell of one layer: the shear correction factor 5/6 for any law.

The shear stress of a thin body is a parabola through the thickness. A displacement that is quadratic there has a
constant mean shear, and stores 6/5 of the energy at the same shear force. The tangential part of the deformed director
is therefore multiplied by √(5/6) before a law sees the deformation: with the gradient ``Z`` of the distance from the
surface in the reference body, and ``z = F⁻ᵀ Z`` in the current body,

    F̃ = F + (√(5/6) - 1) (F Z - (Z·Z/z·z) z) ⊗ Z / Z·Z.

Strains in the surface, the normal stretch and ``det F`` do not change; without transverse shear, ``F̃ = F``.
Displacements of degree 3 have the parabola and need no factor.

Source: Reissner, J. Appl. Mech. 12, A69–A77, 1945 (the factor).
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import ufl
from ufl.classes import Variable

from hpcinv.physics.kinematics.kinematics import Kinematics

FACTOR = 5 / 6
"""stiffness of transverse shear by its stiffness with constant strain; raised, shells are stiffer in shear"""


def corrected_for_shear(H: Variable, kin: Kinematics) -> Any:
    """Return the displacement gradient that laws see, ``F̃ - I``, in one layer of hexahedra.

    Args:
        H: displacement gradient, the variable of the laws' derivatives.
        kin: kinematics of the state; the third axis of its mesh's cells goes through the thickness.
    """
    mesh = ufl.domain.extract_unique_domain(kin.u)
    across = ufl.as_vector([ufl.JacobianInverse(mesh)[2, i] for i in range(3)])
    # A line of the material, by the kinematics' own gradient: laws are not differentiated by its direction.
    Z = across if kin.sign > 0 else ufl.transpose(ufl.Identity(3) + kin.H) * across
    z = ufl.variable(ufl.transpose(ufl.inv(ufl.Identity(3) + H)) * Z)
    # F Z - z, without subtracting large numbers; its part along z is not shear
    change = ufl.variable(H * Z + H.T * z)
    shear = change - ufl.inner(z, change) / ufl.inner(z, z) * z
    return ufl.variable(H + (sqrt(FACTOR) - 1) * ufl.outer(shear, Z) / ufl.inner(Z, Z))
