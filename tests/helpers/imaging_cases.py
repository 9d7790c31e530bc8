"""Images of simple bodies, and the meshes that are made of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcinv.job.job import parse
from hpcinv.mesh.body import read_source
from hpcinv.mesh.checks import check
from hpcinv.mesh.source import MeshSource

SimpleITK = pytest.importorskip("SimpleITK")

JOB: Mapping[str, Any] = {"material": {"law": "neo-hookean", "young": "5 kPa", "poisson": 0.4}}
HELD = {"region": "boundary", "fix": ["x", "y", "z"]}
BALL = 10.0  # mm


def grid(count: int = 24) -> np.ndarray:
    """Middles of voxels of 1 mm, with the origin in the middle of the image; last axis x, y, z."""
    axis = np.arange(count) - (count - 1) / 2
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


def ball() -> np.ndarray:
    return (np.linalg.norm(grid(), axis=-1) < BALL).astype(np.uint8)


def written(path: Path, voxels: np.ndarray, spacing: tuple[float, ...] = (1, 1, 1), **meta: Any) -> Path:
    """An image of voxels (nx, ny, nz)."""
    image = SimpleITK.GetImageFromArray(voxels.transpose())
    image.SetSpacing(spacing)
    if "direction" in meta:
        image.SetDirection(meta["direction"])
    image.SetOrigin(meta.get("origin", (0, 0, 0)))
    SimpleITK.WriteImage(image, str(path))
    return path


def meshed(image: Path, said: list[str] | None = None, **mesh: Any) -> MeshSource:
    spec = {"image": image.name, "labels": {"ball": 1}, "size": "4 mm"} | mesh
    job = parse(
        {**JOB, "mesh": spec, "supports": [{"region": "boundary", "fix": ["x", "y", "z"]}]}, image.parent / "job.yaml"
    )
    source = read_source(job.mesh, image, (said if said is not None else []).append)
    check(source)
    return source


def volumes(source: MeshSource) -> dict[str, float]:
    corners = source.points[source.cells]
    each = abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    return {group.name: each[group.members].sum() for group in source.groups if group.dim == 3}


def inside(surface: Path, **mesh: Any) -> MeshSource:
    spec = {"surface": surface.name, "unit": "mm", "size": "4 mm"} | mesh
    job = parse({**JOB, "mesh": spec, "supports": [HELD]}, surface.parent / "job.yaml")
    source = read_source(job.mesh, surface)
    check(source)
    return source
