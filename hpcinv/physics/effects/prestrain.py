"""Prestrain."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import Family, Faults, KeyPath, ListOf, PositiveField, TensorField
from hpcinv.base.quantity.schema import repeated
from hpcinv.base.quantity.spatial_fields import in_each_region
from hpcinv.base.quantity.tensor_fields import components, least_determinant
from hpcinv.physics.effects.effect import Configuration, Deformation, Effect


class Prestrain(Effect):
    """A field of stress-free stretch ``F0``: small pieces cut out of the reference body would relax to it.

    The law sees the elastic part ``F F0⁻¹``: stresses follow from ``det F0 psi(F F0⁻¹)`` per reference volume, and an
    incompressible material has ``J = det F0``. Fibres are lines of the material, in a relaxed piece along ``F0 a0``,
    so that a rotation in ``F0`` has no effect. The load factor scales ``F0 - I``.

    ``F0`` is a ``tensor`` with the axes x, y, z, or has ``stretches`` along families of fibres. A tensor ``G`` that is
    given on the current body is ``F0 = F⁻¹ G F`` on the reference body: it stretches the lines of the material that lie
    along its eigenvectors. Fibres of the current body are pulled back in the same way. In all cases formulas can use
    positions in both bodies.

    The prestrain stress in the results is the Cauchy stress at ``F = I`` that prestrain alone causes, without the
    pressure of an incompressible material (its deviator), which ``F0`` does not determine.

    Source: Chuong & Fung (1986), doi:10.1115/1.3138600.
    """

    example: ClassVar = {
        "effect": "prestrain",
        "tensor": [[1.1, 0.05, 0], [0.05, 0.95, 0], [0, 0, 1.02]],
        "given_on": "reference",
    }
    writes_its_stress: ClassVar = True

    effect: Literal["prestrain"] = "prestrain"
    tensor: TensorField | None = None
    """F0: 3 rows of 3 numbers or formulas, 3 numbers on the diagonal, one such tensor for each region, or an array of
    the mesh file with 9 components"""
    given_on: Configuration | None = None
    """body on which the tensor is given: the reference (undeformed) or the current (deformed) one"""
    fibres: ListOf[Family] = ()
    """families of fibres along which there are stretches: one, or two or three with different directions"""
    stretches: ListOf[PositiveField] | None = None
    """stretch along and across one family; or along each of three families, or along two and normal to both"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if (self.tensor is None) == (not self.fibres):
            yield (), "needs exactly one of 'tensor' (F0) and 'fibres' (with stretches along them)"
            return
        if self.tensor is not None:
            if self.given_on is None:
                text = "is needed: body on which the tensor is given, the reference or the current one"
                yield ("given_on",), text
            if self.stretches is not None:
                yield ("stretches",), "are not valid without 'fibres'"
            yield from self._inversions()
            return
        if self.given_on is not None:
            yield ("given_on",), "is not valid with 'fibres', which say themselves on which body they are given"
        if len(self.fibres) > 3:
            yield ("fibres",), f"must name three families at most, not {len(self.fibres)}"
            return
        for i in repeated(self.fibres):
            yield ("fibres", i), f"'{self.fibres[i]}' is duplicated"
        wanted = 2 if len(self.fibres) == 1 else 3
        if self.stretches is None or len(self.stretches) != wanted:
            what = ("along and across the fibres", "along the two families and normal to both", "along each family")
            text = f"must be {wanted}, {what[len(self.fibres) - 1]}, not {len(self.stretches or ())}"
            yield ("stretches",), text

    def _inversions(self) -> Faults:
        """Yield problems of tensors that are plain numbers; fields are checked on the mesh."""
        for region, tensor in in_each_region(self.tensor):
            F0 = components(tensor)
            where: KeyPath = ("tensor", region) if region else ("tensor",)
            if (determinant := float(_determinant(F0))) <= 0:
                yield where, f"inverts the material: det F0 must be above 0, not {determinant:g}"
            elif (least := float(least_determinant(F0))) <= 0:
                text = f"inverts the material on the way from I to F0, where the determinant falls to {least:g}"
                yield where, f"{text}: leave out its rotation, and give the stretch U of F0 = R U"

    def positive(self, par: Any, directions: Mapping[str, Any]) -> Mapping[str, Any]:
        if self.tensor is not None:
            F0 = components(par.tensor)
            return {
                "det F0": _determinant(F0),
                "det F0 on the way from I to F0 (give it without rotation)": least_determinant(F0),
            }
        if len(self.fibres) == 1:
            return {}
        return {"the volume that the directions of its fibres span": _spanned([directions[f] for f in self.fibres])}

    @property
    def strain_given_on(self) -> Configuration:
        return self.given_on or "reference"

    def inelastic_strain(self, k: Deformation, load: Any, par: Any) -> Any:
        if self.tensor is not None:
            return load * (par.tensor - k.I)
        if len(self.fibres) == 1:
            axial, lateral = par.stretches[0], par.stretches[1]
            return load * ((lateral - 1) * k.I + (axial - lateral) * k.fibre(self.fibres[0]).dyad)
        return load * k.axial_strain(self.fibres, [stretch - 1 for stretch in par.stretches])


def _determinant(tensor: Any) -> Any:
    import numpy as np

    return np.linalg.det(tensor)


def _spanned(directions: Sequence[Any]) -> Any:
    """Area or volume of two or three unit vectors (…, 3), zero where it is zero to rounding."""
    import numpy as np

    normal = np.cross(directions[0], directions[1])
    size = np.linalg.norm(normal, axis=-1) if len(directions) == 2 else abs((normal * directions[2]).sum(axis=-1))
    return np.where(size < 1e-8, 0.0, size)
