"""Names of what is beyond the surface of a meshed image: a closed cavity, a neighbour or the outside."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.quantity.units import readable
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.label_image import LabelImage
from hpcinv.mesh.boundary_shells import shells
from hpcinv.mesh.source import Floats, Ints

type NameArray = npt.NDArray[np.object_]

OUTSIDE, CAVITY = "outside", "cavity"
_STEP = 0.5  # along normals, relative to the smallest side of voxels


def surroundings(points: Floats, facets: Ints, pairs: Ints, image: LabelImage, first: Ints, reach: float) -> NameArray:
    """Return a name for each facet: of those between two labels, `OUTSIDE`.

    A neighbour is looked for along the normal: the nearest one behind a wall is not at its other side.

    Args:
        points: (n, 3) in m from the voxel ``first``, the facets' corners.
        facets, pairs: from `interfaces`, (m, 3) and (m, 2).
        reach: distance (m) up to which neighbours are next to the surface.

    Raises:
        MeshError: a neighbour is nowhere next to the body.
    """
    names = np.full(len(facets), OUTSIDE, dtype=object)
    surface = np.flatnonzero(pairs[:, 0] == 0)
    # Facets of the cells in which they were found first are turned outwards.
    corners = points[facets[surface]]
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    number = shells(facets[surface], volumes)
    for cavity in range(1, int(number.max(initial=0)) + 1):
        names[surface[number == cavity]] = CAVITY if cavity == 1 else f"{CAVITY}-{cavity}"
    if not image.neighbours:
        return names
    middles, normals = corners.mean(axis=1), _normals(points, facets[surface])
    neighbours = _neighbours(middles, normals, image, list(image.neighbours.values()), first, reach)
    for i, name in enumerate(image.neighbours):
        if not (neighbours == i).any():
            masks = {label: image.numbers == label for label in np.unique(image.numbers[image.voxels == 0]) if label}
            label_numbers = _neighbours(middles, normals, image, list(masks.values()), first, reach)
            shares = {label: np.count_nonzero(label_numbers == i) / len(label_numbers) for i, label in enumerate(masks)}
            there = sorted((label for label in masks if shares[label]), key=lambda label: -shares[label])
            alternatives = ", ".join(f"{label} (at {shares[label]:.0%} of its surface)" for label in there)
            raise MeshError(
                f"{image.path}: the neighbour '{name}' is nowhere within {readable(reach, 'm')} of the body",
                f"Check its number; labels next to the body: {alternatives or 'none'}.",
            )
        names[surface[neighbours == i]] = name
    return names


def _normals(points: Floats, facets: Ints) -> Floats:
    """Unit normals (m, 3) of facets, means over the facets around their corners: voxels have left them uneven."""
    a, b, c = (points[facets[:, i]] for i in range(3))
    areas, total = np.cross(b - a, c - a), np.zeros_like(points)
    for i in range(3):
        np.add.at(total, facets[:, i], areas)
    mean = total[facets].sum(axis=1)
    return np.asarray(mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300))


def _neighbours(
    middles: Floats, normals: Floats, image: LabelImage, masks: Sequence[Booleans], first: Ints, reach: float
) -> Ints:
    """Return the number of the first mask along each normal; -1 if there is none before the body begins again."""
    mask_numbers, last = np.full(len(middles), -1), np.array(image.voxels.shape) - 1
    is_open, has_left = np.ones((2, len(middles)), dtype=bool)
    has_left[:] = False
    step = _STEP * float(image.spacing.min())
    for distance in np.arange(0, reach + step, step):
        places = np.rint((middles + distance * normals) / image.spacing + first).astype(int)
        voxels = tuple(np.clip(places, 0, last).T)
        is_body = image.voxels[voxels] > 0
        is_open &= ~(has_left & is_body)
        has_left |= ~is_body
        for i, mask in enumerate(masks):
            mask_numbers[is_open & mask[voxels]] = i
        is_open &= mask_numbers < 0
    return mask_numbers
