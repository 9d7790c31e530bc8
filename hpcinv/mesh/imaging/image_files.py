"""Files of images: NIfTI, NRRD, MetaImage, VTK image data and DICOM segmentations, also compressed by gzip."""

import gzip
import tempfile
import zlib
from pathlib import Path

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.imaging.dicom_segmentation import read_segmentation
from hpcinv.mesh.imaging.headers import check_nifti
from hpcinv.mesh.imaging.packages import package
from hpcinv.mesh.imaging.voxel_grid import VoxelGrid
from hpcinv.parallel.available_memory import available
from hpcinv.parallel.runtime import MPI

_FORMATS = (
    "Formats are NIfTI (.nii), NRRD, MetaImage (.mha, .mhd), VTK image data (.vti), these also compressed (.gz), and"
    " DICOM-SEG (.dcm); axes must be at right angles."
)
_CHUNK = 1 << 22
_PACKED = (".nrrd", ".mha", ".vti")  # besides .nii.gz, which readers know


def read_voxels(path: Path) -> VoxelGrid:
    """Read the voxels of an image on this process, in the unit of the file.

    Raises:
        MeshError: it cannot be read, or there is not enough memory.
        SystemPartMissing: the packages for images are not installed.
    """
    if path.suffix == ".dcm":
        return read_segmentation(path)
    if path.suffix == ".gz" and (inner := Path(path.stem).suffix) in _PACKED:
        with tempfile.TemporaryDirectory(prefix="hpcinv-image-") as directory:
            unpacked = Path(directory) / f"image{inner}"
            _unpack(path, unpacked)
            return _read_vti(unpacked, path) if inner == ".vti" else _read_itk(unpacked, path)
    return _read_vti(path, path) if path.suffix == ".vti" else _read_itk(path, path)


def _unpack(path: Path, to: Path) -> None:
    """Unpack a file up to the size for which there is memory."""
    most, written = available(MPI.COMM_SELF), 0
    try:
        with gzip.open(path) as packed, to.open("wb") as file:
            while part := packed.read(_CHUNK):
                written += file.write(part)
                if written > most:
                    raise MeshError(
                        f"{path}: is more than the {most / 1e9:.1f} GB of memory that are available",
                        "Crop the image or resample it.",
                    )
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise MeshError(f"{path}: cannot be read as an image: {error}", "Is the file complete?") from None


def _read_itk(path: Path, called: Path) -> VoxelGrid:
    """Read by SimpleITK; errors name ``called`` instead of ``path``."""
    SimpleITK = package("SimpleITK", "images are read by SimpleITK")
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    if path.suffix in (".nii", ".gz"):
        check_nifti(path)
    reader = SimpleITK.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
        if (colours := reader.GetNumberOfComponents()) > 1:
            raise MeshError(
                f"{called}: has {colours} numbers in each voxel", "Give a segmentation, with one number in each voxel."
            )
        one = SimpleITK.Image([1] * len(reader.GetSize()), reader.GetPixelID())
        _check_memory(called, int(np.prod(reader.GetSize(), dtype=object)), one.GetSizeOfPixelComponent())
        image = reader.Execute()
    except RuntimeError as error:
        said = str(error).strip().rsplit("\n", 1)[-1].replace(str(path), str(called))
        raise MeshError(f"{called}: cannot be read as an image: {said}", _FORMATS) from error
    numbers = SimpleITK.GetArrayFromImage(image).transpose()
    spacing, origin = np.array(image.GetSpacing()), np.array(image.GetOrigin())
    return VoxelGrid(numbers, spacing, origin, np.array(image.GetDirection()).reshape(len(spacing), -1))


def _read_vti(path: Path, called: Path) -> VoxelGrid:
    """Read VTK image data: labels of its points or of its cells, which are voxels then; their frame is taken as LPS."""
    import pyvista

    from hpcinv.mesh.io.surface_files import without_messages_of_vtk

    with without_messages_of_vtk():
        try:
            image = pyvista.read(path)
        except Exception as error:  # readers of VTK raise various errors
            raise MeshError(f"{called}: cannot be read as an image: {error}", _FORMATS) from error
    found = [(name, of) for of in (image.cell_data, image.point_data) for name in of if len(of[name])]
    if not isinstance(image, pyvista.ImageData) or not found:
        raise MeshError(f"{called}: has no voxels with numbers", _FORMATS)
    named = [(name, of) for name, of in found if name == of.active_scalars_name]
    if len(found) > 1 and len(named) != 1:
        names = ", ".join(repr(name) for name, _ in found)
        raise MeshError(f"{called}: has several arrays: {names}", "Write it with the one of the labels only.")
    name, of = found[0] if len(found) == 1 else named[0]
    values = np.asarray(of[name])
    if values.ndim > 1:
        raise MeshError(
            f"{called}: has {values.shape[1]} numbers in each voxel",
            "Give a segmentation, with one number in each voxel.",
        )
    spacing, axes = np.array(image.spacing), np.asarray(image.direction_matrix)
    is_of_cells = of is image.cell_data or len(values) == image.n_cells
    shape = np.array(image.dimensions) - is_of_cells
    first = np.array(image.extent[::2]) + 0.5 * is_of_cells
    return VoxelGrid(values.reshape(shape, order="F"), spacing, np.array(image.origin) + axes @ (first * spacing), axes)


def _check_memory(path: Path, voxels: int, size: int) -> None:
    """Check that there is memory for an image of voxels of some bytes, as read, as an array, and as labels."""
    if (needed := voxels * (2 * size + 4)) > (free := available(MPI.COMM_SELF)):
        raise MeshError(
            f"{path}: reading it takes about {needed / 1e9:.1f} GB of memory, but {free / 1e9:.1f} GB are available",
            "Cut it to the labels, or resample it to larger voxels.",
        )
