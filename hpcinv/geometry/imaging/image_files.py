"""Files of images: NIfTI, NRRD, MetaImage, VTK image data and DICOM segmentations, also compressed by gzip."""

import importlib
from pathlib import Path
from typing import Any

from hpcinv.base.reading.fault import IMAGING
from hpcinv.base.reading.voxels import VoxelGrid
from hpcinv.errors import SystemPartMissing
from hpcinv.mesh.io.isolated import read_isolated

_FORMATS = (
    "Formats are NIfTI (.nii), NRRD, MetaImage (.mha, .mhd), VTK image data (.vti), these also compressed (.gz), and"
    " DICOM-SEG (.dcm); axes must be at right angles."
)


def package(name: str, use: str) -> Any:
    """Import a package; raise ``SystemPartMissing`` with its ``use`` if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise SystemPartMissing(f"{use}, which is not installed", IMAGING) from None


def read_voxels(path: Path) -> VoxelGrid:
    """Read the voxels of an image in a process of its own, in the unit of the file, and check them.

    Raises:
        MeshError: it cannot be read, contradicts itself, or there is not enough memory.
        SystemPartMissing: the packages for images are not installed.
    """
    head, arrays = read_isolated("image", path, "cannot be read as an image", _FORMATS)
    numbers = arrays.pop("numbers").transpose()
    return VoxelGrid(numbers, names=head["names"], **arrays)
