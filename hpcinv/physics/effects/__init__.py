"""Effects: one file each, registered by subclassing `Effect`."""

from typing import Annotated

from hpcinv.base.quantity.plugins import load_installed
from hpcinv.base.quantity.schema import OneOf, define_in, members_of
from hpcinv.physics.effects.effect import Direction, Effect

define_in(__name__, Effect)

AnyEffect = Annotated[Effect, OneOf("effect")]


def effects() -> dict[str, type[Effect]]:
    """Return every known effect by name."""
    load_installed()
    return members_of(Effect, "effect")


__all__ = ["AnyEffect", "Direction", "Effect", "effects"]
