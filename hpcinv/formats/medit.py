"""Meshes of Medit, as text: references are regions."""

from hpcinv.formats.mesh_format import MeshFormat


class Medit(MeshFormat):
    suffix = ".mesh"
    action = "medit"
    reader = "hpcinv.mesh.io.medit:read_medit"
    saver = "hpcinv.mesh.io.medit:save_medit"
