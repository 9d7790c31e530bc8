"""MED files of Salome and code_aster: groups are regions."""

from hpcinv.formats.mesh_format import MeshFormat


class Med(MeshFormat):
    suffix = ".med"
    action = "med"
    elements = "MED"
    saver = "hpcinv.mesh.io.med:save_med"
    saves_27_nodes = "never"
