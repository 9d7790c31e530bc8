"""Closures: one file each, registered by subclassing `Closure`."""

from collections.abc import Iterator, Sequence
from typing import Any, Literal

from hpcinv.base.quantity.schema import Faults, import_modules
from hpcinv.physics.closures.closure import Closure

import_modules(__name__, __path__)

CLOSURES: dict[str, type[Closure]] = {
    kind.name: kind for kind in sorted(Closure.__subclasses__(), key=lambda k: k.name)
}
"""by their names in a job"""
ClosureName = Literal[*CLOSURES]  # type: ignore[valid-type]

_MOST_FRICTION = 2.0
"""Largest coefficient of friction: dry rubber on rough ground. Raised, mistyped ones pass."""


def contradicting_closure(contact: Any, other_keys: Sequence[str] = ()) -> Faults:
    """Yield the faults of the keys that an interface and a contact with an obstacle have in common.

    Args:
        other_keys: keys that have another meaning without a closure.
    """
    if not 0 <= contact.friction <= _MOST_FRICTION:
        yield ("friction",), f"must be from 0 to {_MOST_FRICTION:g}"
    if contact.touches_within is not None and contact.closure is None:
        yield ("touches_within",), "is not valid without a 'closure'"
    if contact.touches_within is not None and contact.touches_within <= 0:
        yield ("touches_within",), "must be positive"
    if contact.closure is None and contact.known.model_fields_set:
        yield ("known",), "is not valid without a 'closure': it bounds what that assumes"
    yield from _faults_of_keys(contact, other_keys)
    if (closure := CLOSURES.get(contact.closure)) is not None:
        yield from closure.faults(contact)


def _faults_of_keys(contact: Any, other_keys: Sequence[str]) -> Faults:
    """Yield keys of closures that are missing, or that belong to another closure."""
    own = CLOSURES[contact.closure].keys if contact.closure in CLOSURES else ()
    for key in dict.fromkeys(key for kind in CLOSURES.values() for key in kind.keys):
        is_left = contact.closure is None and key in other_keys
        if (key in own) != (getattr(contact, key) is not None) and not is_left:
            names = [name for name, kind in CLOSURES.items() if key in kind.keys]
            yield (key,), f"must be given with 'closure: {' or '.join(names)}', and only then"


def fault_of_closure(contact: Any, directions: Sequence[str]) -> Iterator[str]:
    """Yield what is wrong with the closure of a contact in the solves of a job, in these directions."""
    if "inverse" not in directions:
        if contact.closure is not None:
            yield "is not valid in a forward analysis, which finds the pressure: leave it out"
        return
    follows_forward, friction = directions[0] == "forward", "with" if contact.friction else "without"
    fitting = [name for name, kind in CLOSURES.items() if kind.follows_forward == follows_forward]
    if contact.closure is None:
        yield (
            "is missing: a given deformed shape does not determine the pressure between its bodies, since their gap is"
            f" 0; assume {_either(name for name in fitting if CLOSURES[name].friction in ('both', friction))}"
        )
        return
    closure = CLOSURES[contact.closure]
    if closure.follows_forward != follows_forward:
        begins = "a round trip that begins with the forward solve"
        yield (
            f"must be {_either(fitting)} in {begins}" if follows_forward else f"is for {begins}: use {_either(fitting)}"
        )
    if closure.friction not in ("both", friction):
        others = _either(name for name in fitting if CLOSURES[name].friction in ("both", friction))
        if friction == "with":
            yield f"'{closure.name}' assumes nothing about friction: use {others}, or leave out 'friction'"
        else:
            yield f"'{closure.name}' needs 'friction', the coefficient that its tractions are compared with"


def _either(names: Any) -> str:
    *first, last = (f"'{name}'" for name in names)
    return " or ".join([", ".join(first), last] if first else [last])
