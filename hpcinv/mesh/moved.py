"""Temporary coordinates of a mesh."""

from collections.abc import Iterator
from contextlib import contextmanager

from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats


@contextmanager
def placed(mesh: Mesh, nodes: Floats) -> Iterator[None]:
    """Context in which the local geometry nodes of ``mesh`` are at ``nodes`` (n, 3); restored exactly at its end."""
    x = mesh.geometry.x
    before = x.copy()
    x[:] = nodes
    try:
        yield
    finally:
        x[:] = before
