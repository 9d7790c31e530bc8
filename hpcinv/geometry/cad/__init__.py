"""Meshes of CAD files."""
