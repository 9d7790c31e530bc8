"""A deck in the layout of FreeCAD's writer for CalculiX: a block of six quadratic tetrahedra on a fixed face."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.body import read_source
from hpcinv.mesh.cells import vtk_order

MESHES = Path(__file__).parents[2] / "meshes"
LINE = "*" * 59
LOAD = "5.0000000000000E-04"  # at each of the nine nodes of the loaded face


def deck(length: float = 20.0, width: float = 10.0) -> str:
    """Return the deck, in mm and MPa: pressure on the top, weight, and forces along z at the far end."""
    box = {"lx": length, "ly": width, "lz": width, "nx": 1, "ny": 1, "nz": 1}
    given = {"file": "box.py", "parameters": box, "geometry_degree": 2}
    source = read_source(MeshSpec.model_validate(given, context={"directory": MESHES}), MESHES / "box.py")
    order = np.argsort(vtk_order("tetrahedron", 2))
    cells = source.node_tags[source.cells[:, order]]
    x, z = source.points[:, 0], source.points[:, 2]
    fixed, loaded = source.node_tags[x < 1e-9], source.node_tags[x > length - 1e-9]
    on_top = z[source.cells[:, :4]] > width - 1e-9
    faces: dict[tuple[int, ...], int] = {(0, 1, 2): 1, (0, 1, 3): 2, (1, 2, 3): 3, (0, 2, 3): 4}
    pressed = [
        (i, faces[corners])
        for i, row in enumerate(on_top, start=1)
        if len(corners := tuple(np.flatnonzero(row).tolist())) == 3
    ]
    lines = [
        "** written by FreeCAD inp file writer for CalculiX,Abaqus meshes",
        "** highest dimension mesh elements only.",
    ]
    lines += ["", "** Nodes", "*Node, NSET=Nall"]
    rows = zip(source.node_tags.tolist(), source.points.tolist(), strict=True)
    lines += [f"{tag}, {', '.join(f'{value:.13g}' for value in point)}" for tag, point in rows]
    lines += ["", "", "** Volume elements", "*Element, TYPE=C3D10, ELSET=Evolumes"]
    lines += [f"{i}, {', '.join(map(str, row))}" for i, row in enumerate(cells.tolist(), start=1)]
    lines += ["", "** Define element set Eall", "*ELSET, ELSET=Eall", "Evolumes", "", "", "", LINE]
    lines += ["** Element sets for materials and FEM element type (solid, shell, beam, fluid)"]
    lines += ["*ELSET,ELSET=RubberSolid", "Evolumes", "", LINE, "** constraints fixed node sets", "** Fixed"]
    lines += ["*NSET,NSET=Fixed", *(f"{tag}," for tag in fixed.tolist()), "", LINE, "** Materials"]
    lines += ["** FreeCAD material name: Rubber", "** Rubber", "*MATERIAL, NAME=Rubber", "*ELASTIC", "1,0.4"]
    lines += ["*DENSITY", "1E-09", "", LINE, "** Sections", "*SOLID SECTION, ELSET=RubberSolid, MATERIAL=Rubber", ""]
    lines += [LINE, "** At least one step is needed to run an CalculiX analysis of FreeCAD", "*STEP, NLGEOM", "*STATIC"]
    lines += ["", "", LINE, "** Fixed Constraints", "** Fixed", "*BOUNDARY", "Fixed,1", "Fixed,2", "Fixed,3", "", ""]
    lines += [LINE, "** Self weight Constraint", "** Weight", "*DLOAD", "Eall,GRAV,9806,0,0,-1", "", "", LINE]
    lines += ["** constraints force node loads", "*CLOAD", "** Force", "** node loads on shape: Block:Face2"]
    lines += [*(f"{tag},3,{LOAD}" for tag in loaded.tolist()), "", "", "", LINE]
    lines += ["** constraints pressure element face loads", "** Pressure", "*DLOAD", "** Pressure: face load"]
    lines += [*(f"{i},P{face},0.002" for i, face in pressed), "", "", LINE, "** Outputs --> frd file"]
    lines += ["*NODE FILE", "U", "*EL FILE", "S, E", "** outputs --> dat file"]
    lines += ["*NODE PRINT, NSET=Fixed, TOTALS=ONLY", "RF", "", "", LINE, "*END STEP ", "", LINE]
    lines += ["** CalculiX Input file", "**   written by    --> FreeCAD 0.20.2", "**"]
    return "\n".join(lines) + "\n"
