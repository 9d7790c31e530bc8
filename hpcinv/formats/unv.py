"""Universal files of I-deas: groups are regions."""

from hpcinv.formats.mesh_format import MeshFormat


class Unv(MeshFormat):
    suffix = ".unv"
    action = "unv"
    reader = "hpcinv.mesh.io.unv:read_unv"
    saver = "hpcinv.mesh.io.unv:save_unv"
    saves_27_nodes = "never"
