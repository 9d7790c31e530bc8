"""Archives of Ansys: components are regions."""

from hpcinv.base.mesh_formats.mesh_format import MeshFormat


class Cdb(MeshFormat):
    suffix = ".cdb"
    action = "cdb"
    elements = "an archive of Ansys"
    saver = "hpcinv.formats.writers.cdb:save_cdb"
    saves_27_nodes = "never"
