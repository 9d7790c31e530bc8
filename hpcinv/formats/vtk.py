"""VTK's legacy files of unstructured grids: cell arrays ``region:NAME`` are regions, as in VTU files."""

from hpcinv.formats.mesh_format import MeshFormat


class Vtk(MeshFormat):
    suffix = ".vtk"
    action = "vtk"
    reader = "hpcinv.mesh.io.vtk:read_vtk"
    saver = "hpcinv.mesh.io.vtk:save_vtk"
