"""Images and surfaces that contradict themselves, are cut, or name other files: one message, in bounded time."""

from __future__ import annotations

import bz2
import gzip
import os
import re
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import pyvista
from helpers.forked_reader import load_libraries, run_forked

from hpcinv.base.reading import isolated_reader, reader_process
from hpcinv.errors import JobError, MeshError
from hpcinv.geometry.imaging.closed_surface import read_closed, signed_volume
from hpcinv.geometry.imaging.label_image import labels_in, read_labels
from hpcinv.job.job import load
from hpcinv.mesh.io import isolated
from hpcinv.mesh.io.surface_files import read_triangles
from hpcinv.studies.sweep.sweep_plan import load_sweep

SimpleITK = pytest.importorskip("SimpleITK")


@pytest.fixture
def forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Readers are forks of this process: a start of each takes half a second."""
    load_libraries()
    monkeypatch.setattr(isolated, "run_isolated", run_forked)


SHAPE = (9, 8, 7)
METAIMAGE = {
    "ObjectType": "Image",
    "NDims": "3",
    "BinaryData": "True",
    "BinaryDataByteOrderMSB": "False",
    "CompressedData": "False",
    "TransformMatrix": "0 1 0 0 0 1 1 0 0",
    "Offset": "5 6 7",
    "ElementSpacing": "1 2 3",
    "DimSize": "9 8 7",
    "ElementType": "MET_SHORT",
    "ElementDataFile": "LOCAL",
}
NRRD = {
    "type": "short",
    "dimension": "3",
    "space": "right-anterior-superior",
    "sizes": "9 8 7",
    "space directions": "(0,1,0) (0,0,2) (3,0,0)",
    "space origin": "(5,6,7)",
    "encoding": "raw",
    "endian": "little",
}


def block() -> np.ndarray:
    voxels = np.zeros(SHAPE, dtype="<i2")
    voxels[2:7, 2:6, 2:5] = 300
    return voxels


def raw() -> bytes:
    return block().tobytes(order="F")


def metaimage(content: bytes, **changes: str) -> bytes:
    """A MetaImage; an empty change leaves an entry out."""
    entries = METAIMAGE | changes
    entries["ElementDataFile"] = entries.pop("ElementDataFile")  # the last one
    return "".join(f"{key} = {value}\n" for key, value in entries.items() if value).encode() + content


def nrrd(content: bytes, **changes: str) -> bytes:
    entries = NRRD | {key.replace("_", " "): value for key, value in changes.items()}
    head = "".join(f"{key}: {value}\n" for key, value in entries.items() if value)
    return b"NRRD0004\n" + head.encode() + b"\n" + content


def vti(*, spacing: str = 'Spacing="1 2 3"', direction: str = "1 0 0 0 1 0 0 0 1", piece: str = "0 8 0 7 0 6") -> bytes:
    numbers = " ".join(map(str, block().ravel(order="F")))
    return (
        '<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian">'
        f'<ImageData WholeExtent="0 8 0 7 0 6" Origin="0 0 0" {spacing} Direction="{direction}">'
        f'<Piece Extent="{piece}"><PointData Scalars="l"><DataArray type="Int16" Name="l" format="ascii">{numbers}'
        "</DataArray></PointData></Piece></ImageData></VTKFile>"
    ).encode()


def nifti(*changes: tuple[str, int, tuple[float, ...]], cut: int = 0) -> bytes:
    """A NIfTI-1 file with values of its header in other places."""
    head = bytearray(352)
    struct.pack_into("<i", head, 0, 348)
    struct.pack_into("<8h", head, 40, 3, *SHAPE, 1, 1, 1, 1)
    struct.pack_into("<2h", head, 70, 4, 16)
    struct.pack_into("<8f", head, 76, 1, 1, 2, 3, 1, 1, 1, 1)
    struct.pack_into("<f", head, 108, 352)
    struct.pack_into("<2h", head, 252, 0, 1)
    struct.pack_into("<12f", head, 280, 1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 3, 0)
    head[123], head[344:348] = 2, b"n+1\0"
    for kind, place, values in changes:
        struct.pack_into(f"<{len(values)}{kind}", head, place, *values)
    content = bytes(head) + raw()
    return content[: len(content) - cut]


def read(path: Path, content: bytes) -> float:
    """Volume in mm³ of the block, which has 5 x 4 x 3 voxels of 1 x 2 x 3 mm."""
    path.write_bytes(content)
    return read_labels(path, {"block": [300]}, 1e-3).volume(1) * 1e9


MINS = {"axis_mins": "5 6 7"}
PACKED = zlib.compress(raw())
WHOLE: dict[str, tuple[str, Callable[[], bytes]]] = {
    "MetaImage": ("a.mha", lambda: metaimage(raw())),
    "big-endian": ("a.mha", lambda: metaimage(block().astype(">i2").tobytes("F"), BinaryDataByteOrderMSB="True")),
    "compressed": ("a.mha", lambda: metaimage(PACKED, CompressedData="True", CompressedDataSize=str(len(PACKED)))),
    "text": ("a.mha", lambda: metaimage(" ".join(map(str, block().ravel("F"))).encode(), BinaryData="False")),
    "packed": ("a.mha.gz", lambda: gzip.compress(metaimage(raw()))),
    "data at the end": ("a.mha", lambda: metaimage(b"12345" + raw(), HeaderSize="-1")),
    "NRRD": ("a.nrrd", lambda: nrrd(raw())),
    "NRRD gzip": ("a.nrrd", lambda: nrrd(gzip.compress(raw()), encoding="gzip")),
    "NRRD two streams": ("a.nrrd", lambda: nrrd(gzip.compress(raw()[:99]) + gzip.compress(raw()[99:]), encoding="gz")),
    "NRRD bzip2": ("a.nrrd", lambda: nrrd(bz2.compress(raw()), encoding="bzip2")),
    "NRRD hex": ("a.nrrd", lambda: nrrd(raw().hex().encode(), encoding="hex")),
    "NRRD text": ("a.nrrd", lambda: nrrd(" ".join(map(str, block().ravel("F"))).encode(), encoding="ascii", endian="")),
    "NRRD axes": (
        "a.nrrd",
        lambda: nrrd(raw(), space="", space_directions="", space_origin="", spacings="1 2 3", **MINS),
    ),
    "NRRD nodes": (
        "a.nrrd",
        lambda: nrrd(
            raw(), space="", space_directions="", space_origin="", spacings="1 2 3", centerings="node node cell", **MINS
        ),
    ),
    "NRRD LAS": ("a.nrrd", lambda: nrrd(raw(), space="LAS")),
    "NRRD LPS": ("a.nrrd", lambda: nrrd(raw(), space="left-posterior-superior")),
    "VTK": ("a.vti", vti),
    "NIfTI": ("a.nii", nifti),
}


@pytest.mark.usefixtures("forks")
@pytest.mark.parametrize("name", WHOLE)
def test_whole_images_are_read_as_by_an_independent_program(name: str, tmp_path: Path) -> None:
    """Voxels and their places agree with SimpleITK, which reads neither VTK nor some encodings of NRRD."""
    file, content = WHOLE[name]
    path = tmp_path / file
    assert read(path, content()) == pytest.approx(360, rel=1e-6)
    image = read_labels(path, {"block": [300]}, 1.0)
    assert np.array_equal(image.voxels == 1, block() == 300)
    if path.suffix == ".gz" or name in ("VTK", "NRRD hex", "NRRD bzip2", "NRRD two streams", "text"):
        return
    known = SimpleITK.ReadImage(str(path))
    assert np.array_equal(SimpleITK.GetArrayFromImage(known).transpose(), block())
    for index in ((0, 0, 0), (8, 7, 6), (3, 0, 5)):
        positions = image.positions(np.array([index]) * image.spacing)[0]
        assert positions == pytest.approx(known.TransformIndexToPhysicalPoint(index), abs=1e-6)


FAULTS: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "bit of a stream": (
        "a.mha",
        lambda: metaimage(PACKED[:20] + bytes([PACKED[20] ^ 4]) + PACKED[21:], CompressedData="True"),
        "its compressed voxels",
    ),
    "stream cut": (
        "a.mha",
        lambda: metaimage(PACKED[:-9], CompressedData="True"),
        "its compressed voxels end too early",
    ),
    "stream of more": (
        "a.nrrd",
        lambda: nrrd(gzip.compress(raw() + b"12"), encoding="gzip"),
        "more than the 1,008 bytes",
    ),
    "bomb": ("a.nrrd", lambda: nrrd(gzip.compress(bytes(4_000_000)), encoding="gzip"), "more than the 1,008 bytes"),
    "checksum": ("a.nrrd", lambda: nrrd(gzip.compress(raw())[:-8] + bytes(8), encoding="gzip"), "voxels are damaged"),
    "voxels missing": ("a.mha", lambda: metaimage(raw()[:-2]), "has 1,006 of 1,008 bytes: voxels are missing"),
    "too many": ("a.mha", lambda: metaimage(raw(), DimSize="9 8 6"), "has more than the 864 bytes"),
    "no spacing": ("a.mha", lambda: metaimage(raw(), ElementSpacing=""), "does not say 'ElementSpacing'"),
    "two spacings": (
        "a.mha",
        lambda: metaimage(b"", ElementDataFile="") + metaimage(raw(), ElementSpacing="1 1 1"),
        "two",
    ),
    "spacing 0": ("a.mha", lambda: metaimage(raw(), ElementSpacing="1 0 3"), "voxels of 1 x 0 x 3"),
    "long axes": ("a.mha", lambda: metaimage(raw(), TransformMatrix="2 0 0 0 2 0 0 0 2"), "lengths 2, 2, 2"),
    "many keys": (
        "a.mha",
        lambda: "".join(f"key{i} = {i}\n" for i in range(100_000)).encode() + metaimage(raw()),
        "lines",
    ),
    "huge": ("a.mha", lambda: metaimage(raw(), DimSize="99999 99999 99999"), "of memory"),
    "not finite": ("a.mha", lambda: metaimage(raw(), Offset="nan 0 0"), "'Offset' in its header is 'nan 0 0'"),
    "negative spacing": ("a.nrrd", lambda: nrrd(raw(), space_directions="", spacings="-1 1 1"), "voxels of -1 x 1 x 1"),
    "no spacing of NRRD": ("a.nrrd", lambda: nrrd(raw(), space_directions=""), "does not say 'spacings'"),
    "numbers missing": ("a.nrrd", lambda: nrrd(b"1 2 3", encoding="ascii"), "has 3 numbers, but its header says 504"),
    "long directions": ("a.vti", lambda: vti(direction="2 0 0 0 2 0 0 0 2"), "directions of lengths 2, 2, 2"),
    "spacing of VTK": ("a.vti", lambda: vti(spacing='Spacing="0 1 1"'), "voxels of 0 x 1 x 1"),
    "without spacing": ("a.vti", lambda: vti(spacing=""), "does not say 'Spacing'"),
    "part": ("a.vti", lambda: vti(piece="0 8 0 7 0 5"), "(do not fill the grid|the file says)"),
    "extent": ("a.vti", lambda: vti().replace(b"0 8 0 7", b"0 99999999 0 99999999"), "points in a file of"),
    "more numbers": (
        "a.vti",
        lambda: vti().replace(b" 300 ", b" 300 300 ", 1),
        "'l' has 505 numbers, but the file says 504",
    ),
    "numbers of VTK": ("a.vti", lambda: vti().replace(b" 300 ", b" ", 1), "cannot be read as an image"),
    "begins in the header": ("a.nii", lambda: nifti(("f", 108, (0,))), "begin at byte 0, which is in the header"),
    "elsewhere": ("a.nii", lambda: nifti(("B", 344, (110, 105, 49, 0))), "its voxels are in another file"),
    "type": ("a.nii", lambda: nifti(("h", 70, (2,))), "numbers of type 2 and 16 bits"),
    "fewer voxels": ("a.nii", lambda: nifti(("h", 42, (8,))), "has more than the 1,248 bytes"),
    "end": ("a.nii", lambda: nifti(cut=2), "the file ends after 1,358 of 1,360 bytes"),
    "two sizes": ("a.nii", lambda: nifti(("f", 80, (2,))), "two sizes of voxels, 2 x 2 x 3 and 1 x 2 x 3"),
    "end of gzip": ("a.nii.gz", lambda: gzip.compress(nifti())[:-4], "cannot be read as an image"),
    "huge NIfTI": ("a.nii", lambda: nifti(("h", 42, (32767,) * 3)), "of memory"),
    "empty": ("a.nii", lambda: b"", "its header is not one of NIfTI"),
}


@pytest.mark.usefixtures("forks")
@pytest.mark.parametrize("name", FAULTS)
def test_damaged_images_are_refused(name: str, tmp_path: Path) -> None:
    file, content, message = FAULTS[name]
    began = time.monotonic()
    with pytest.raises(MeshError, match=message) as refused:
        read(tmp_path / file, content())
    assert str(tmp_path / file) in str(refused.value)
    assert len(str(refused.value).splitlines()) <= 2
    assert time.monotonic() - began < 60


BALL = pyvista.Sphere(radius=10, theta_resolution=8, phi_resolution=6)


def saved(path: Path, *, binary: bool) -> bytes:
    ball = BALL.copy()
    ball.clear_data()
    ball.save(path, **({} if path.suffix == ".obj" else {"binary": binary}))
    return path.read_bytes()


@pytest.mark.everyday("stl-False", "ply-True", "ply-False", "obj-True", "vtp-False", "vtk-True", "vtk-False")
@pytest.mark.usefixtures("forks")
@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("ending", ["stl", "ply", "obj", "vtp", "vtk"])
def test_surfaces_are_whole_or_refused(ending: str, binary: bool, tmp_path: Path) -> None:
    path = tmp_path / f"ball.{ending}"
    content = saved(path, binary=binary)
    assert signed_volume(read_closed(path)) == pytest.approx(BALL.volume, rel=1e-5)
    for kept in (len(content) // 4, len(content) // 2 + 1, len(content) - 30):
        path.write_bytes(content[:kept])
        with pytest.raises(MeshError, match=f"ball.{ending}: "):
            read_closed(path)


SURFACES: dict[str, tuple[str, bool, Callable[[bytes], bytes], str]] = {
    "triangles": (
        "a.stl",
        True,
        lambda c: c[:80] + struct.pack("<I", 4_000_000_000) + c[84:],
        "its header says 4,000,000,000",
    ),
    "more bytes": ("a.stl", True, lambda c: c + b"1", "bytes, but its header says"),
    "vertex": ("a.stl", False, lambda c: c.replace(b"vertex", b"verteks", 1), "facets \\("),
    "points": (
        "a.ply",
        True,
        lambda c: c.replace(b"element vertex ", b"element vertex 4"),
        "its header says more than",
    ),
    "lines": ("a.ply", False, lambda c: c.replace(b"\n3 ", b"\n4 ", 1), "which is not one of 'face'"),
    "index": ("a.ply", False, lambda c: re.sub(rb"\n3 \d+", b"\n3 999", c, count=1), "points that do not exist"),
    "keyword": ("a.obj", False, lambda c: c.replace(b"\nv ", b"\nw ", 1), "begin with 'w'"),
    "coordinate": ("a.obj", False, lambda c: c.replace(b"\nv ", b"\nv x", 1), "are not three numbers"),
    "far": ("a.obj", False, lambda c: c.replace(b"\nv ", b"\nv 1e99 0 0\nv ", 1), "beyond 1e\\+60"),
    "huge": (
        "a.vtp",
        False,
        lambda c: c.replace(b'NumberOfPoints="', b'NumberOfPoints="4000000000'),
        "NumberOfPoints is",
    ),
    "block": ("a.vtk", True, lambda c: c[:200] + c[201:], "other numbers than its header says|cannot be read"),
}


@pytest.mark.usefixtures("forks")
@pytest.mark.parametrize("name", SURFACES)
def test_damaged_surfaces_are_refused(name: str, tmp_path: Path) -> None:
    file, binary, change, message = SURFACES[name]
    path = tmp_path / file
    path.write_bytes(change(saved(path, binary=binary)))
    with pytest.raises(MeshError, match=message) as refused:
        read_triangles(path)
    assert str(path) in str(refused.value)


def test_a_reader_that_never_ends_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By processor time, and on the clock where it waits."""
    path = tmp_path / "a.mha"
    path.write_bytes(metaimage(raw()))
    for code in ("while True: pass", "import time; time.sleep(600)"):
        program = tmp_path / "reader.py"
        limit = "import resource; resource.setrlimit(resource.RLIMIT_CPU, (1, 2))\n"
        program.write_text(limit + code)
        monkeypatch.setattr(reader_process, "_PROGRAM", program)
        monkeypatch.setattr(isolated, "_SECONDS", 1)
        monkeypatch.setattr(isolated, "_WAITING", 2)
        with pytest.raises(MeshError, match=r"a\.mha: cannot be read as an image: that takes too long"):
            read_labels(path, {"block": [300]}, 1e-3)


def job_with(path: Path, **mesh: object) -> dict[str, object]:
    return {
        "mesh": {"image": path.name, "labels": {"block": 300}, "size": "5 mm", **mesh},
        "material": {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.3},
        "supports": [{"region": "boundary", "fix": ["x", "y", "z"]}],
    }


REFERENCES: dict[str, tuple[str, bytes]] = {
    "leads out of the directory": ("a.mhd", metaimage(b"", ElementDataFile="../private.raw")),
    "link.raw.* leads out": ("a.mhd", metaimage(b"", ElementDataFile="link.raw")),
    "has its voxels in '/.*private.raw'": ("a.mha", metaimage(b"", ElementDataFile="{directory}/private.raw")),
    "has its voxels in '../private.raw'": ("a.nrrd", nrrd(b"", data_file="../private.raw")),
    "packed.* leads out": ("packed.mha.gz", gzip.compress(metaimage(b"", ElementDataFile="../private.raw"))),
    "by a pattern of names": ("a.mhd", metaimage(b"", ElementDataFile="slice%d.raw 1 7 1")),
    "is not a pattern of numbers": ("a.mhd", metaimage(b"", ElementDataFile="%s%n.raw 1 7 1")),
    "by a list of names": ("a.mhd", metaimage(b"slice1.raw\n", ElementDataFile="LIST")),
}


@pytest.mark.usefixtures("warm_reader")
@pytest.mark.parametrize("message", REFERENCES)
def test_untrusted_images_read_no_other_files(message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In jobs, as expected shapes, on axes of sweeps, and by each command that reads an image."""
    from hpcinv.__main__ import main

    name, content = REFERENCES[message]
    here = tmp_path / "download"
    here.mkdir()
    (tmp_path / "private.raw").write_bytes(raw())
    (here / "link.raw").symlink_to(tmp_path / "private.raw")
    path = here / name
    path.write_bytes(content.replace(b"{directory}", os.fsencode(tmp_path)))
    with pytest.raises(JobError, match=message) as refused:
        load(job_with(path), directory=here, untrusted=True)
    assert "refused with --untrusted" in str(refused.value)
    good = here / "good.mha"
    good.write_bytes(metaimage(raw()))
    load(job_with(good), directory=here, untrusted=True)
    expected = {"expected_shape": {"image": path.name}}
    with pytest.raises(JobError, match=message):
        load(job_with(good) | expected, directory=here, untrusted=True)
    import yaml

    (here / "job.yaml").write_text(yaml.safe_dump(job_with(good)))
    sweep = {"job": "job.yaml", "axes": [{"grid": {"mesh.image": [good.name, path.name]}}]}
    (here / "sweep.yaml").write_text(yaml.safe_dump(sweep))
    with pytest.raises(JobError, match=message):
        load_sweep(here / "sweep.yaml", untrusted=True)
    monkeypatch.setenv("HPCINV_UNTRUSTED", "1")  # as --untrusted of all commands sets it
    with pytest.raises(MeshError, match=message):
        read_labels(path, {"block": [300]}, 1e-3)
    monkeypatch.delenv("HPCINV_UNTRUSTED")
    for command in (
        ["mesh", "from-image", str(path), str(tmp_path / "b.msh"), "--label", "block=300", "--size", "5 mm"],
        ["new", "part", "--image", str(path), "--label", "block=300", str(tmp_path / "new.yaml")],
        ["compare", str(path), str(good)],
    ):
        assert main([*command, "--untrusted"]) == 2
    assert not (tmp_path / "b.msh").exists()
    assert not (tmp_path / "new.yaml").exists()


@pytest.mark.usefixtures("forks")
def test_files_that_a_header_names_are_checked_without_the_option_too(tmp_path: Path) -> None:
    (tmp_path / "whole.raw").write_bytes(raw())
    for i in range(1, 8):
        (tmp_path / f"slice{i}.raw").write_bytes(raw()[(i - 1) * 144 : i * 144])
    path = tmp_path / "a.mhd"
    names = "".join(f"slice{i}.raw\n" for i in range(1, 8)).encode()
    for data, more in (("whole.raw", b""), ("slice%d.raw 1 7 1", b""), ("slice%01d.raw", b""), ("LIST", names)):
        assert read(path, metaimage(more, ElementDataFile=data)) == pytest.approx(360)
    assert read(tmp_path / "a.nrrd", nrrd(b"", data_file="whole.raw")) == pytest.approx(360)
    os.mkfifo(tmp_path / "pipe.raw")
    (tmp_path / "short.raw").write_bytes(raw()[:-1])
    for data, message in (
        ("pipe.raw", "names the file '.*pipe.raw', which is not a regular file"),
        ("short.raw", "names the file '.*short.raw', which has 1,007 of 1,008 bytes"),
        ("missing.raw", "missing.raw', which cannot be read: No such file"),
        ("%s%n.raw 1 7 1", "is not a pattern of numbers"),
        ("slice%999999999d.raw 1 7 1", "is not a pattern of numbers"),
        ("slice%d.raw 1 999999999 1", "is not a pattern of numbers"),
    ):
        with pytest.raises(MeshError, match=message):
            read(path, metaimage(b"", ElementDataFile=data))


@pytest.mark.usefixtures("forks")
def test_pipes_are_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mha")
    with pytest.raises(MeshError, match=r"a\.mha: is not a regular file"):
        read_labels(tmp_path / "a.mha", {"block": [300]}, 1e-3)
    os.mkfifo(tmp_path / "a.stl")
    with pytest.raises(MeshError, match=r"a\.stl: is not a regular file"):
        read_triangles(tmp_path / "a.stl")


def test_a_reader_with_little_memory_leaves_no_partial_bytecode(tmp_path: Path) -> None:
    """Its limit on the size of files also holds for what Python writes when a module is imported."""
    program = Path(isolated_reader.__file__)
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(tmp_path / "bytecode")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    image = tmp_path / "a.nrrd"
    image.write_bytes(b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 9 9 9\nencoding: raw\n\n" + bytes(729))
    subprocess.run(
        [sys.executable, program, "image", image, "1000", "60"], env=environment, capture_output=True, check=True
    )
    assert not list((tmp_path / "bytecode").rglob("voxel_files*"))


def with_segments(content: bytes, *segments: tuple[str, str]) -> bytes:
    """An NRRD file with names and numbers of segments, as 3D Slicer adds them to the header."""
    lines = "".join(
        f"Segment{i}_Name:={name}\nSegment{i}_LabelValue:={number}\nSegment{i}_Layer:=0\n"
        for i, (name, number) in enumerate(segments)
    )
    head, voxels = content.split(b"\n\n", 1)
    return head + b"\n" + lines.encode() + b"\n" + voxels


@pytest.mark.usefixtures("forks")
def test_segments_of_slicer_are_named(tmp_path: Path) -> None:
    path = tmp_path / "scan.seg.nrrd"
    path.write_bytes(with_segments(nrrd(raw()), ("Left kidney", "300"), ("twice", "1"), ("twice", "2")))
    assert read_labels(path, {"kidney": ["Left kidney"]}, 1e-3).volume(1) == read_labels(
        path, {"kidney": [300]}, 1e-3
    ).volume(1)
    assert "300 'Left kidney'" in labels_in(path, 1e-3)
    for name in ("left kidney", "twice"):
        with pytest.raises(MeshError, match=f"has no segment '{name}'"):
            read_labels(path, {"kidney": [name]}, 1e-3)
    path.write_bytes(with_segments(nrrd(raw()), ("liver", "one")))
    with pytest.raises(MeshError, match=r"'.*Segment0_LabelValue' in its header is 'one', not 1 numbers"):
        read_labels(path, {"liver": ["liver"]}, 1e-3)
    overlapping = nrrd(raw(), dimension="4", sizes="2 9 8 7")
    path.write_bytes(with_segments(overlapping, ("liver", "1")))
    with pytest.raises(MeshError) as refused:
        read_labels(path, {"liver": ["liver"]}, 1e-3)
    assert "Segments overlap" in refused.value.advice
