"""Comparison of two bodies: distances of their surfaces, volumes, and overlap.

Distances are measured from points of one surface to the other one, positive outside of it, weighted by area.
Source of the alignment: Besl & McKay, "A method for registration of 3-D shapes" (1992), doi:10.1109/34.121791; of
the overlap: Dice, "Measures of the amount of ecologic association between species" (1945), doi:10.2307/1932409.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista
import vtk

from hpcinv.mesh.source import Floats

_SAMPLES = 64  # voxels along the longest side of both bodies, for their overlap
_STEPS, _LANDMARKS = 200, 5000


@dataclass(frozen=True)
class Side:
    """One body compared with another; lengths in m.

    Attributes:
        volume: in m³.
        centre: of the volume.
        axes: principal axes of the volume as rows, the longest extent first.
        distances: of the surface's points, signed: mean, root mean square, 95 % quantile and largest of the sizes.
    """

    volume: float
    centre: list[float]
    axes: list[list[float]]
    mean: float
    rms: float
    quantile_95: float
    largest: float


@dataclass(frozen=True)
class Comparison:
    """Two bodies; the first one may have been moved to the second.

    Attributes:
        dice: twice the volume in both over the sum of both volumes.
        surface: the first one as it was compared, with ``distance`` (m) at its points.
    """

    first: Side
    second: Side
    dice: float
    rotation: float
    translation: float
    surface: pyvista.PolyData

    def as_data(self) -> dict[str, Any]:
        """JSON data, in SI."""
        moved = {"rotation": self.rotation, "translation": self.translation}
        return {"one": vars(self.first), "other": vars(self.second), "dice": self.dice, "moved": moved}


def compare(
    first: pyvista.PolyData, second: pyvista.PolyData, align: tuple[pyvista.PolyData, pyvista.PolyData] | None = None
) -> Comparison:
    """Compare two closed surfaces.

    Args:
        align: the surfaces, or parts of them, that shall agree best when the first one is moved rigidly to the second
            one; ``None`` moves nothing.
    """
    rotation, translation = 0.0, 0.0
    if align is not None:
        first, rotation, translation = _aligned(first, *align)
    there, back = _distances(first, second), _distances(second, first)
    first = first.copy()
    first.point_data["distance"] = there
    return Comparison(_side(first, there), _side(second, back), _dice(first, second), rotation, translation, first)


def _distances(measured: pyvista.PolyData, reference: pyvista.PolyData) -> Floats:
    return np.asarray(measured.compute_implicit_distance(reference)["implicit_distance"], dtype=np.float64)


def _side(surface: pyvista.PolyData, distances: Floats) -> Side:
    corners = np.asarray(surface.points, dtype=np.float64)[surface.regular_faces]
    twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners[:, 0].mean(axis=0)  # near the body, for the digits of the volume
    a, b, c = (corners[:, i] - middle for i in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    centre = middle + ((a + b + c) / 4 * volumes[:, None]).sum(axis=0) / volumes.sum()
    # Second moments about the centre, of tetrahedra with one corner there.
    shifted = np.stack([a, b, c, np.zeros_like(a)], axis=1) + middle - centre
    sums = shifted.sum(axis=1)
    products = np.einsum("nvi,nvj->nij", shifted, shifted) + np.einsum("ni,nj->nij", sums, sums)
    moments = np.einsum("nij,n->ij", products, volumes) / 20
    axes = np.linalg.eigh(moments * np.sign(volumes.sum()))[1].T[::-1]
    weights = np.zeros(surface.n_points)
    np.add.at(weights, surface.regular_faces.ravel(), np.repeat(np.linalg.norm(twice, axis=1) / 6, 3))
    weights /= weights.sum()
    sizes = np.abs(distances)
    order = np.argsort(sizes)
    rank = min(int(np.searchsorted(np.cumsum(weights[order]), 0.95)), len(order) - 1)
    return Side(
        volume=float(abs(volumes.sum())),
        centre=[float(c) for c in centre],
        axes=(axes * np.sign(axes[np.arange(3), np.abs(axes).argmax(axis=1)])[:, None]).tolist(),
        mean=float(weights @ distances),
        rms=float(np.sqrt(weights @ distances**2)),
        quantile_95=float(sizes[order][rank]),
        largest=float(sizes.max()),
    )


def _aligned(
    surface: pyvista.PolyData, source: pyvista.PolyData, target: pyvista.PolyData
) -> tuple[pyvista.PolyData, float, float]:
    """Move a surface rigidly as ``source`` to ``target``; also the angle (rad), and how far (m) its middle moves."""
    icp = vtk.vtkIterativeClosestPointTransform()
    icp.SetSource(source)
    icp.SetTarget(target)
    icp.GetLandmarkTransform().SetModeToRigidBody()
    icp.SetMaximumNumberOfIterations(_STEPS)
    icp.SetMaximumNumberOfLandmarks(_LANDMARKS)
    icp.SetCheckMeanDistance(1)
    icp.SetMaximumMeanDistance(1e-7 * surface.length)
    icp.StartByMatchingCentroidsOn()
    icp.Update()
    matrix = pyvista.array_from_vtkmatrix(icp.GetMatrix())
    cosine = (np.trace(matrix[:3, :3]) - 1) / 2
    middle = np.array(surface.center)
    moved = surface.copy()
    moved.points = surface.points @ matrix[:3, :3].T + matrix[:3, 3]
    shift = matrix[:3, :3] @ middle + matrix[:3, 3] - middle
    return moved, float(np.arccos(np.clip(cosine, -1, 1))), float(np.linalg.norm(shift))


def _dice(first: pyvista.PolyData, second: pyvista.PolyData) -> float:
    low = np.minimum(first.bounds[::2], second.bounds[::2])
    high = np.maximum(first.bounds[1::2], second.bounds[1::2])
    spacing = (high - low).max() / _SAMPLES
    counts = np.ceil((high - low) / spacing).astype(int) + 2
    grid = pyvista.ImageData(dimensions=counts, spacing=[spacing] * 3, origin=low - 0.5 * spacing)
    a, b = (np.asarray(s.voxelize_binary_mask(reference_volume=grid)["mask"]) > 0 for s in (first, second))
    return float(2 * (a & b).sum() / max(a.sum() + b.sum(), 1))
