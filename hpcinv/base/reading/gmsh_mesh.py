"""MSH files, which gmsh reads in the process that needs them, if it survives them here."""

import contextlib
from pathlib import Path
from typing import Any

from hpcinv.base.reading.door import admitted


def read_msh(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read the file with gmsh, and all data that the package asks for; errors are reported where it is read again."""
    import gmsh

    gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    with contextlib.suppress(Exception):  # gmsh raises nothing narrower
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.model.add("rehearsal")
        gmsh.merge(str(admitted(path)))
        if gmsh.model.getNumberOfPartitions():
            gmsh.model.mesh.unpartition()
        gmsh.model.mesh.getNodes()
        for dim, tag in gmsh.model.getEntities():
            gmsh.model.mesh.getElements(dim, tag)
        for dim, tag in gmsh.model.getPhysicalGroups():
            gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
        for view in gmsh.view.getTags():
            last = int(gmsh.view.option.getNumber(view, "NbTimeStep")) - 1
            gmsh.view.getHomogeneousModelData(view, last)
    gmsh.finalize()
    return {}, {}
