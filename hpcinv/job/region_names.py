"""Names of the regions of a mesh file, as far as they can be read without the mesh libraries.

``hpcinv validate`` uses them to report unknown regions of a job. It reports only what is certain: groups of generators
are unknown before these run.
"""

import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path

from hpcinv.base.mesh_formats import FORMATS
from hpcinv.base.quantity.schema import KeyPath
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.reading.mesh_format import Groups
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import MeshError
from hpcinv.job.body_kinds import SOLID, BodyKind

THIN = "has points or lines only, no whole facet"
THIN_REMEDY = "Hold the facets around it, or its vertices if the loads balance: regions: {a: {vertices: [[0, 0, 0]]}}"
"""what to do about a group of points or curves"""
_BOUNDARY = "boundary"


def unknown_regions(
    path: Path,
    defined: Iterable[str],
    named: Iterable[tuple[KeyPath, str]],
    *,
    kind: BodyKind = SOLID,
    groups: Groups | None = None,
) -> Iterator[tuple[KeyPath, str]]:
    """Places in a job with the name of an unknown region, and messages.

    Args:
        named: all references of the job to regions, with their places.
        kind: of the body.
        groups: of the mesh; by default by its header, as far as that has them.
    """
    groups = groups or _groups_in(path)
    if groups is None:
        return
    has_names = bool(groups.names or groups.patterns)
    groups = kind.groups(groups)
    known = {*defined, _BOUNDARY, *groups.names}
    advice = "" if has_names else _ways_to_name(groups)
    for where, name in named:
        if name in known or any(re.fullmatch(pattern, name) for pattern in groups.patterns):
            continue
        hint = did_you_mean(name, known)
        if advice:
            hint, advice = hint + advice.format(name=name), ""  # once
        if name in groups.thin:
            hint = f" It {THIN}. {THIN_REMEDY}"
        yield where, f"there is no region '{name}' in {path.name}, nor in 'regions'.{hint}"


def _groups_in(path: Path) -> Groups | None:
    try:
        state = path.stat()
        return _groups(path, state.st_mtime_ns, state.st_size)
    except (OSError, ValueError, MeshError):  # reported where the mesh is read
        return None


def _ways_to_name(groups: Groups) -> str:
    """Return what to do about a file without names of regions, with ``{name}`` for the name of one."""
    text = " The file names none itself: give a condition, such as 'regions: {{{name}: x < 1 mm}}'"
    if not groups.arrays:
        return f"{text}."
    array = groups.arrays[0].replace("{", "{{").replace("}", "}}")
    return (
        f"{text}, or numbers of an array in 'mesh': 'labels: {{{{array: \"{array}\", names: {{{{{{name}}: 1}}}}}}}}'."
    )


@lru_cache(maxsize=16)  # all cases of a sweep use one mesh
def _groups(path: Path, _changed: int, _size: int) -> Groups | None:
    """Groups of a mesh file, None if they cannot be known."""
    return FORMATS[suffix_of(path)].groups(path) if suffix_of(path) in FORMATS else None
