"""Mould of a solid: a block without it, whole or split in two by a plane, and cores of closed chambers."""

from dataclasses import dataclass

import manifold3d
import numpy as np

from hpcinv.errors import MeshError, OutputError
from hpcinv.geometry.workshop.solid import Solid
from hpcinv.mesh.source import Floats

UNDERCUT = 1e-3
"""share of the part's surface above which undercuts are more than rounding of the surface"""
_STEEP = 1e-3  # sine of the angle within which a wall counts as parallel to the pull


@dataclass(frozen=True)
class Split:
    """Plane that splits a mould, and the direction in which its halves are pulled off.

    Attributes:
        axis: 0, 1 or 2, the direction of the plane's normal.
        position: of the plane along the axis; ``None`` is the middle of the part.
    """

    axis: int
    position: float | None = None

    def position_in(self, part: Solid) -> float:
        """Return the position of the plane; ``OutputError`` if it misses the part."""
        low, high = (float(f(part.points[:, self.axis])) for f in (np.min, np.max))
        position = (low + high) / 2 if self.position is None else self.position
        if not low < position < high:
            name = "xyz"[self.axis]
            raise OutputError(f"--split {name}={position:g}: misses the part, from {name} = {low:g} to {high:g}")
        return position


@dataclass(frozen=True)
class Mould:
    """A mould.

    Attributes:
        blocks: the block around the part; with a split its halves, the lower one along the axis first.
        cores: what fills the closed chambers of the part; no half of the mould holds it.
    """

    blocks: list[Solid]
    cores: list[Solid]


def chambers(part: Solid) -> list[Solid]:
    """Return the solids that fill closed chambers of a part."""
    return [shell.reversed() for shell in part.shells() if shell.volume < 0]


def without_chambers(part: Solid) -> Solid:
    """Return the outer surfaces of a part."""
    outer = [shell for shell in part.shells() if shell.volume > 0]
    starts = np.cumsum([0, *(len(shell.points) for shell in outer[:-1])])
    triangles = [shell.triangles + start for shell, start in zip(outer, starts, strict=True)]
    return Solid(np.concatenate([shell.points for shell in outer]), np.concatenate(triangles))


def loose_pieces(block: Solid) -> int:
    """Return the number of pieces of a block or half that are apart from the largest."""
    return sum(shell.volume > 0 for shell in block.shells()) - 1


def mould(part: Solid, wall: float, split: Split | None) -> Mould:
    """Return the block around a part, with a wall of some thickness at least, without the part.

    Raises:
        MeshError: the part intersects itself so that the boolean operation fails.
    """
    cores = chambers(part)
    solid = _manifold(without_chambers(part) if cores else part)
    low, high = part.points.min(axis=0) - wall, part.points.max(axis=0) + wall
    whole = manifold3d.Manifold.cube(tuple(high - low)).translate(tuple(low)) - solid
    if whole.status() != manifold3d.Error.NoError:
        raise MeshError(
            f"the mould could not be made: {whole.status().name}",
            "Does the body pass through itself? The certificate of the run says where.",
        )
    if split is None:
        return Mould([_solid(whole)], cores)
    normal = [0.0, 0.0, 0.0]
    normal[split.axis] = 1.0
    upper, lower = whole.split_by_plane(tuple(normal), split.position_in(part))
    return Mould([_solid(lower), _solid(upper)], cores)


def undercut(part: Solid, split: Split) -> float:
    """Return the share of the part's surface that holds a half of the mould back as it is pulled along the axis.

    Closed chambers do not count: their cores are not pulled.
    """
    part = without_chambers(part)
    corners: Floats = part.points[part.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    heights = corners[:, :, split.axis] - split.position_in(part)
    is_above, is_below = (heights >= 0).all(axis=1), (heights <= 0).all(axis=1)
    pulled = normals[:, split.axis] / np.maximum(areas, np.finfo(float).tiny)
    held = (is_above & (pulled < -_STEEP)) | (is_below & (pulled > _STEEP))
    return float(areas[held].sum() / areas.sum())


def _manifold(part: Solid) -> manifold3d.Manifold:
    mesh = manifold3d.Mesh64(np.ascontiguousarray(part.points), np.ascontiguousarray(part.triangles, dtype=np.uint64))
    manifold = manifold3d.Manifold(mesh)
    if manifold.status() != manifold3d.Error.NoError:
        raise MeshError(
            f"the surface of the part is not a solid: {manifold.status().name}",
            "Look at the line on self-intersections in the certificate of the run.",
        )
    return manifold


def _solid(manifold: manifold3d.Manifold) -> Solid:
    mesh = manifold.to_mesh64()
    return Solid(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(np.int64))
