"""What the scene asks of a material law."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from pydantic import model_validator

from hpcinv.ingredient import Ingredient
from hpcinv.schema import raise_if_any
from hpcinv.varying import ELSEWHERE, ByRegion, is_uniform

if TYPE_CHECKING:
    from hpcinv.kinematics import Deformation


class MaterialLaw(Ingredient):
    """A hyperelastic law ``psi = distortion + dilatation_modulus/2 · dilatation²``.

    A subclass with a literal field ``law`` is registered by that. Its parameters are fields. The energy reads them,
    scaled, from ``par`` by the same names; the moduli read them from ``par`` as floats, arrays or UFL scalars.
    """

    formula: ClassVar[str]
    """The energy without its volumetric part, as a law 'formula' would have it."""

    @property
    @abstractmethod
    def volumetric_formula(self) -> str:
        """The volumetric energy, ``dilatation_modulus/2 · dilatation²``, likewise."""

    @abstractmethod
    def distortion(self, k: Deformation, par: Any) -> Any:
        """The energy per reference volume without its volumetric part, as a UFL expression."""

    @abstractmethod
    def dilatation(self, k: Deformation) -> Any:
        """The volumetric strain ``theta``, zero at ``F = I``, whose conjugate is the pressure of the mixed form."""

    @abstractmethod
    def dilatation_modulus(self, par: Any) -> Any:
        """Stiffness against ``dilatation``; infinite if the material is incompressible."""

    @abstractmethod
    def shear_modulus(self, par: Any) -> Any:
        """Shear modulus ``mu`` of the undeformed material, without what its fibres add."""

    @abstractmethod
    def bulk_modulus(self, par: Any) -> Any:
        """Bulk modulus ``kappa`` of the undeformed material; infinite if it is incompressible."""

    def domain(self, k: Deformation, par: Any) -> tuple[Any, ...]:
        """UFL scalars that are positive where the law is defined."""
        return ()

    @property
    def energy_formula(self) -> str:
        """The whole energy, as a law 'formula' would have it."""
        return f"{self.formula} + {self.volumetric_formula}"

    @property
    def is_split(self) -> bool:
        """Whether the volumetric energy stands apart, so that its pressure can be an unknown."""
        return True

    @property
    def is_incompressible(self) -> bool:
        """Whether the volume cannot change."""
        return any(value == math.inf for value, _ in self.quantities().values())

    @property
    def stiffness_ratio(self) -> float | None:
        """Largest ratio of bulk to shear modulus; ``None`` if only the mesh can tell."""
        if self.is_incompressible:
            return math.inf
        return max((self.bulk_modulus(par) / self.shear_modulus(par) for par in self.cases()), default=None)

    def cases(self) -> Iterator[Any]:
        """Namespaces of numbers (SI), one for each region that parameters tell apart; none if they are fields."""
        values = {name: value for name, (value, _) in self.quantities().items()}
        entries = [e for v in values.values() for e in (v if isinstance(v, tuple) else (v,))]
        by_region = [e for e in entries if isinstance(e, ByRegion)]
        if not all(is_uniform(e) or isinstance(e, ByRegion) for e in entries):
            return
        for region in dict.fromkeys(name for e in by_region for name in e.values) or [ELSEWHERE]:
            if all(e.at(region) is not None for e in by_region):
                yield SimpleNamespace(**{name: _at(value, region) for name, value in values.items()})

    @model_validator(mode="after")
    def _is_stable(self) -> Self:
        moduli = {"shear modulus": self.shear_modulus, "bulk modulus": self.bulk_modulus}
        raise_if_any(
            ((), f"the {name} that follows from these parameters must be positive, but is {value:g} Pa")
            for par in self.cases()
            for name, modulus in moduli.items()
            if not (value := modulus(par)) > 0
        )
        return self


def _at(value: Any, region: str) -> Any:
    """A quantity in one region."""
    if isinstance(value, tuple):
        return tuple(_at(entry, region) for entry in value)
    return value.at(region) if isinstance(value, ByRegion) else value
