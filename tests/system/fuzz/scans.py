"""Damaged images and surfaces: whatever comes, the answer is an error that names the file, or the body that it shows.

The reader's processes are forks of this one (`helpers.forked_reader`).
"""

from __future__ import annotations

import gzip
import random
import re
import shutil
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import pyvista
import SimpleITK
from helpers.forked_reader import load_libraries, run_forked
from mutations import mutated_bytes, mutated_header

from hpcinv.errors import HpcinvError, MeshError
from hpcinv.geometry.imaging.closed_surface import fill, read_closed, signed_volume
from hpcinv.geometry.imaging.label_image import read_labels
from hpcinv.mesh.io import isolated

CORPUS = Path(__file__).parent / "corpus"
SPACING = (1.0, 2.0, 1.5)
CHANGED = 16
"""voxels or nodes that one change may change: as many bits are flipped at most; of voxels of one bit 8 times as many"""


class Scans:
    """Whole files of images and surfaces; damaged copies of them are read."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.answers: Counter[str] = Counter()
        load_libraries()
        isolated.run_isolated = run_forked
        self.paths = [*images(directory), *surfaces(directory)]
        self.right = {path: reading(path) for path in self.paths}
        for path, (count, _) in self.right.items():
            assert count > 100, path

    def fault_of_next(self, source: random.Random) -> tuple[bytes, str] | None:
        """Damage one of the files and read it; its content and what is wrong with the answer, if something is."""
        original = source.choice(self.paths)
        place = self.directory / "mutants"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        path = Path(shutil.copy(original, place))
        victims = [path]
        for beside in original.parent.glob(f"{original.stem}.*raw"):
            victims.append(Path(shutil.copy(beside, place)))
        victim = source.choice(victims)
        content = damaged(source, victim)
        victim.write_bytes(content)
        if (fault := self.fault_of(original, path)) is None:
            return None
        return content, f"{original.name} ({victim.name}): {fault}"

    def fault_of(self, original: Path, path: Path) -> str | None:
        """What is wrong with the answer to a damaged file."""
        try:
            voxels = reading(path)
        except HpcinvError as error:
            self.answers["refused" if "crashed" not in str(error) else "refused after a crash"] += 1
            if "too long" in str(error):
                return f"takes too long: {error}"
            return None if path.name in str(error) and len(str(error)) < 1000 else f"does not name the file: {error}"
        except BaseException as error:
            return "".join(traceback.format_exception(error)[-4:])
        self.answers["read"] += 1
        return difference(self.right[original], voxels, path, original)


def reading(path: Path) -> tuple[int, Any]:
    """Voxels of the body and their size, or triangles and nodes of the surface."""
    if ".body" in path.suffixes:
        surface = read_closed(path)
        assert np.isfinite(signed_volume(surface))
        return surface.n_cells, {tuple(point) for point in np.asarray(surface.points, dtype=np.float32).tolist()}
    image = read_labels(path, {"body": [1]}, 1.0)
    return int(np.count_nonzero(image.voxels)), image.spacing


def difference(right: tuple[int, Any], voxels: tuple[int, Any], path: Path, original: Path) -> str | None:
    """What is wrong with a body, unless its file says so."""
    if isinstance(voxels[1], set):
        moved, count = len(voxels[1] - right[1]), voxels[0] - right[0]
        if not count and moved <= CHANGED:
            return None
        if path.suffix == ".obj" and vertex_lines(path) != vertex_lines(original):  # the format has no counts
            return None
        try:
            fill({"body": [path]}, 4.0, 1.0)
        except MeshError:  # such as indices that are off by one: the surface cuts itself
            return None
        return f"{moved} nodes were moved, and there are {count:+} triangles"
    if abs(voxels[0] - right[0]) > (8 * CHANGED if path.suffix == ".dcm" else CHANGED):
        return f"has {voxels[0]} voxels, which were {right[0]}"
    ratio = voxels[1] / right[1]
    if abs(ratio - ratio[0]).max() < 1e-6 and np.isclose(ratio[0], (1e-3, 1, 1e3)).any():  # of another unit
        return None
    if path.name.endswith((".nii", ".nii.gz")) and abs(ratio - 1).max() < 0.01:  # sform says the same but for rounding
        return None
    content = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    numbers = {abs(float(word)) for word in re.findall(rb"[-+]?[\d.]+(?:[eE][-+]?\d+)?", content) if is_number(word)}
    unsaid = [x for x in voxels[1] if not any(np.isclose(x, number, rtol=1e-6) for number in numbers)]
    return f"has voxels of {voxels[1]}, which its header does not say" if unsaid else None


def vertex_lines(path: Path) -> int:
    return path.read_bytes().count(b"v ")


def is_number(word: bytes) -> bool:
    try:
        return abs(float(word)) > 0
    except ValueError:
        return False


def damaged(source: random.Random, path: Path) -> bytes:
    """The content of a file after one change, mostly of its header; of a compressed one also within."""
    content = path.read_bytes()
    is_packed = path.suffix == ".gz" and source.random() < 0.5
    content = gzip.decompress(content) if is_packed else content
    is_text = path.suffix in (".mhd", ".obj") or b"ascii" in content[:300]
    if (source.random() < 0.6 and path.suffix != ".gz") or is_packed:
        content = mutated_header(source, content, 700)
    else:
        content = mutated_bytes(source, content, lines=is_text)
    return gzip.compress(content) if is_packed else content


def images(directory: Path) -> list[Path]:
    """An image of labels in every format, also compressed and in several files."""
    x, y, z = np.indices((14, 12, 11))
    labels = np.zeros(x.shape, dtype=np.int16)
    labels[(x - 6) ** 2 + (y - 6) ** 2 + (z - 5) ** 2 < 20] = 1
    labels[:2] = 2
    image = SimpleITK.GetImageFromArray(labels.transpose())
    image.SetSpacing(SPACING)
    image.SetOrigin((10, -20, 3))
    paths = []
    for name, packed in (
        *((f"plain{ending}", False) for ending in (".nii", ".mha", ".mhd", ".nrrd")),
        *((f"packed{ending}", True) for ending in (".nii.gz", ".mha", ".mhd", ".nrrd")),
    ):
        SimpleITK.WriteImage(image, str(directory / name), useCompression=packed)
        paths.append(directory / name)
    grid = pyvista.ImageData(dimensions=labels.shape, spacing=SPACING, origin=(10, -20, 3))
    grid.point_data["labels"] = labels.ravel(order="F")
    grid.save(directory / "binary.vti")
    grid.save(directory / "text.vti", binary=False)
    numbers = " ".join(map(str, labels.ravel(order="F")))
    head = "NRRD0004\ntype: short\ndimension: 3\nsizes: 14 12 11\nspacings: 1 2 1.5\nencoding: ascii\n\n"
    (directory / "text.nrrd").write_text(head + numbers)
    for name in ("plain.mha", "binary.vti"):
        (directory / f"{name}.gz").write_bytes(gzip.compress((directory / name).read_bytes()))
        paths.append(directory / f"{name}.gz")
    shutil.copy(CORPUS / "segmentation.dcm", directory)
    return [*paths, *(directory / name for name in ("binary.vti", "text.vti", "text.nrrd", "segmentation.dcm"))]


def surfaces(directory: Path) -> list[Path]:
    """A closed surface in every format, in text and in numbers."""
    ball = pyvista.Sphere(radius=10, theta_resolution=12, phi_resolution=10)
    ball.clear_data()
    names = [f"{kind}.body.{ending}" for kind in ("text", "binary") for ending in ("stl", "ply", "vtp", "vtk")]
    for name in names:
        ball.save(directory / name, binary=name.startswith("binary"))
    ball.save(directory / "text.body.obj")
    return [directory / name for name in (*names, "text.body.obj")]
