"""Cubic B-spline curves, surfaces and solids through points, by least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.sparse.linalg import splu

from hpcinv.base.quantity.arrays import Floats

DEGREE = 3
_SMOOTH = 1e-8
"""Weight of second differences of control points, relative to the points': it determines those that no point is near.
Raised, curves are flattened."""


@dataclass(frozen=True)
class Spline:
    """A curve, surface or solid: knots without repetition of each parameter, and control points (…, components)."""

    knots: tuple[Floats, ...]
    controls: Floats


def even_knots(low: float, high: float, spans: int) -> Floats:
    """Return the knots of a B-spline with equal spans."""
    return np.linspace(low, high, spans + 1)


def fitted(
    knots: Sequence[Floats],
    parameters: Floats,
    points: Floats,
    weights: Floats,
    closed: Sequence[bool],
    poles: Sequence[tuple[int, int]] = (),
) -> tuple[Spline, Floats]:
    """Return the spline nearest to points (n, components), and its values (n, components) there.

    Args:
        knots: of each parameter.
        parameters: of the points, (n, len(knots)).
        closed: parameters at whose ends the control points are the same.
        poles: ends (axis, 0 or -1) of parameters at which all control points are one.
    """
    matrix = _basis(knots[0], parameters[:, 0])
    sizes = [matrix.shape[1]]
    for more, column in zip(knots[1:], parameters.T[1:], strict=True):
        basis = _basis(more, column)
        sizes.append(basis.shape[1])
        matrix = _row_products(matrix, basis)
    count = int(np.prod(sizes))
    roughness = sparse.csr_array((count, count))
    for axis, size in enumerate(sizes):
        second = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(size - 2, size))
        parts = [sparse.eye_array(other) for other in sizes]
        parts[axis] = second.T @ second
        whole = parts[0]
        for part in parts[1:]:
            whole = sparse.kron(whole, part)
        roughness = roughness + whole
    tie = _ties(sizes, closed, poles)
    weighted = matrix.T.multiply(weights).tocsr()
    normal = weighted @ matrix + (_SMOOTH * weights.sum() / count) * roughness
    factors = splu((tie.T @ normal @ tie).tocsc())
    controls = tie @ factors.solve(np.asarray(tie.T @ (weighted @ points)))
    return Spline(tuple(knots), controls.reshape(*sizes, -1)), np.asarray(matrix @ controls)


def values_of(spline: Spline, parameters: Floats) -> Floats:
    """Return points (n, components) at parameters (n, number of parameters)."""
    matrix = _basis(spline.knots[0], parameters[:, 0])
    for knots, column in zip(spline.knots[1:], parameters.T[1:], strict=True):
        matrix = _row_products(matrix, _basis(knots, column))
    return np.asarray(matrix @ spline.controls.reshape(matrix.shape[1], -1))


def _basis(knots: Floats, parameters: Floats) -> sparse.csr_array:
    whole = np.concatenate([[knots[0]] * DEGREE, knots, [knots[-1]] * DEGREE])
    inside = np.clip(parameters, knots[0], knots[-1])
    return sparse.csr_array(BSpline.design_matrix(inside, whole, DEGREE))


def _row_products(a: sparse.csr_array, b: sparse.csr_array) -> sparse.csr_array:
    """Return the products of all entries of ``a`` and ``b`` in the same row."""
    rows = a.shape[0]
    columns = a.indices.reshape(rows, -1, 1) * b.shape[1] + b.indices.reshape(rows, 1, -1)
    values = a.data.reshape(rows, -1, 1) * b.data.reshape(rows, 1, -1)
    starts = columns[0].size * np.arange(rows + 1)
    return sparse.csr_array((values.ravel(), columns.ravel(), starts), shape=(rows, a.shape[1] * b.shape[1]))


def _ties(sizes: Sequence[int], closed: Sequence[bool], poles: Sequence[tuple[int, int]]) -> sparse.csr_array:
    """Return the matrix from independent control points to all."""
    numbers = np.arange(int(np.prod(sizes))).reshape(*sizes)
    for axis, is_closed in enumerate(closed):
        if is_closed:
            ends = np.moveaxis(numbers, axis, 0)
            ends[-1] = ends[0]
    for axis, end in poles:
        pole = np.moveaxis(numbers, axis, 0)[end]
        pole[...] = pole.flat[0]
    kept, place = np.unique(numbers, return_inverse=True)
    rows = np.arange(numbers.size)
    return sparse.csr_array((np.ones(numbers.size), (rows, place.ravel())), shape=(numbers.size, len(kept)))
