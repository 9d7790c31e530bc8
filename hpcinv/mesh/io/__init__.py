"""Mesh files: readers, writers, and gmsh."""
