"""Finer meshes and geometries of higher degree of the same body."""
