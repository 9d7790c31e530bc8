"""Directions of fibres in Abaqus: ``*ORIENTATION`` with local directions. CalculiX 2.20 has no law with fibres.

Source: *Abaqus Keywords Guide*, ``*ORIENTATION``.
"""

from __future__ import annotations

from collections.abc import Iterator

from hpcinv.errors import OutputError
from hpcinv.formats.inp import number
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.second_opinion.loaded_body import LoadedBody


def orientation_of(law: MaterialLaw, material: str) -> str:
    """Return the name of the axes of a material; empty if its law has no fibres."""
    return f"HPCINV_FIBRES_{material}" if law.families else ""


def orientation_lines(body: LoadedBody, law: MaterialLaw, material: str) -> Iterator[str]:
    """Yield the axes x, y, z of a material, and the directions of its fibres.

    Raises:
        OutputError: a direction varies over the rest body.
    """
    if not law.families:
        return
    if varying := [name for name in law.families if name not in body.fibres]:
        text = f"fibres.{varying[0]}: its direction varies over the rest body, or is given on the deformed one"
        raise OutputError(text, "Decks have constant directions with 'given_on: reference' only.")
    yield f"*ORIENTATION, NAME={orientation_of(law, material)}, LOCAL DIRECTIONS={len(law.families)}\n"
    yield "1., 0., 0., 0., 1., 0.\n3, 0.\n"
    for name in law.families:
        yield f"{', '.join(map(number, body.fibres[name].tolist()))}\n"
