"""Partitioned meshes: a directory of ADIOS2; each rank reads a part of it."""

from pathlib import Path

from hpcinv.base.mesh_formats.partitioned_header import HEADER, SUFFIX, read_header
from hpcinv.base.reading.door import REFUSED
from hpcinv.base.reading.mesh_format import Groups, MeshFormat


class Partitioned(MeshFormat):
    suffix = SUFFIX
    reader = "hpcinv.mesh.distributed.partitioned:read_whole"
    is_partitioned = True
    head = HEADER

    def groups(self, path: Path) -> Groups:
        header = read_header(path)
        return Groups(frozenset(name for name, _, _ in header.groups), frozenset(header.thin_groups))

    def untrusted(self) -> str:
        return (
            f"can make ADIOS2 load libraries, and is {REFUSED}; ask for one file (.msh, .vtu),"
            " as 'hpcinv mesh gather' makes it"
        )
