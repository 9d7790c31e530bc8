"""Bulk data of Nastran: properties and sets are regions."""

from pathlib import Path

from hpcinv.formats.mesh_format import MeshFormat
from hpcinv.reading.included_files import included_by


class Bdf(MeshFormat):
    suffix = ".bdf"
    other_suffixes = (
        ".nas",
        ".fem",
    )
    action = "bdf"
    reader = "hpcinv.mesh.io.bdf:read_bdf"
    saver = "hpcinv.mesh.io.bdf:save_bdf"
    saves_27_nodes = "never"

    def data_files(self, path: Path) -> list[str]:
        """Files that it includes."""
        from hpcinv.reading.bdf_files import lines_of

        return included_by(path, lines_of)
