"""MED files of Salome and code_aster: groups are regions."""

from hpcinv.base.mesh_formats.mesh_format import MeshFormat


class Med(MeshFormat):
    suffix = ".med"
    action = "med"
    elements = "MED"
    saver = "hpcinv.formats.writers.med:save_med"
    saves_27_nodes = "never"
