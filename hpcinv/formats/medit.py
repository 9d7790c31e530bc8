"""Meshes of Medit, as text: references are regions."""

from hpcinv.formats.mesh_format import MeshFormat


class Medit(MeshFormat):
    suffix = ".mesh"
    action = "medit"
    elements = "a file of Medit"
    saver = "hpcinv.mesh.io.medit:save_medit"
