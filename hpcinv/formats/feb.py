"""Model files of FEBio: parts, node sets, element sets and surfaces are regions."""

from pathlib import Path

from hpcinv.base.mesh_formats.mesh_format import OF_NODES, Groups, MeshFormat
from hpcinv.base.reading.fault import Fault

_UNNAMED = r"part-\d+"
_LARGEST = 200 * 2**20
"""bytes of a file that is searched for names; raised, ``validate`` may take seconds"""


class Feb(MeshFormat):
    suffix = ".feb"
    action = "feb"
    elements = "a model of FEBio"
    saver = "hpcinv.formats.writers.feb:save_feb"
    saves_27_nodes = "never"

    def groups(self, path: Path) -> Groups | None:
        """Groups by the names of parts, sets and surfaces; parts without a name are called such as ``part-2``."""
        from hpcinv.base.reading.feb_model import names_in  # loads a parser of XML

        if path.stat().st_size > _LARGEST:
            return None
        try:
            return Groups(frozenset(names_in(path)), patterns=(_UNNAMED, f".+{OF_NODES}"))
        except Fault:  # reported by the reader
            return None
