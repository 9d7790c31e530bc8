"""Finite-strain kinematics, and functions for laws and effects."""
