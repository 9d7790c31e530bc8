"""Parts of labels that are too small for cells: islands, holes, and walls of less than two voxels."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from hpcinv.base.quantity.units import readable
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.label_image import LabelImage
from hpcinv.mesh.source import Floats, Ints

_ISLAND = 0.01  # share of a body's volume up to which a part that touches no other is left out
_ISLANDS = 0.05  # share of a label's volume up to which its islands may be left out
_THIN = 0.5  # share of a label's volume in walls of one voxel from which on it is refused
_NOTED = 0.05  # share of a label's volume in such walls from which on it is reported
_BLOCK = np.ones((2, 2, 2), dtype=bool)


def check_extent(path: Path, extent: Floats, size: float, *, fits: bool) -> None:
    """Check that a body is larger than a cell, and not so large that its unit must be wrong.

    Args:
        extent: of the body, (3,) m.
        size: of cells (m).
        fits: whether there is memory for a box around the body.
    """
    extents = " x ".join(readable(float(length), "m") for length in extent)
    if extent.max() < size:
        raise MeshError(
            f"{path}: the body of {extents} is too small or thin for cells of {readable(size, 'm')}",
            "Make mesh.size smaller. Is mesh.unit right?",
        )
    if not fits:
        raise MeshError(
            f"{path}: the body of {extents} is too large for cells of {readable(size, 'm')}"
            f" ({np.prod(extent / size):.2g} in a box)",
            "Make mesh.size larger. Is mesh.unit right?",
        )


def check_thickness(image: LabelImage, report: Callable[[str], None]) -> None:
    """Check that labels are two voxels thick: that blocks of 2 x 2 x 2 voxels cover them.

    Raises:
        MeshError: most of a label is thinner.
    """
    for label, name in enumerate(image.names, start=1):
        mask = _box_of(image, label)
        # A label that is cut by the image's border goes on behind it.
        thick = ndimage.binary_opening(np.pad(mask, 1, mode="edge"), _BLOCK)[1:-1, 1:-1, 1:-1] & mask
        share = 1 - np.count_nonzero(thick) / np.count_nonzero(mask)
        share_in_walls = f"{share:.0%} of the label '{name}' is in walls of less than two voxels"
        if share > _THIN:
            raise MeshError(
                f"{image.path}: {share_in_walls}, which have no thickness that could be meshed",
                "Use a finer image, or mesh the closed surface of a wall whose thickness you know.",
            )
        if share > _NOTED:
            report(f"{share_in_walls}, whose thickness is uncertain")


def remove_specks(image: LabelImage, size: float, report: Callable[[str], None]) -> LabelImage:
    """The image without small parts that touch no other and without holes below the size of a cell, which are reported.

    Raises:
        MeshError: islands are a good part of a label.
    """
    return _fill_holes(_remove_islands(image, report), size, report)


def represented_volumes(
    image: LabelImage,
    cell_labels: Ints,
    first: Floats,
    spacing: float,
    volumes: Sequence[float],
    report: Callable[[str], None],
) -> list[float]:
    """Volumes of labels without parts, such as nodules, that no cell of the lattice represents; these are reported.

    Args:
        cell_labels: labels of the lattice's cells.
        first: the middle of the first of them in voxels, (3,).
        spacing: of the lattice (m).
        volumes: of the labels.
    """
    kept = list(volumes)
    for label, name in enumerate(image.names, start=1):
        parts, count = ndimage.label(image.voxels == label, np.ones((3, 3, 3)))
        if count < 2:
            continue
        sizes = np.bincount(parts.ravel(), minlength=count + 1)
        neighbourhood = ndimage.grey_dilation(parts, size=(3, 3, 3))  # cells may lie a voxel away from a part
        places = np.rint(first + np.argwhere(cell_labels == label) * spacing / image.spacing).astype(int)
        places = np.clip(places, 0, np.array(image.voxels.shape) - 1)
        lost = np.ones(count + 1, dtype=bool)
        lost[[0, *np.unique(neighbourhood[tuple(places.T)]), *np.unique(parts[tuple(places.T)])]] = False
        if lost.any():
            share = float(sizes[lost].sum() / sizes[1:].sum())
            if share > _ISLANDS:
                raise MeshError(
                    f"{image.path}: {share:.0%} of the label '{name}' is in parts too small for the cells"
                    f" ({lost.sum()} of {count})",
                    "Make mesh.size smaller, or give those parts to the label around them.",
                )
            plural = "s" if lost.sum() > 1 else ""
            volume = _volume(image, sizes[lost].sum())
            report(f"{name}: {lost.sum()} part{plural} of {volume} in all, too small for cells")
            kept[label - 1] *= 1 - share
    return kept


def _remove_islands(image: LabelImage, report: Callable[[str], None]) -> LabelImage:
    parts, count = ndimage.label(image.voxels > 0)
    if count < 2:
        return image
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    small = (sizes < _ISLAND * sizes.sum()) & (sizes > 0)
    if not small.any():
        return image
    lost = small[parts]
    voxels = np.where(lost, 0, image.voxels)
    for label, name in enumerate(image.names, start=1):
        share = 1 - np.count_nonzero(voxels == label) / np.count_nonzero(image.voxels == label)
        if share > _ISLANDS:
            raise MeshError(
                f"{image.path}: {share:.0%} of the label '{name}' is in {small.sum()} islands, each below"
                f" {_ISLAND:.0%} of the body",
                "Remove them from the segmentation, or fill the gaps between them.",
            )
    report(
        f"{small.sum()} island{'s' if small.sum() > 1 else ''} of {_volume(image, lost.sum())} in all left out",
    )
    return replace(image, voxels=voxels)


def _fill_holes(image: LabelImage, size: float, report: Callable[[str], None]) -> LabelImage:
    """Holes below the size of a cell belong to the label around them."""
    background = np.pad(image.voxels == 0, 1, constant_values=True)  # holes that reach the border are none
    parts, count = ndimage.label(background)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    small = sizes * image.spacing.prod() < size**3
    small[[0, parts[0, 0, 0]]] = False
    if not small.any():
        return image
    filled = small[parts][1:-1, 1:-1, 1:-1]
    nearest = ndimage.distance_transform_edt(
        image.voxels == 0, sampling=image.spacing, return_distances=False, return_indices=True
    )
    voxels = np.where(filled, image.voxels[tuple(nearest)], image.voxels)
    plural = "s" if small.sum() > 1 else ""
    report(f"{small.sum()} hole{plural} of {_volume(image, filled.sum())} in all, smaller than a cell, filled")
    return replace(image, voxels=voxels)


def _box_of(image: LabelImage, label: int) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Voxels of one label in the box around them, with a margin of one that ends with the image."""
    mask = image.voxels == label
    (box,) = ndimage.find_objects(mask.astype(np.int8))
    return np.asarray(mask[tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in box)])


def _volume(image: LabelImage, count: int) -> str:
    return readable(float(count * image.spacing.prod()), "m^3")
