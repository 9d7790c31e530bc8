"""Universal files of I-deas: groups are regions."""

from hpcinv.base.mesh_formats.mesh_format import MeshFormat


class Unv(MeshFormat):
    suffix = ".unv"
    action = "unv"
    elements = "a universal file"
    saver = "hpcinv.formats.writers.unv:save_unv"
    saves_27_nodes = "never"
