"""DICOM segmentations written by highdicom, an independent program, are read where they lie."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcinv.__main__ import main
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.label_image import read_labels

pytestmark = pytest.mark.usefixtures("warm_reader")

highdicom = pytest.importorskip("highdicom")
pydicom = pytest.importorskip("pydicom")

AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])  # columns run to the back, rows to the feet
SPACING = (2.0, 1.5)  # of rows, of columns
STEP, ORIGIN = 3.0, np.array([10.0, -20.0, 30.0])


def slices(count: int, rows: int, columns: int) -> list[Any]:
    """Slices of a CT scan without a picture."""
    series, frame = pydicom.uid.generate_uid(), pydicom.uid.generate_uid()
    study, normal, made = pydicom.uid.generate_uid(), np.cross(*AXES), []
    for i in range(count):
        data = pydicom.Dataset()
        data.file_meta = pydicom.dataset.FileMetaDataset()
        data.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
        data.SOPClassUID, data.SOPInstanceUID = pydicom.uid.CTImageStorage, pydicom.uid.generate_uid()
        data.StudyInstanceUID, data.SeriesInstanceUID, data.FrameOfReferenceUID = study, series, frame
        data.PatientID = data.PatientName = data.PatientSex = data.PatientBirthDate = ""
        data.StudyID = data.StudyDate = data.StudyTime = data.AccessionNumber = data.ReferringPhysicianName = ""
        data.Modality, data.SeriesNumber, data.InstanceNumber = "CT", 1, i + 1
        data.Rows, data.Columns, data.PixelSpacing, data.SliceThickness = rows, columns, list(SPACING), STEP
        data.ImageOrientationPatient = AXES.ravel().tolist()
        data.ImagePositionPatient = (ORIGIN + i * STEP * normal).tolist()
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.BitsAllocated = data.BitsStored = 16
        data.HighBit, data.PixelRepresentation = 15, 0
        data.PixelData = bytes(2 * rows * columns)
        made.append(data)
    return made


def write(path: Path, masks: dict[str, np.ndarray], kind: str = "BINARY") -> Path:
    """A segmentation of masks (slices, rows, columns)."""
    code = highdicom.sr.CodedConcept("123037004", "SCT", "Anatomical structure")
    descriptions = [
        highdicom.seg.SegmentDescription(
            segment_number=i,
            segment_label=name,
            segmented_property_category=code,
            segmented_property_type=code,
            algorithm_type=highdicom.seg.SegmentAlgorithmTypeValues.MANUAL,
        )
        for i, name in enumerate(masks, start=1)
    ]
    stack = np.stack(list(masks.values()), axis=-1).astype(np.uint8)
    highdicom.seg.Segmentation(
        source_images=slices(*stack.shape[:3]),
        pixel_array=stack,
        segmentation_type=kind,
        segment_descriptions=descriptions,
        series_instance_uid=pydicom.uid.generate_uid(),
        series_number=2,
        sop_instance_uid=pydicom.uid.generate_uid(),
        instance_number=1,
        manufacturer="test",
        manufacturer_model_name="test",
        software_versions="1",
        device_serial_number="1",
    ).save_as(path)
    return path


def masks() -> dict[str, np.ndarray]:
    """Two boxes of slices, rows and columns."""
    liver, mass = np.zeros((2, 10, 16, 14), dtype=bool)
    liver[2:8, 3:13, 2:12] = True
    mass[4:6, 6:9, 4:9] = True
    return {"Liver": liver & ~mass, "Mass": mass}


@pytest.mark.everyday("FRACTIONAL")
@pytest.mark.parametrize("kind", ["BINARY", "FRACTIONAL"])
def test_segments_by_name_and_number(kind: str, tmp_path: Path) -> None:
    given = masks()
    image = read_labels(write(tmp_path / "seg.dcm", given, kind), {"liver": ["Liver"], "tumour": [2]}, 1e-3)
    voxel = 1e-9 * STEP * SPACING[0] * SPACING[1]
    for label, mask in enumerate(given.values(), start=1):
        assert image.volume(label) == pytest.approx(mask.sum() * voxel)
        middle = np.argwhere(mask).mean(axis=0) * [STEP, *SPACING]  # along slices, rows, columns
        expected = ORIGIN + middle[0] * np.cross(*AXES) + middle[1] * AXES[1] + middle[2] * AXES[0]
        positions = np.argwhere(image.voxels == label).mean(axis=0) * image.spacing
        assert image.positions(positions[None])[0] * 1e3 == pytest.approx(expected)


def test_faults_are_reported(tmp_path: Path) -> None:
    path = write(tmp_path / "seg.dcm", masks())
    with pytest.raises(MeshError, match=r"has no segment 'Liwer'\. Did you mean 'Liver'"):
        read_labels(path, {"liver": ["Liwer"]}, 1e-3)
    whole = masks()["Liver"] | masks()["Mass"]
    with pytest.raises(MeshError, match="the segments 1 and 2 overlap"):
        read_labels(write(tmp_path / "both.dcm", masks() | {"Liver": whole}), {"liver": [1]}, 1e-3)
    slices(1, 4, 4)[0].save_as(tmp_path / "ct.dcm", enforce_file_format=True)
    with pytest.raises(MeshError, match="is not a DICOM segmentation"):
        read_labels(tmp_path / "ct.dcm", {"liver": [1]}, 1e-3)
    (tmp_path / "text.dcm").write_text("no DICOM")
    with pytest.raises(MeshError, match="is not a DICOM file"):
        read_labels(tmp_path / "text.dcm", {"liver": [1]}, 1e-3)


def moved(frame: int, distance: float) -> Callable[[Any], None]:
    """A change of the position of one frame along the normal of the slices."""

    def change(data: Any) -> None:
        place = data.PerFrameFunctionalGroupsSequence[frame].PlanePositionSequence[0]
        position = np.array(place.ImagePositionPatient, dtype=float) + distance * np.cross(*AXES)
        place.ImagePositionPatient = position.tolist()

    return change


def shared(name: str, key: str, value: Any) -> Callable[[Any], None]:
    return lambda data: setattr(getattr(data.SharedFunctionalGroupsSequence[0], name)[0], key, value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda data: [moved(i, -i * STEP)(data) for i in range(2)],
            "has two slices at the same place, of the segment 1",
        ),
        (moved(3, 0.2 * STEP), "its slices have unequal distances"),
        (moved(3, float("nan")), "which is not a place"),
        (lambda data: setattr(data, "Rows", 15), "bytes of voxels, but its header says"),
        (lambda data: setattr(data, "NumberOfFrames", 7), "bytes of voxels, but its header says"),
        (shared("PixelMeasuresSequence", "PixelSpacing", [-2.0, 1.5]), "voxels of 1.5 x -2 x 1, which are not lengths"),
        (shared("PlaneOrientationSequence", "ImageOrientationPatient", [0, 2, 0, 0, 0, -2]), "directions of lengths"),
        (
            shared("PlaneOrientationSequence", "ImageOrientationPatient", [0, 1, 0, 0, 0.6, -0.8]),
            "directions of lengths 1, 1, 0.8",
        ),
    ],
)
def test_headers_that_contradict_themselves_are_refused(
    change: Callable[[Any], Any], message: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "seg.dcm", masks())
    data = pydicom.dcmread(path)
    change(data)
    data.save_as(path)
    with pytest.raises(MeshError, match=message):
        read_labels(path, {"liver": [1]}, 1e-3)


def test_dicom_segmentations_run_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "seg.dcm", masks())
    options = ["--label", "liver=Liver,2", "--size", "8 mm"]
    assert main(["mesh", "from-image", str(path), str(tmp_path / "liver.msh"), *options]) == 0
    assert "liver|outside" in capsys.readouterr().out
