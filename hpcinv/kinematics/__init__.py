"""Finite-strain kinematics, and the functions of strains that laws and effects are written with."""
