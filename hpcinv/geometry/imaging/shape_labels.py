"""The label map of a shape: voxels of an image's grid, with the numbers of the cells that their middles are in."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.reading.voxels import VoxelGrid
from hpcinv.errors import OutputError
from hpcinv.geometry.imaging.image_files import package
from hpcinv.geometry.imaging.label_image import frame_of
from hpcinv.mesh.refine.subdivision import eighths
from hpcinv.mesh.source import Floats, Ints, MeshSource

WRITTEN = (".nrrd", ".nii", ".nii.gz", ".mha")
"""endings of label maps that are written; ``.seg.nrrd`` has the names, too"""
_CHUNK = 2_000_000
"""voxels that are tried at once; more memory (about 150 bytes each) if raised"""
_ON_FACE = 1e-9
"""barycentric coordinate below 0 at which a point is still in a cell; if raised, cells grow by this share"""


@dataclass(frozen=True)
class LabelMap:
    """Numbers of voxels.

    Attributes:
        grid: numbers (nx, ny, nz) in LPS, in the unit of the image.
        added: voxels by which the grid is larger than the image, before and after it along each axis, (2, 3).
        volumes: of the voxels (m³), by region.
    """

    grid: VoxelGrid
    added: Ints
    volumes: Mapping[str, float]


def shape_labels(
    source: MeshSource, image: VoxelGrid, numbers: Mapping[str, int], unit: float, orientation: str
) -> LabelMap:
    """Return the label map of a shape of tetrahedra on the grid of an image, which becomes larger where it leaves it.

    Args:
        source: shape in m, in the frame of ``orientation``; curved cells count as eight straight ones.
        numbers: of the regions of cells, by name.
        unit: length unit (m) of the image.
    """
    places = (source.points @ frame_of(orientation) / unit - image.origin) @ image.axes / image.spacing
    vertices, parents = source.cells[:, :4], np.arange(len(source.cells))
    if source.degree == 2:
        pieces = eighths(source)
        vertices, parents = pieces.vertices, pieces.parents
    corners = places[vertices]
    size = np.array(image.numbers.shape)
    low = np.minimum(np.ceil(corners.min(axis=(0, 1))), 0).astype(np.int64)
    high = np.maximum(np.floor(corners.max(axis=(0, 1))) + 1, size).astype(np.int64)
    largest = max(numbers.values())
    voxels = np.zeros(high - low, dtype=np.result_type(image.numbers.dtype, np.min_scalar_type(largest)))
    groups = source.labels(3)[parents]
    of_group = np.array([numbers.get(group.name, 0) for group in source.groups] + [0])
    for rows, middles in _inside(corners - low):
        voxels[tuple(middles.T)] = of_group[groups[rows]]
    origin = image.origin + image.axes @ (low * image.spacing)
    each = float(image.spacing.prod()) * unit**3
    volumes = {name: each * int(np.count_nonzero(voxels == number)) for name, number in numbers.items()}
    grid = VoxelGrid(voxels, image.spacing, origin, image.axes, dict(numbers))
    return LabelMap(grid, np.array([-low, high - size]), volumes)


def _inside(corners: Floats) -> Iterator[tuple[Ints, Ints]]:
    """Yield rows of tetrahedra (n, 4, 3) and the whole places (n, 3) in them, the last tetrahedron of a place last."""
    low = np.ceil(corners.min(axis=1) - _ON_FACE).astype(np.int64)
    counts = np.maximum(np.floor(corners.max(axis=1) + _ON_FACE).astype(np.int64) - low + 1, 0)
    tried = counts.prod(axis=1)
    to_barycentric = np.linalg.inv(corners[:, 1:] - corners[:, :1])  # row vectors from the first corner
    ends = np.cumsum(tried)
    begin = 0
    while begin < len(corners):
        end = max(int(np.searchsorted(ends, (ends[begin - 1] if begin else 0) + _CHUNK, side="right")), begin + 1)
        rows = np.repeat(np.arange(begin, end), tried[begin:end])
        place = np.arange(len(rows)) - np.repeat(
            ends[begin:end] - tried[begin:end] - (ends[begin] - tried[begin]), tried[begin:end]
        )
        shape = counts[rows]
        local = np.stack(
            [place // (shape[:, 1] * shape[:, 2]), place // shape[:, 2] % shape[:, 1], place % shape[:, 2]]
        )
        middles = low[rows] + local.T
        shares = np.einsum("ni,nij->nj", middles - corners[rows, 0], to_barycentric[rows])
        is_inside: Booleans = (shares >= -_ON_FACE).all(axis=1) & (shares.sum(axis=1) <= 1 + _ON_FACE)
        yield rows[is_inside], middles[is_inside]
        begin = end


def write_labels(path: Path, grid: VoxelGrid) -> None:
    """Write a label map, completely or not at all.

    Raises:
        OutputError: it cannot be written.
        SystemPartMissing: the packages for images are not installed.
    """
    sitk = package("SimpleITK", "a label map is written by SimpleITK")
    image = sitk.GetImageFromArray(np.ascontiguousarray(grid.numbers.transpose()))
    image.SetSpacing(grid.spacing.tolist())
    image.SetOrigin(grid.origin.tolist())
    image.SetDirection(grid.axes.ravel().tolist())
    if path.name.lower().endswith(".seg.nrrd"):
        for key, value in _segments(grid):
            image.SetMetaData(key, value)
    with tempfile.TemporaryDirectory() as directory:
        scrap = Path(directory) / path.name
        try:
            sitk.WriteImage(image, str(scrap), useCompression=True)
        except RuntimeError as error:
            raise OutputError(f"{path}: cannot be written: {error}") from None
        write_output(path, scrap.read_bytes(), "Is the directory writable, and space left?")


def _segments(grid: VoxelGrid) -> Iterator[tuple[str, str]]:
    """Yield what 3D Slicer's segmentations say of each number in their header."""
    last = [side - 1 for side in grid.numbers.shape]
    extent = " ".join(f"0 {end}" for end in last)
    yield "Segmentation_ReferenceImageExtentOffset", "0 0 0"
    for place, (name, number) in enumerate(grid.names.items()):
        head = f"Segment{place}"
        yield f"{head}_ID", f"Segment_{place + 1}"
        yield f"{head}_Name", name
        yield f"{head}_LabelValue", str(number)
        yield f"{head}_Layer", "0"
        yield f"{head}_Extent", extent
