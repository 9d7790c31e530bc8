"""Meshes and surfaces of shells from what the files of other programs contain."""
