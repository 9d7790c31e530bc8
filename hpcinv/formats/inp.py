"""Input files of Abaqus and CalculiX: node sets, element sets and surfaces are regions."""

from pathlib import Path

from hpcinv.base.mesh_formats.mesh_format import Groups, MeshFormat
from hpcinv.base.reading.fault import Fault
from hpcinv.formats.readers.followed_includes import followed, included_files

_CONDITIONS = (
    r".+-(P[1-6]|EDNOR[1-4]|nodes|surface)",
    r"held-[rxyz]+(=.+)?",
    r"(loaded|turned|pressed|edge-loaded)(-\d+)?",
)
"""faces of the elements of a set, by a line of ``*DLOAD``, and what lines on single nodes and elements hold or load"""


class Inp(MeshFormat):
    suffix = ".inp"
    action = "inp"
    elements = "an input file"
    saver = "hpcinv.formats.writers.inp:save_inp"
    saves_27_nodes = "if read"

    def groups(self, path: Path) -> Groups | None:
        """Groups by the names of sets and surfaces; unknown in an assembly, whose sets belong to instances."""
        try:
            names = followed("inp-names", path)["names"]
        except Fault:  # reported by the reader
            return None
        return None if names is None else Groups(frozenset(names), patterns=_CONDITIONS)

    def data_files(self, path: Path, *, isolated: bool | None = None) -> list[str]:
        """Files that it includes."""
        return included_files("inp-files", path, isolated=isolated)
