"""Plane in which the corrector of a path seeks the next state, with the load factor as an unknown (Riks).

    t·(x - x_predicted) = 0

Source: Riks, Int. J. Solids Struct. 15, 529-551, 1979, doi:10.1016/0020-7683(79)90081-7.
"""

import math
from dataclasses import dataclass

from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot


@dataclass
class PathPlane:
    """The plane through the state where a solve begins that is normal to ``t``; corrections stay in it.

    Attributes:
        t: unit vector; ``None`` where only the tangent of the path is asked for.
        load: present load factor.
        cases: number of load cases; derivatives by the load factor jump at the end of each.
        direction: 1 or -1, direction of the load factor, which matters at the end of a load case.
        scale: change of the load factor that counts as much as one of the state by its norm.
    """

    load: float
    cases: int
    direction: int = 1
    scale: float = 1.0
    t: PETSc.Vec | None = None

    def slope(self, direction: PETSc.Vec) -> float:
        return 1.0 if self.t is None else dot(self.t, direction)

    def difference_step(self, load: float) -> float:
        """Return a small change of the load factor towards the middle of the load case in this direction."""
        position = load * self.cases
        case = math.floor(position + self.direction * 1e-9)
        middle = min(max(case, 0), self.cases - 1) + 0.5
        return math.copysign(1e-3, middle - position) / self.cases
