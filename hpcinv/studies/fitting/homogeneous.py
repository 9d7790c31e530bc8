"""Stress of isotropic laws in the homogeneous deformations of material tests.

The energy is the law's one formula, as a function of the principal stretches and of the parameters; stress, its slopes
by the parameters and the tangent are its exact derivatives. A free lateral stretch is as of an incompressible
material, or it is solved for, so that the lateral stress vanishes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.schema import KeyPath
from hpcinv.base.quantity.taylor import FUNCTIONS, Taylor
from hpcinv.physics.materials.material_law import MaterialLaw

_MOST_ITERATIONS = 100  # of Newton's method for the lateral stretch
_LARGEST_STEP = 0.3  # of its logarithm


@dataclass(frozen=True)
class Mode:
    """A kind of test.

    Attributes:
        measure: what its strain column states, after conversion: a stretch, an amount of shear, or a volume ratio.
        stretches: principal stretches (n, 3) from the measure (n,), of an incompressible material where one is free.
        free: which of them have no stress, if the material is compressible.
        rest_measure: the measure of the undeformed state.
    """

    name: str
    measure: str
    stretches: Callable[[Floats], Floats]
    free: tuple[int, ...] = ()
    rest_measure: float = 1.0

    @property
    def is_shear(self) -> bool:
        return self.name == "simple-shear"

    @property
    def is_volumetric(self) -> bool:
        return self.name == "volumetric"


def _shear_stretches(shear: Floats) -> Floats:
    largest = shear / 2 + np.sqrt(1 + shear**2 / 4)
    return np.stack([largest, np.ones_like(shear), 1 / largest], axis=1)


MODES: dict[str, Mode] = {
    mode.name: mode
    for mode in (
        Mode("uniaxial", "stretch", lambda x: np.stack([x, x**-0.5, x**-0.5], axis=1), (1, 2)),
        Mode("equibiaxial", "stretch", lambda x: np.stack([x, x, x**-2.0], axis=1), (2,)),
        Mode("planar", "stretch", lambda x: np.stack([x, np.ones_like(x), 1 / x], axis=1), (2,)),
        Mode("simple-shear", "amount of shear", _shear_stretches, rest_measure=0.0),
        Mode("volumetric", "volume ratio", lambda x: np.stack([np.cbrt(x)] * 3, axis=1)),
    )
}
"""Kinds of tests by name; ``planar`` is also called pure shear."""


def name_in_formula(place: KeyPath) -> str:
    """Return the name in a law's formula of the number at a place, such as ``mu1`` of ``("mu", 0)``."""
    name, *rest = place
    if name == "parameters":
        return str(rest[0])
    return f"{name}{int(rest[0]) + 1}" if rest else str(name)


class Response:
    """Stress and tangent of a law as functions of some of its parameters.

    Args:
        law: an isotropic law; an incompressible one has no volumetric energy.
        places: keys of these parameters, in the order in which their values are given.
    """

    def __init__(self, law: MaterialLaw, places: Sequence[KeyPath]) -> None:
        self.is_incompressible = law.is_incompressible
        self._energy = Expression(law.own_formula if law.is_incompressible else law.energy_formula)
        self._names = [name_in_formula(place) for place in places]
        self._constants = _constants(law)

    def energy(self, stretches: Floats, parameters: Floats, *, slopes: bool = True) -> Taylor:
        """Return the energy (Pa) at principal stretches (n, 3), differentiated by them and, then, by the parameters.

        Values that are not finite mark states in which the law is not defined.
        """
        count = 3 + (len(parameters) if slopes else 0)
        a, b, c = (Taylor.variable(stretches[:, i], i, count) for i in range(3))
        values: dict[str, Any] = dict(self._constants)
        for i, (name, value) in enumerate(zip(self._names, parameters, strict=True)):
            ones = np.full(len(stretches), value)
            values[name] = Taylor.variable(ones, 3 + i, count) if slopes else float(value)
        with np.errstate(all="ignore"):
            return self._energy_of(a, b, c, values)

    def _energy_of(self, a: Taylor, b: Taylor, c: Taylor, values: dict[str, Any]) -> Taylor:
        J = a * b * c
        a2, b2, c2 = a * a, b * b, c * c
        I1, I2, scale = a2 + b2 + c2, a2 * b2 + b2 * c2 + c2 * a2, J ** (-1 / 3)
        values |= {"J": J, "I1": I1, "I2": I2, "I1_bar": I1 * scale**2, "I2_bar": I2 * scale**4}
        values |= {f"lambda{i}_bar": stretch * scale for i, stretch in enumerate((a, b, c), start=1)}
        energy: Taylor = self._energy.apply(values, FUNCTIONS)
        return energy

    def state(self, mode: Mode, measure: Floats, parameters: Floats) -> Floats:
        """Return principal stretches (n, 3) in a test; not a number where there is no equilibrium."""
        stretches = mode.stretches(measure)
        if self.is_incompressible or not mode.free:
            return stretches
        free = list(mode.free)
        moving = np.ones(len(measure), dtype=bool)
        for _ in range(_MOST_ITERATIONS):
            W = self.energy(stretches, parameters, slopes=False)
            t = stretches[:, free[0]]
            residual = W.gradient[:, free].sum(axis=1)
            stiffness = W.hessian[:, free][:, :, free].sum(axis=(1, 2))
            with np.errstate(all="ignore"):
                newton = np.where(stiffness > 0, -residual / (stiffness * t), -np.sign(residual) * _LARGEST_STEP)
            step = np.where(moving, np.clip(newton, -_LARGEST_STEP, _LARGEST_STEP), 0.0)
            stretches[:, free] *= np.exp(step)[:, None]
            moving &= ~(np.abs(step) <= 1e-12)
            if not moving.any():
                break
        stretches[moving] = np.nan
        return stretches

    def stress(self, mode: Mode, measure: Floats, parameters: Floats, *, cauchy: bool = False) -> tuple[Floats, Floats]:
        """Return the stress (n,) of a test and its slopes by the parameters (n, k), in Pa.

        It is the nominal stress along the first direction (dead load per undeformed area), or Cauchy's; in simple shear
        the shear stress, which is both; in volumetric tests the pressure.
        """
        return self.stresses([(mode, measure, cauchy)], parameters)[0]

    def stresses(self, tests: Sequence[tuple[Mode, Floats, bool]], parameters: Floats) -> list[tuple[Floats, Floats]]:
        """Return stress and slopes as ``stress`` does, of several tests (mode, measure, whether Cauchy's) at once."""
        stretches = [self.state(mode, measure, parameters) for mode, measure, _ in tests]
        W = self.energy(np.concatenate(stretches), parameters)
        ends = np.cumsum([len(part) for part in stretches])
        parts = [slice(end - len(part), end) for end, part in zip(ends, stretches, strict=True)]
        return [
            self._stress(mode, of_test, W.gradient[part], W.hessian[part], cauchy=cauchy)
            for (mode, _, cauchy), of_test, part in zip(tests, stretches, parts, strict=True)
        ]

    def _stress(
        self, mode: Mode, stretches: Floats, gradient: Floats, hessian: Floats, *, cauchy: bool
    ) -> tuple[Floats, Floats]:
        weights = _stress_weights(mode, stretches, incompressible=self.is_incompressible)
        stretch_slopes, parameter_slopes = hessian[:, :3, :3], hessian[:, :3, 3:]
        stress = np.einsum("ni,ni->n", weights, gradient[:, :3])
        slopes = np.einsum("ni,nik->nk", weights, parameter_slopes)
        factor = 1 / (stretches[:, 1] * stretches[:, 2]) if cauchy and mode.free else np.ones(len(stretches))
        if self.is_incompressible or not mode.free:
            return factor * stress, factor[:, None] * slopes
        free = list(mode.free)
        # The lateral stretch follows the parameters so that its stress stays zero.
        lateral = -parameter_slopes[:, free].sum(axis=1) / stretch_slopes[:, free][:, :, free].sum(axis=(1, 2))[:, None]
        slopes += np.einsum("ni,nij->nj", weights, stretch_slopes)[:, free].sum(axis=1)[:, None] * lateral
        if cauchy:
            thinning = -len(free) / stretches[:, free[0]]
            slopes += (stress * thinning)[:, None] * lateral
        return factor * stress, factor[:, None] * slopes


def _constants(law: MaterialLaw) -> dict[str, float]:
    values: Mapping[str, Any] = {name: value for name, (value, _) in law.quantities().items()}
    constants: dict[str, float] = {}
    for name, value in values.items():
        entries = {f"{name}{i}": v for i, v in enumerate(value, 1)} if isinstance(value, tuple) else {name: value}
        constants |= {n: float(v) for n, v in entries.items() if v is not None}
    return constants


def _stress_weights(mode: Mode, stretches: Floats, *, incompressible: bool) -> Floats:
    """Return the derivative (n, 3) of the principal stretches on which the stress of a test does work."""
    first, _, third = stretches.T
    weights = np.zeros_like(stretches)
    if mode.is_volumetric:
        weights[:] = -1 / (3 * stretches**2)
    elif mode.is_shear:
        weights[:, 0] = first**2 / (first**2 + 1)  # dλ/dγ of γ = λ - 1/λ
        weights[:, 2] = -weights[:, 0] / first**2
    else:
        weights[:, 0] = 1.0
        if incompressible:  # the pressure that makes the third direction free of stress
            weights[:, 2] = -third / first
    return weights
