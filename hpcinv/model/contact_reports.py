"""Results of contacts, and of their friction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from dolfinx import fem


@dataclass(frozen=True)
class SlipHistory:
    """What the slip of one contact goes on from: the end of the last load step below the full load.

    Attributes:
        displacement: of the body at that end, in m.
        slips: components of the slip that its tractions need, in m.
        force: pressure times area of each node, in N.
        numbers: load factor ``load``; ``energy_lost`` up to there, in J; ``shift`` of a rigid obstacle, in m; and
            present penalties, the pressure's by its first one (``share``) and friction's by the pressure's
            (``softness``).
    """

    displacement: fem.Function
    slips: tuple[fem.Function, ...]
    force: fem.Function
    numbers: Mapping[str, Any]

    @property
    def functions(self) -> dict[str, fem.Function]:
        """All functions by their names."""
        slips = {f"slip-{axis}": slip for axis, slip in zip("xyz", self.slips, strict=True)}
        return {"displacement": self.displacement, "force": self.force} | slips

    def with_numbers(self, numbers: Mapping[str, Any]) -> Self:
        """Return the same functions with other numbers."""
        return replace(self, numbers=numbers)


@dataclass(frozen=True)
class FrictionReport:
    """Friction of one interface.

    Attributes:
        coefficient: as given.
        sliding_area: area that carries pressure and slides in the last load step, in m².
        energy_lost: by sliding in all load steps, in J.
        place: node of the given mesh (m) where the traction exceeds friction most, or is nearest to it; largest,
            allowed: its traction, and what friction allows there, in Pa.
        tractions: components of the tangential traction on the first surface, in Pa.
        slips: components of the slip of the second surface on the first in the last load step, in m.
        state: 0 open, 1 sticks, 2 slides.
        history: of the slip before the last load step; ``None`` if that began with the unloaded body.
    """

    coefficient: float
    sliding_area: float
    energy_lost: float
    place: tuple[float, float, float]
    largest: float
    allowed: float
    tractions: tuple[fem.Function, ...]
    slips: tuple[fem.Function, ...]
    state: fem.Function
    history: SlipHistory | None = None

    def as_data(self) -> dict[str, Any]:
        """The report as JSON data."""
        return {name: getattr(self, name) for name in ("coefficient", "sliding_area", "energy_lost")}


@dataclass(frozen=True)
class ContactReport:
    """Result of one contact.

    Attributes:
        where: its place in the job.
        force: resultant on the body, in N.
        area: current area in contact, in m².
        penetration: largest penetration at a node of the displacement, in m.
        distance: largest distance from the obstacle (m) of nodes with more than 1 % of the largest pressure.
        largest_pressure: mean around a vertex, in Pa.
        tolerance: tolerated penetration, in m; ``None`` if the obstacle is not rigid.
        is_given: whether the job gives the pressure.
        penalty: penalty in the last solve, in Pa/m; ``None`` without one, or if it varies.
        fields: contact pressure and, of a rigid obstacle, its multiplier ``q`` (both in Pa, linear between the
            vertices, 0 outside of the region).
        friction: of an interface; ``None`` without it.
    """

    where: str
    region: str
    assumption: str
    force: tuple[float, float, float]
    area: float
    penetration: float
    distance: float
    largest_pressure: float
    tolerance: float | None
    is_given: bool
    penalty: float | None
    fields: tuple[fem.Function, ...]
    friction: FrictionReport | None = None

    @property
    def fields_with_units(self) -> list[tuple[fem.Function, str]]:
        """All fields, also of friction, with their units."""
        found = [(field, "Pa") for field in self.fields]
        if (friction := self.friction) is not None:
            found += [(field, "Pa") for field in friction.tractions]
            found += [*((field, "m") for field in friction.slips), (friction.state, "1")]
        return found

    def as_data(self) -> dict[str, Any]:
        """The report as JSON data."""
        rough = {} if self.friction is None else {"friction": self.friction.as_data()}
        names = ("region", "assumption", "area", "penetration", "distance", "largest_pressure", "tolerance", "penalty")
        return {"effect": self.where, "force": list(self.force)} | {name: getattr(self, name) for name in names} | rough


def histories_of(reports: Sequence[ContactReport]) -> tuple[SlipHistory | None, ...]:
    """Return the histories of slip of all contacts of a solution; empty if none of them has one."""
    found = tuple(None if report.friction is None else report.friction.history for report in reports)
    return found if any(history is not None for history in found) else ()
