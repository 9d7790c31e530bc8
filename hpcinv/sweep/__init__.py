"""Batch sweeps: many cases of one job, in one allocation or many, with nothing computed twice."""
