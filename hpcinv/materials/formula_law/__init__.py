"""Arithmetic in which formulas of strains keep their digits at small strain, for laws that are given by a formula."""
