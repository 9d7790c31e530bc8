"""Exodus II: blocks, side sets and node sets are regions."""

from hpcinv.base.mesh_formats.mesh_format import MeshFormat


class Exodus(MeshFormat):
    suffix = ".e"
    other_suffixes = (".exo", ".ex2", ".g")
    action = "exodus"
    elements = "Exodus II"
    saver = "hpcinv.formats.writers.exodus:save_exodus"
    saves_27_nodes = "if read"
