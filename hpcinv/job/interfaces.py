"""Section of a job file with interfaces: two surfaces of one mesh that are tied, slide on each other, or touch."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo

from hpcinv.base.quantity import Length, StressField
from hpcinv.base.quantity.schema import Faults, KeyPath, Spec
from hpcinv.physics.closures import CLOSURES, ClosureName, contradicting_closure, fault_of_closure
from hpcinv.physics.closures.closure import Closure
from hpcinv.physics.closures.known import Known
from hpcinv.physics.effects import Effect
from hpcinv.physics.effects.contact import Contact

OBSTACLE = "obstacle"
"""what a rigid obstacle is called that takes the part of the second surface of an interface"""

type Kind = Literal["tied", "sliding", "contact"]


class Interface(Spec):
    """Two surfaces of one mesh that face each other: of two bodies, or of one body with itself."""

    between: Annotated[tuple[str, str], Field(strict=False)]
    """two regions of the boundary, or two labels (regions of cells) that share nodes, which are doubled there; of
    'contact', pressures are at the vertices of the first one, and a surface that touches itself is named twice"""
    kind: Kind
    """tied: the surfaces stick to each other for ever; sliding: they slide on each other without friction, and never
    part; contact: they press on each other where they touch, with 'friction' or without"""
    friction: float = 0.0
    """coefficient of Coulomb friction of 'contact': the tangential traction is at most this multiple of the pressure"""
    closure: ClosureName | None = None
    """assumption on the pressure of 'contact' on a given deformed shape, which does not determine it: one of the
    `closures`"""
    rest_gap: Length | None = None
    """gap of the unloaded bodies with 'closure: gap'"""
    pressure: StressField | None = None
    """pressure on the first surface of the given bodies with 'closure: pressure': a number, a formula of x, y and z, or
    an array at the nodes of the mesh"""
    touches_within: Length | None = None
    """gap of the given bodies up to which a 'closure' lets them press on each other; by default 1/256 of their length.
    Segmented surfaces need some; more widens the interval"""
    known: Known = Known()
    """bounds of what the given shape does not determine, for `uncertainty: contact` and `closure: least-energy`"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.between[0] == self.between[1] and self.kind != "contact":
            yield ("between",), "names one region twice: name the two surfaces that face each other"
        if self.friction and self.kind != "contact":
            yield ("friction",), f"is not valid with 'kind: {self.kind}': give it to 'kind: contact'"
        if self.closure is not None and self.kind != "contact":
            yield ("closure",), f"is not valid with 'kind: {self.kind}', whose pressure the shape determines"
        yield from contradicting_closure(self)

    @property
    def assumed(self) -> type[Closure] | None:
        """The closure, which determines the pressure on a given deformed shape."""
        return CLOSURES.get(self.closure or "")


def faults_of_interfaces(
    interfaces: Sequence[Interface], effects: Sequence[Effect], directions: Sequence[str], uncertainty: str | None
) -> Faults:
    """Yield the faults of interfaces, and of effects that take the part of one, with their places in a job.

    Args:
        directions, uncertainty: of the job.
    """
    for i, interface in enumerate(interfaces):
        if interface.between[0] == interface.between[1] and "inverse" in directions:
            yield (
                ("interfaces", i, "between"),
                "names one region twice, which only a forward analysis can have: name the two surfaces that touch",
            )
    places: list[tuple[KeyPath, Interface]] = [(("interfaces", i), interface) for i, interface in enumerate(interfaces)]
    places += [
        (("effects", i), interface_of(effect))
        for i, effect in enumerate(effects)
        if isinstance(effect, Contact) and effect.is_paired
    ]
    for place, interface in places:
        yield from _faults_of_one(place, interface, directions, uncertainty)
    if uncertainty and not any(interface.closure for _, interface in places):
        yield ("uncertainty",), "needs an interface of 'kind: contact' with a 'closure'; leave it out"


def _faults_of_one(place: KeyPath, interface: Interface, directions: Sequence[str], uncertainty: str | None) -> Faults:
    if interface.kind == "contact":
        yield from (((*place, "closure"), text) for text in fault_of_closure(interface, directions))
    is_searched = interface.assumed is not None and bool(interface.assumed.searched_from)
    if interface.known.model_fields_set and not uncertainty and not is_searched:
        text = "bounds an interval or a search: add 'uncertainty: contact' or 'closure: least-energy', or leave it out"
        yield (*place, "known"), text
    if interface.friction and uncertainty and place[0] == "effects":
        yield (*place, "friction"), "is not possible with 'uncertainty: contact': it varies friction between bodies"


def interface_of(contact: Contact) -> Interface:
    """Return the interface whose second surface is the rigid obstacle of a contact with friction or a closure."""
    common = Interface.model_fields.keys() & Contact.model_fields.keys()
    numbers: dict[str, Any] = {name: getattr(contact, name) for name in common}
    return Interface.model_construct(between=(contact.region, OBSTACLE), kind="contact", **numbers)
