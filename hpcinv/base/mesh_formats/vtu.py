"""VTK's unstructured grids: cell arrays ``region:NAME`` have the tag of a region on its cells, and 0 elsewhere."""

from pathlib import Path

from hpcinv.base.reading.mesh_format import Groups, MeshFormat
from hpcinv.base.reading.vtk_headers import END, elements_of

REGION = "region:"
_OF_GRID = ("connectivity", "offsets", "types", "faces", "faceoffsets", "node_tag", "cell_tag", "vtkGhostType")
"""arrays of integers that do not mark parts of a body"""
_LARGEST = 800 * 2**20
"""bytes of a file that is searched for names; raised, ``validate`` may take seconds"""


class Vtu(MeshFormat):
    suffix = ".vtu"
    action = "vtu"
    reader = "hpcinv.mesh.io.vtu:read_vtu"
    saver = "hpcinv.mesh.io.vtu:save_vtu"

    def groups(self, path: Path) -> Groups | None:
        """Groups by the names of cell arrays, which are declared before any appended data."""
        if path.stat().st_size > _LARGEST:
            return None
        elements = list(elements_of(path))
        arrays = {a.get("Name", ""): a.get("type", "") for tag, a in elements if tag == "DataArray"}
        names = frozenset(name.removeprefix(REGION) for name in arrays if name.startswith(REGION))
        whole = [name for name, kind in arrays.items() if kind.startswith(("Int", "UInt"))]
        if not elements or elements[-1][0] != END:
            return None
        return Groups(
            names, arrays=tuple(name for name in whole if not name.startswith(REGION) and name not in _OF_GRID)
        )
