"""Meshes that are spread over the ranks: partitions, rows of arrays, points and data."""
