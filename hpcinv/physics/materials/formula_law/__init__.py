"""Arithmetic for energy formulas that keeps digits at small strain."""
