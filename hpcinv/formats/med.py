"""MED files of Salome and code_aster: groups are regions."""

from hpcinv.formats.mesh_format import MeshFormat


class Med(MeshFormat):
    suffix = ".med"
    action = "med"
    reader = "hpcinv.mesh.io.med:read_med"
    saver = "hpcinv.mesh.io.med:save_med"
    saves_27_nodes = "never"
