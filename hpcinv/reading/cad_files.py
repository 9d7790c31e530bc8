"""CAD files, which gmsh's OpenCASCADE reads in the process that needs them, if it survives them here."""

from pathlib import Path
from typing import Any

from hpcinv.reading.fault import Fault, shown


def read_cad(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Import a file and check its topology."""
    import gmsh

    gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("rehearsal")
        gmsh.model.occ.importShapes(str(path))
        gmsh.model.occ.synchronize()
        gmsh.model.getBoundary(gmsh.model.getEntities(3))
    except Exception as error:  # gmsh raises nothing narrower
        raise Fault(f"gmsh cannot read it: {shown(str(error))}", "Is the file complete? Export it again.") from None
    finally:
        gmsh.finalize()
    return {}, {}
