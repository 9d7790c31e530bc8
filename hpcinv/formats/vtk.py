"""VTK's legacy files of unstructured grids: cell arrays ``region:NAME`` are regions, as in VTU files."""

from hpcinv.base.mesh_formats.mesh_format import MeshFormat


class Vtk(MeshFormat):
    suffix = ".vtk"
    action = "vtk"
    reader = "hpcinv.formats.writers.vtk:read_vtk"
    saver = "hpcinv.formats.writers.vtk:save_vtk"
