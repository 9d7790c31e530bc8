"""Universal files of I-deas: groups are regions."""

from hpcinv.formats.mesh_format import MeshFormat


class Unv(MeshFormat):
    suffix = ".unv"
    action = "unv"
    elements = "a universal file"
    saver = "hpcinv.mesh.io.unv:save_unv"
    saves_27_nodes = "never"
