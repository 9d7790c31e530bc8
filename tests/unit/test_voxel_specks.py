"""Parts of labels that are too small for cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.label_image import LabelImage
from hpcinv.geometry.imaging.specks import represented_volumes


def test_labels_whose_parts_have_no_cell_are_refused_if_they_are_many() -> None:
    """A cube of 10³ voxels has a cell in its middle; specks in the corners have none."""
    voxels = np.zeros((20, 20, 20), dtype=np.int16)
    voxels[5:15, 5:15, 5:15] = 1
    image = LabelImage(Path("nodules.nrrd"), ("nodule",), voxels, np.full(3, 1e-3), np.zeros(3), np.eye(3))
    cells, first, spacing, told = np.ones((1, 1, 1), dtype=np.int16), np.full(3, 9.5), 5e-3, list[str]()
    for size, volume in ((0, 1e-6), (3, 1e-6 * 1000 / 1027)):
        voxels[:size, :size, :size] = 1
        assert represented_volumes(image, cells, first, spacing, [1e-6], told.append) == pytest.approx([volume])
    assert told == ["nodule: 1 part of 27 mm^3 in all, too small for cells"]
    voxels[17:, :4, :10] = voxels[:3, 16:, 10:] = 1
    with pytest.raises(MeshError, match=r"21% of the label 'nodule' is in parts too small for the cells \(3 of 4\)"):
        represented_volumes(image, cells, first, spacing, [1e-6], told.append)
