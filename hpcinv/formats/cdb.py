"""Archives of Ansys: components are regions."""

from hpcinv.formats.mesh_format import MeshFormat


class Cdb(MeshFormat):
    suffix = ".cdb"
    action = "cdb"
    elements = "an archive of Ansys"
    saver = "hpcinv.mesh.io.cdb:save_cdb"
    saves_27_nodes = "never"
