"""Bulk data of Nastran: properties and sets are regions."""

from hpcinv.formats.mesh_format import MeshFormat


class Bdf(MeshFormat):
    suffix = ".bdf"
    other_suffixes = (
        ".nas",
        ".fem",
    )
    reader = "hpcinv.mesh.io.bdf:read_bdf"
    saver = "hpcinv.mesh.io.bdf:save_bdf"
    saves_27_nodes = "never"
