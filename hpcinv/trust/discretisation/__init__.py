"""Discretisation error of a solution: finer problem, singular edges, and what a layer leaves."""
