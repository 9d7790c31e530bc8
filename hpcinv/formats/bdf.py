"""Bulk data of Nastran: properties and sets are regions."""

from pathlib import Path

from hpcinv.base.mesh_formats.mesh_format import MeshFormat
from hpcinv.formats.readers.followed_includes import included_files


class Bdf(MeshFormat):
    suffix = ".bdf"
    other_suffixes = (".nas", ".fem")
    action = "bdf"
    elements = "bulk data of Nastran"
    saver = "hpcinv.formats.writers.bdf:save_bdf"
    saves_27_nodes = "never"

    def data_files(self, path: Path, *, isolated: bool | None = None) -> list[str]:
        """Files that it includes."""
        return included_files("bdf-files", path, isolated=isolated)
