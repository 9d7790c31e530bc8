"""Intervals of what a given shape does not determine: results between all contact pressures that it admits."""
