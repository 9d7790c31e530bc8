"""Section of a job file with cavities: hollows of the body whose volume is a quantity."""

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo

from hpcinv.job.sections import QuantityOfInterest
from hpcinv.quantity.quantity import Length
from hpcinv.quantity.schema import Faults, Spec, Triple
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


class Cavity(Spec):
    """A hollow of the body: the space between a surface of the body and lids on its openings."""

    surface: str
    """region of the boundary around the cavity"""
    lid: Annotated[Literal["planar"] | Lid, Field(union_mode="left_to_right")] = "planar"
    """lids of all openings, which follow their rims: planar, {region: NAME} or {apex: [x, y, z]}. A planar lid joins
    the rim by straight lines to the mean of its vertices, and is flat where the rim is"""

    @property
    def regions(self) -> dict[str, str]:
        """Regions of the boundary around the cavity, by dotted key."""
        lid = {} if self.lid == "planar" or self.lid.region is None else {"lid.region": self.lid.region}
        return {"surface": self.surface} | lid

    @property
    def apex(self) -> tuple[float, float, float] | None:
        """Fixed apex (m) of all lids."""
        return None if self.lid == "planar" else self.lid.apex


def unknown_cavities(quantities: Sequence[QuantityOfInterest], cavities: Mapping[str, Cavity]) -> Faults:
    """Faults of quantities of cavities that the job does not have."""
    names: Collection[str] = list(cavities)
    for i, quantity in enumerate(quantities):
        if quantity.cavity is not None and quantity.cavity not in names:
            hint = did_you_mean(quantity.cavity, names) if names else ""
            yield (i, "cavity"), f"there is no cavity '{quantity.cavity}'; define it in 'cavities'.{hint}".rstrip(".")
