"""CAD files, which gmsh's OpenCASCADE reads in the process that needs them, if it survives them here."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault, shown

_GIVEN_BY_LIBRARY = ("Open CASCADE", "COMPOUND", "SOLID", "SHELL")


def given_name(gmsh: Any, dim: int, tag: int) -> str:
    """Return the last part of the name of an entity in the file; empty for names that the exporting library gave."""
    name = str(gmsh.model.getEntityName(dim, tag)).rpartition("/")[2].strip()
    return "" if name.startswith(_GIVEN_BY_LIBRARY) else name


def solid_names(gmsh: Any) -> list[str]:
    """Return the distinct names of the solids, ``solid-1`` and so on where the file has none."""
    names = [given_name(gmsh, 3, tag) or f"solid-{i}" for i, (_, tag) in enumerate(gmsh.model.getEntities(3), 1)]
    return distinct(names)


def distinct(names: Sequence[str]) -> list[str]:
    """Return names with numbers where they are repeated."""
    counts, numbers = Counter(names), Counter[str]()
    different = []
    for name in names:
        numbers[name] += 1
        different.append(name if counts[name] == 1 else f"{name}-{numbers[name]}")
    return different


def read_cad(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Import a file and check its topology; return names of its solids, and names, centres and areas of its faces.

    Faces belong to one solid: gluing makes others where several touch.
    """
    import gmsh

    gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("rehearsal")
        gmsh.model.occ.importShapes(str(admitted(path)))
        gmsh.model.occ.synchronize()
        gmsh.model.getBoundary(gmsh.model.getEntities(3))
        occ, solids = gmsh.model.occ, solid_names(gmsh)
        faces = [
            (given_name(gmsh, 2, tag) or f"face-{i}", occ.getCenterOfMass(2, tag), occ.getMass(2, tag))
            for i, (_, tag) in enumerate(gmsh.model.getEntities(2), 1)
        ]
    except Exception as error:  # gmsh raises nothing narrower
        raise Fault(f"gmsh cannot read it: {shown(str(error))}", "Is the file complete? Export it again.") from None
    finally:
        gmsh.finalize()
    return {"solids": solids, "faces": faces if len(solids) == 1 else []}, {}
