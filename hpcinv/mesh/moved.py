"""A mesh put at other coordinates for as long as something needs it there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hpcinv.mesh.regions import Mesh
    from hpcinv.mesh.source import Floats


@contextmanager
def placed(mesh: Mesh, nodes: Floats) -> Iterator[None]:
    """Put the local geometry nodes of ``mesh`` at ``nodes`` (n, 3), and exactly back at the end, come what may."""
    x = mesh.geometry.x
    before = x.copy()
    x[:] = nodes
    try:
        yield
    finally:
        x[:] = before
