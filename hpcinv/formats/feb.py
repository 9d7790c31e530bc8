"""Model files of FEBio: parts, node sets, element sets and surfaces are regions."""

import re
from html import unescape
from pathlib import Path

from hpcinv.base.mesh_formats.mesh_format import OF_NODES, Groups, MeshFormat
from hpcinv.base.reading.door import admitted

_NAMED = re.compile(r"<(?:Nodes|Elements|NodeSet|ElementSet|Surface)\b[^<>]*?\bname\s*=\s*\"([^\"]*)\"")
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
        if path.stat().st_size > _LARGEST:
            return None
        text = admitted(path).read_text(encoding="utf-8", errors="replace")
        return Groups(frozenset(map(unescape, _NAMED.findall(text))), patterns=(_UNNAMED, f".+{OF_NODES}"))
