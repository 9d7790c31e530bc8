"""Cards of other programs, their energies, and states of a body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpmath import mp

from hpcinv.base.quantity.expressions import LET, Expression
from hpcinv.formats.cards.card import Counterpart
from hpcinv.job.preamble import resolve
from hpcinv.physics.materials import MaterialLaw, laws

MPMATH = {name: getattr(mp, name) for name in ("exp", "ln", "sqrt")} | {"max": max, "min": min}
AXES = {"a": (0.6, 0.8, 0.0), "b": (-0.8, 0.6, 0.0), "c": (0.0, 0.0, 1.0)}


class State:
    """Invariants of a deformation in mpmath, by their definitions."""

    def __init__(self, F: Any) -> None:
        self.C = F.T * F
        self.J = mp.det(F)
        self.I1 = sum(self.C[i, i] for i in range(3))
        self.I2 = (self.I1**2 - sum((self.C * self.C)[i, i] for i in range(3))) / 2
        self.I1_bar, self.I2_bar = self.I1 * self.J ** (-mp.mpf(2) / 3), self.I2 * self.J ** (-mp.mpf(4) / 3)
        self.stretches = [mp.sqrt(x) for x in mp.eigsy(self.C, eigvals_only=True)]

    def powers(self, alpha: float) -> Any:
        """Return the sum of powers of the isochoric stretches, less 3."""
        return sum((x * self.J ** (-mp.mpf(1) / 3)) ** alpha for x in self.stretches) - 3

    def I4(self, direction: Any, power: int = 1) -> Any:
        a = mp.matrix([float(x) for x in direction])
        return (a.T * self.C**power * a)[0]

    def strains(self) -> list[Any]:
        """Return Green's strains 11, 22, 33 and twice those 12, 13, 23 along `AXES`."""
        axes = [mp.matrix(axis) for axis in AXES.values()]
        green = [[(a.T * (self.C - mp.eye(3)) * b)[0] / 2 for b in axes] for a in axes]
        return [green[i][i] for i in range(3)] + [2 * green[i][j] for i, j in ((0, 1), (0, 2), (1, 2))]


def volumetric(x: Any) -> Any:
    return mp.eye(3) * mp.cbrt(x)


def material(kind: str, **parameters: float | str) -> str:
    body = "".join(f"<{key}>{value}</{key}>" for key, value in parameters.items())
    return f'<material id="1" type="{kind}">{body}</material>'


def law_of(converted: Counterpart, unit: str = "MPa") -> MaterialLaw:
    section = converted.section(unit)
    context = {LET: resolve({name: Expression(text) for name, text in converted.definitions.items()})}
    return laws()[section["law"]].model_validate(section, context=context)


def energy(law: MaterialLaw, s: State, directions: Any, definitions: Mapping[str, str]) -> Any:
    """The energy of a law (MPa), by its formula."""
    values: dict[str, Any] = {name: getattr(s, name) for name in ("J", "I1", "I2", "I1_bar", "I2_bar")}
    scale = s.J ** (-mp.mpf(1) / 3)
    values |= {f"lambda{i}_bar": x * scale for i, x in enumerate(s.stretches, 1)}
    values |= {f"I{3 + k}_{family}": s.I4(a, k) for family, a in directions.items() for k in (1, 2)}
    for name, (value, _) in law.quantities().items():
        entries = {f"{name}{i}": v for i, v in enumerate(value, 1)} if isinstance(value, tuple) else {name: value}
        values |= {n: mp.mpf(v) for n, v in entries.items() if v is not None}
    for name, text in definitions.items():
        values[name] = Expression(text).apply(values, MPMATH)
    return Expression(law.energy_formula).apply(values, MPMATH) / 10**6
