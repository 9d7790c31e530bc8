"""Walls of vessels around their lumen, which an image, a surface or a table of centrelines gives."""
