"""Meshes of Medit, as text: references are regions."""

from hpcinv.base.mesh_formats.mesh_format import MeshFormat


class Medit(MeshFormat):
    suffix = ".mesh"
    action = "medit"
    elements = "a file of Medit"
    saver = "hpcinv.formats.writers.medit:save_medit"
