"""Meshes of segmented images and closed surfaces: labels of voxels become regions of tetrahedra.

Voxels are resampled to a working grid, whose cells are divided into tetrahedra (`lattice`); nodes between two labels
move to where both are equally likely (`boundary`); MMG improves and coarsens the cells. Unlike surfaces that are
extracted first, tetrahedra that are moved cannot cut each other, however thin the wall between two labels is.
"""
