"""Contact with a rigid obstacle."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import Faults, Length, StiffnessField, StressField, Surface, Triple
from hpcinv.base.quantity.nondimensional import LengthsOfBody
from hpcinv.base.quantity.quantity import Size
from hpcinv.base.quantity.units import Dimension
from hpcinv.physics.closures import CLOSURES, ClosureName, contradicting_closure
from hpcinv.physics.closures.known import Known
from hpcinv.physics.effects.effect import Direction, Effect, Kinematics
from hpcinv.physics.effects.obstacles import AnyObstacle
from hpcinv.physics.kinematics.stable_functions import positive_part, rounded_positive_part

PENALTY = 2.0**6
"""Penalty of a rigid obstacle at first, if none is given, in units of shear modulus over length of the body; lower for
thin shells. If raised, the pressure settles in fewer updates, and points of slender bodies go in and out of contact."""
QUADRATURE = 4
"""Least degree of quadrature on facets, whose points resolve the edge of the area in contact."""
TOLERANCE = 2.0**-16
"""Tolerated penetration where none is given, in lengths of the body; larger ones take fewer updates."""


class Contact(Effect):
    """Contact with a rigid obstacle, which only pushes, without friction or with Coulomb friction.

    Its traction is ``t = p m`` per current area, where ``m`` is the direction away from the obstacle, and ``g`` the gap
    (signed distance) at the current position.

    Rigid obstacle: ``p = max(0, q - penalty g)``, where ``q`` at the vertices is updated to ``p`` (augmented
    Lagrangian, Uzawa) until the penetration is below ``penetration``. It needs a forward solve: a given deformed shape
    does not determine ``p``.

    Elastic layer, with ``stiffness``: ``p = max(0, stiffness (stand_off - g))``, which a given deformed shape
    determines. If it presses on the undeformed body in a forward solve, it grows with the load factor.

    Known contact pressure, with ``pressure``, on a given deformed shape: ``p = max(0, pressure - penalty g)``.

    ``max(0, ·)`` is rounded where the penetration is less than a quarter of ``penetration``.

    With ``friction`` or a ``closure`` the obstacle is rigid, and takes the part of the second surface of an interface:
    pressures and tangential tractions ``|t| <= friction p`` are at the vertices of the region, and gaps are means
    around these. On a given deformed shape a ``closure`` says what determines them.

    Source: Wriggers (2006), Computational Contact Mechanics, doi:10.1007/978-3-540-32609-0; Simo & Laursen (1992),
    doi:10.1016/0045-7949(92)90540-G.
    """

    example: ClassVar = {
        "effect": "contact",
        "region": "x1",
        "obstacle": {"shape": "plane", "point": ["0.9 m", 0, 0], "normal": [-1, 0, 0]},
        "stiffness": "60 kPa/m",
    }

    effect: Literal["contact"] = "contact"
    region: Surface
    """region of the boundary"""
    obstacle: AnyObstacle
    """its shape: plane, sphere, cylinder, level-set (a formula) or surface (triangles in a file)"""
    travel: Triple[Length] | None = None
    """displacement of the obstacle, which grows with the load factor from where 'obstacle' places it"""
    stiffness: StiffnessField | None = None
    """pressure per penetration of an elastic layer on the obstacle; without it the obstacle is rigid"""
    stand_off: Length | None = None
    """gap below which the elastic layer presses, by default 0"""
    pressure: StressField | None = None
    """known contact pressure, for an inverse analysis; with 'closure: pressure' at vertices, a formula of x, y and z"""
    penalty: StiffnessField | None = None
    """pressure per penetration of a rigid obstacle in each solve; by default 64 shear moduli per length of the body,
    less for shells thinner than 1/50 of it, which grow up to 64 times that; 0 with a known pressure"""
    penetration: Size | None = None
    """largest penetration of a rigid obstacle at vertices; by default 1/65536 of the length of the body; with a known
    pressure and a penalty, the value of the forward solve, which rounds the pressure where contact ends"""
    friction: float = 0.0
    """coefficient of Coulomb friction on a rigid obstacle: the tangential traction is at most this multiple of the
    pressure"""
    closure: ClosureName | None = None
    """assumption on the pressure of a rigid obstacle on a given deformed shape, which does not determine it: one of
    the `closures`"""
    rest_gap: Length | None = None
    """gap of the unloaded body with 'closure: gap'"""
    touches_within: Length | None = None
    """gap of the given body up to which a 'closure' lets it press; by default 1/256 of its length"""
    known: Known = Known()
    """bounds of what the given shape does not determine, for `uncertainty: contact`"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        yield from contradicting_closure(self, () if self.friction else ("pressure",))
        if self.closure is not None and CLOSURES[self.closure].searched_from:
            yield ("closure",), f"'{self.closure}' is for interfaces: choose another one on a rigid obstacle"
        if self.is_paired:
            text = "is not valid with 'friction' or a 'closure', which have a rigid obstacle and no such number"
            names = ("stiffness", "penalty", "penetration")
            yield from (((name,), text) for name in names if getattr(self, name) is not None)
        if self.stiffness is not None:
            text = "is not valid with 'stiffness': there the penetration determines the pressure"
            yield from (((name,), text) for name in ("pressure", "penalty") if getattr(self, name) is not None)
        elif self.stand_off is not None:
            yield ("stand_off",), "is not valid without 'stiffness': a rigid obstacle has no elastic layer"

    @property
    def is_paired(self) -> bool:
        return self.friction != 0 or self.closure is not None

    @property
    def is_augmented(self) -> bool:
        """True if the contact pressure is found by iteration."""
        return self.stiffness is None and self.pressure is None

    @property
    def presses_at_any_load(self) -> bool:
        return self.stiffness is not None

    @property
    def assumption(self) -> str:
        """Assumption that determines the contact pressure."""
        if self.stiffness is not None:
            return "pressure = stiffness × penetration of an elastic layer (assumed)"
        if self.pressure is not None:
            return "pressure given by the job (assumed)"
        return "rigid and frictionless obstacle"

    def faults(self, first: Direction) -> Faults:
        if first == "inverse" and self.is_augmented and not self.is_paired:
            text = (
                "the contact pressure on a given deformed body is not determined, since its gap is 0;"
                " give the 'stiffness' of an elastic layer, a known 'pressure', or assume a 'closure'"
            )
            yield (), text
        if first == "forward" and self.pressure is not None and not self.is_paired:
            yield ("pressure",), "is valid only on a given deformed body; a forward solve finds the contact pressure"

    @property
    def files(self) -> tuple[str, ...]:
        return self.obstacle.files

    @property
    def holds(self) -> frozenset[str]:
        return frozenset() if self.pressure is not None and self.penalty is None else frozenset("xyz")

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        quantities = super().quantities()
        if self.penetration is None:
            quantities["penetration"] = LengthsOfBody(TOLERANCE), quantities["penetration"][1]
        return quantities | {f"obstacle_{name}": value for name, value in self.obstacle.quantities().items()}

    def functions(self, degree: int) -> Mapping[str, tuple[int, int]]:
        functions = {f"obstacle_{name}": value for name, value in self.obstacle.functions(degree).items()}
        if self.is_paired:
            return {}
        if not self.is_augmented:
            return functions
        return functions | {"multiplier": (1, 1)} | ({"penalty": (1, 1)} if self.penalty is None else {})

    def position(self, k: Kinematics, load: Any, par: Any) -> Any:
        """Return the current position relative to the obstacle where 'obstacle' places it."""
        return k.x if self.travel is None else k.x - k.load_factors(load)[1] * par.travel

    def gap(self, k: Kinematics, load: Any, par: Any) -> tuple[Any, Any]:
        """Return the gap and the direction away from the obstacle."""
        return self.obstacle.distance(self.position(k, load, par), SimpleNamespace(**self.obstacle_entries(par)))

    def obstacle_entries(self, par: Any) -> dict[str, Any]:
        """Return the quantities and functions of the obstacle by their names in it."""
        prefix = "obstacle_"
        return {name.removeprefix(prefix): value for name, value in vars(par).items() if name.startswith(prefix)}

    def contact_pressure(self, k: Kinematics, load: Any, par: Any) -> Any:
        """Return the pressure per current area."""
        share, pressing, slope = self._share(k, load, par), self._pressing(k, load, par), self._slope(par)
        if slope is None:
            return share * positive_part(pressing)
        return share * rounded_positive_part(pressing, slope * self.tolerance(par) / 4)

    def _share(self, k: Kinematics, load: Any, par: Any) -> Any:
        """Return the share of the pressure at full load that acts."""
        return k.load_factors(load, par.growing if self.presses_at_any_load else 0)[0]

    def _pressing(self, k: Kinematics, load: Any, par: Any) -> Any:
        """Return the scalar that is positive where there is contact: there it is the pressure at full load."""
        moved, slope, depth = k.load_factors(load)[1], self._slope(par), -self.gap(k, load, par)[0]
        if self.stand_off is not None:
            depth = depth + par.stand_off
        known = moved * par.pressure if self.pressure is not None else par.multiplier if self.is_augmented else 0
        return known if slope is None else known + slope * depth

    def mismatch(self, k: Kinematics, load: Any, par: Any) -> Any:
        """Return what the next update of the pressure would change, as a penetration over the tolerated one."""
        change = self.contact_pressure(k, load, par) - par.multiplier
        return change / (self._slope(par) * self.tolerance(par))

    def _slope(self, par: Any) -> Any | None:
        """Return the pressure per penetration, ``None`` if a given pressure does not depend on the position."""
        return getattr(par, "penalty" if self.stiffness is None else "stiffness", None)

    def tolerance(self, par: Any) -> Any:
        """Return the tolerated penetration in scaled lengths."""
        return par.penetration

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any | None:
        if self.is_paired:
            return None
        p, (_, m) = self.contact_pressure(k, load, par), self.gap(k, load, par)
        return k.da(p * sum(m[i] * v[i] for i in range(3)), self.region, QUADRATURE)
