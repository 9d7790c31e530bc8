"""Section of a job file with cavities: hollows of the body whose volume is a quantity."""

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, WithJsonSchema

from hpcinv.effects.pressure import Pressure
from hpcinv.job.sections import STRESS, QuantityOfInterest
from hpcinv.quantity.quantity import Length, Quantity
from hpcinv.quantity.schema import Faults, ListOf, Spec, Triple
from hpcinv.quantity.suggestions import did_you_mean


class Lid(Spec):
    """What closes the openings of a cavity instead of planes."""

    alternatives = ("region", "apex")

    region: str | None = None
    """region of the boundary that closes the cavity with its surface; openings that remain are closed by planes"""
    apex: Triple[Length] | None = None
    """fixed point to which straight lines close each opening: of half, quarter or eighth bodies a point on all planes
    of symmetry"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if (self.region is None) == (self.apex is None):
            yield (), "needs exactly one of 'region' and 'apex'"


class Gas(Spec):
    """A gas that fills a cavity: pressure times volume is in proportion to its amount times its temperature."""

    ambient: Annotated[float, Quantity("Pa", above=0.0)]
    """absolute pressure around the body, and in the cavity of the unloaded body, such as 1 atm"""
    amount: Annotated[float, Quantity("1", above=0.0)] = 1.0
    """amount times absolute temperature in the loaded body, relative to the unloaded one"""


class Cavity(Spec):
    """A hollow of the body: the space between a surface of the body and lids on its openings.

    With 'volume', 'unloaded_volume' or 'gas' the pressure in it is unknown, and acts on its surface.
    """

    surface: Annotated[
        ListOf[str],
        BeforeValidator(lambda v: [v] if isinstance(v, str) else v),
        WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}]}),
    ]
    """region of the boundary around the cavity; several regions, such as [left, right], of connected cavities: these
    have one pressure, and their volumes are added"""
    lid: Annotated[Literal["planar"] | Lid, Field(union_mode="left_to_right")] = "planar"
    """lids of all openings, which follow their rims: planar, {region: NAME} or {apex: [x, y, z]}. A planar lid joins
    the rim by straight lines to the mean of its vertices, and is flat where the rim is"""

    volume: Annotated[float, Quantity("m^3", above=0.0)] | None = None
    """given volume in the loaded body of a forward analysis, whose pressure is unknown"""
    unloaded_volume: Annotated[float, Quantity("m^3", above=0.0)] | None = None
    """given volume in the undeformed body of an inverse analysis or a round trip, whose pressure is unknown"""
    gas: Gas | None = None
    """gas that fills the cavity, whose pressure is unknown"""

    @property
    def is_controlled(self) -> bool:
        """True if the pressure is unknown."""
        return any(value is not None for value in (self.volume, self.unloaded_volume, self.gas))

    @property
    def lid_region(self) -> str | None:
        return None if self.lid == "planar" else self.lid.region

    @property
    def regions(self) -> tuple[str, ...]:
        """Regions of the boundary around the cavity."""
        return self.surface if self.lid_region is None else (*self.surface, self.lid_region)

    @property
    def apex(self) -> tuple[float, float, float] | None:
        """Fixed apex (m) of all lids."""
        return None if self.lid == "planar" else self.lid.apex

    @property
    def pressures(self) -> tuple[Pressure, ...]:
        """The effects of the unknown pressure, which begins with 0."""
        regions = self.regions if self.is_controlled else ()
        return tuple(Pressure(effect="pressure", region=region, pressure=0.0) for region in regions)

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if not self.surface:
            yield ("surface",), "has no region"
        keys = [key for key in ("volume", "unloaded_volume", "gas") if getattr(self, key) is not None]
        if len(keys) > 1:
            yield (keys[1],), f"is given in addition to '{keys[0]}': one of them determines the pressure"


def unsuited_controls(job: Any) -> Faults:
    """Faults of cavities of unknown pressure in a job, with their places in the job."""
    controlled = {name: cavity for name, cavity in job.cavities.items() if cavity.is_controlled}
    if not controlled:
        return
    is_inverse = job.analysis != "forward" and job.first != "forward"
    key, other = ("unloaded_volume", "volume") if is_inverse else ("volume", "unloaded_volume")
    regions = {region for cavity in controlled.values() for region in cavity.regions}
    for name, cavity in controlled.items():
        if getattr(cavity, other) is not None:
            known = "loaded" if is_inverse else "undeformed"
            yield ("cavities", name, other), f"is known: the mesh is the {known} body. Give '{key}'"
    for i, effect in enumerate(job.effects[: job.own_effect_count]):
        if isinstance(effect, Pressure) and effect.region in regions:
            text = f"'{effect.region}' belongs to a cavity of unknown pressure: remove the effect, or give no volume"
            yield ("effects", i, "region"), text
    name = next(iter(controlled))
    refused = {
        "states": bool(job.states),
        "load_cases": bool(job.load_cases),
        "method": job.method != "direct",
        "solver.strategy": job.solver.strategy != "adaptive",
        "solver.continuation": job.solver.continuation == "series",
        "solver.nested_iteration": job.solver.nested_iteration == "on",
        "sensitivities": bool(job.sensitivities),
        "identify": job.identify is not None,
        "accuracy": bool(job.accuracy),
        "mesh.surface_error": job.mesh.surface_error is not None,
    }
    for where, is_refused in refused.items():
        if is_refused:
            yield (
                tuple(where.split(".")),
                f"is not possible with the unknown pressure of cavity '{name}'; give a pressure",
            )
    if any(effect.functions(1) for effect in job.effects):
        yield (
            ("effects",),
            f"have a contact that is solved by iteration, beside the unknown pressure of cavity '{name}'",
        )


def unknown_cavities(quantities: Sequence[QuantityOfInterest], cavities: Mapping[str, Cavity]) -> Faults:
    """Faults of quantities of cavities that the job does not have."""
    names: Collection[str] = list(cavities)
    for i, quantity in enumerate(quantities):
        if quantity.cavity is not None and quantity.cavity not in names:
            hint = did_you_mean(quantity.cavity, names) if names else ""
            yield (i, "cavity"), f"there is no cavity '{quantity.cavity}'; define it in 'cavities'.{hint}".rstrip(".")
        elif (
            quantity.cavity is not None and quantity.dimension == STRESS and not cavities[quantity.cavity].is_controlled
        ):
            text = f"the pressure of cavity '{quantity.cavity}' is not unknown: give the cavity a volume or a gas"
            yield (i, "of"), f"{text}, or take the pressure from the effects"
