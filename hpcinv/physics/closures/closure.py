"""Base class of closures: assumptions that determine the contact pressure on a given deformed shape."""

from abc import ABC
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from hpcinv.base.quantity.schema import Faults

type Bound = Literal["coulomb", "rough", "unbounded"]


class Closure(ABC):
    """An assumption; a subclass with a ``name`` is registered under it.

    Attributes:
        name: in a job.
        assumes: the pressure is the one for which this holds; a sentence without its full stop.
        keys: keys of the contact that must be given with it, and only then.
        finds_pressure: whether the gap of the unloaded bodies is assumed, and the solve finds the pressure; else the
            pressure is given, and the gap follows.
        follows_forward: whether it needs the forward solve of a round trip that begins with one; else it needs that
            there is none.
        leaves_open: why it cannot hold a part that nothing else holds; empty if it can.
        friction: whether it is for contact without friction, with it, or for both.
        bound: of tangential tractions that the solve finds: ``coulomb`` friction times pressure, ``rough`` none where
            bodies press; ``unbounded`` for given ones.
        searched_from: closures without and with friction whose solution begins a search for the pressure; empty if
            there is none.
    """

    name: ClassVar[str]
    assumes: ClassVar[str]
    keys: ClassVar[tuple[str, ...]] = ()
    finds_pressure: ClassVar[bool] = False
    follows_forward: ClassVar[bool] = False
    leaves_open: ClassVar[str] = ""
    friction: ClassVar[Literal["without", "with", "both"]] = "both"
    bound: ClassVar[Bound] = "unbounded"
    searched_from: ClassVar[Mapping[Literal["without", "with"], str]] = {}

    @classmethod
    def faults(cls, contact: Any) -> Faults:
        """Yield faults of the keys of a contact with this closure."""
        yield from ()
