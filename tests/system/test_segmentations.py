"""Real segmentations from end to end on 2 ranks: mesh, regions, inverse analysis, certificate.

They are test data of TotalSegmentator (Apache-2.0), in its source distribution, which is downloaded.
"""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.command_line import hpcinv_here

SimpleITK = pytest.importorskip("SimpleITK")

URL = (
    "https://files.pythonhosted.org/packages/c3/53/7d654d2ec3fcb801ae54d318b0ffc18021aed528bf4e4df0753caf0c8a73/"
    "totalsegmentator-2.18.0.tar.gz"
)
SHA256 = "5d4223ef93973bc36d710869d11e7742ead2c154c72f7f9edcaaadd5b6c4bd03"
FILES = {
    "abdomen": "example_seg.nii.gz",
    "heart": "pulmonary_report/models/heart.nii.gz",
    "lumina": "aorta_report/test_result/models/T716_aorta_true_false_lumen.nii.gz",
}
TRUE, FALSE, WALL = 1, 2, 3
WEIGHT = {"effect": "gravity", "acceleration": [0, 9.81, 0], "density": 1060, "density_in": "current"}
JOBS: Mapping[str, Mapping[str, Any]] = {
    "liver": {
        "mesh": {"image": "abdomen.nii.gz", "labels": {"liver": 5}, "size": "12 mm"},
        "regions": {"back": "ny > cos(40 deg)"},
        "material": {"law": "neo-hookean", "young": "5 kPa", "poisson": 0.45},
        "effects": [WEIGHT],
        "supports": [{"region": region, "fix": ["x", "y", "z"]} for region in ("cut", "back")],
    },
    "heart": {
        "mesh": {"image": "heart.nii.gz", "labels": {"heart": 1}, "size": "12 mm"},
        "regions": {"base": "nz > cos(45 deg)"},
        "material": {"law": "neo-hookean", "young": "30 kPa", "poisson": 0.45},
        "effects": [WEIGHT],
        "supports": [{"region": "base", "fix": ["x", "y", "z"]}],
    },
    "aorta": {
        "mesh": {
            "image": "wall.nii.gz",
            "labels": {"wall": WALL},
            "neighbours": {"true": TRUE, "false": FALSE},
            "size": "6 mm",
        },
        "material": {"law": "fung-demiray", "mu": "100 kPa", "b": 2, "kappa": "5 MPa"},
        "effects": [
            {"effect": "pressure", "region": "wall|true", "pressure": "100 mmHg"},
            {"effect": "pressure", "region": "wall|false", "pressure": "90 mmHg"},
        ],
        "supports": [{"region": "cut", "fix": ["x", "y", "z"]}],
    },
}


def write_wall(lumina: Path, path: Path) -> None:
    """Write a wall of two voxels around the lower part of both lumina, and a septum as thick between them.

    The image has the blood only, since a scan does not show the wall.
    """
    image = SimpleITK.ReadImage(str(lumina))[:, :, :50]
    lumen = image > 0
    septum = SimpleITK.And(*(SimpleITK.BinaryDilate(image == label, [1] * 3) for label in (TRUE, FALSE)))
    blood = SimpleITK.And(lumen, SimpleITK.Not(septum))
    wall = SimpleITK.And(SimpleITK.BinaryDilate(lumen, [2] * 3), SimpleITK.Not(blood))
    SimpleITK.WriteImage(SimpleITK.Mask(image, blood) + WALL * SimpleITK.Cast(wall, image.GetPixelID()), str(path))


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of the images; the tests are skipped without a network."""
    try:
        with urllib.request.urlopen(URL, timeout=60) as answer:
            packed = answer.read()
    except OSError as error:
        pytest.skip(f"the source distribution of TotalSegmentator cannot be downloaded: {error}")
    assert hashlib.sha256(packed).hexdigest() == SHA256
    directory = tmp_path_factory.mktemp("images")
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for name, path in FILES.items():
            member = archive.extractfile(f"totalsegmentator-2.18.0/tests/reference_files/{path}")
            assert member is not None
            (directory / f"{name}.nii.gz").write_bytes(member.read())
    write_wall(directory / "lumina.nii.gz", directory / "wall.nii.gz")
    return directory


@pytest.mark.release
@pytest.mark.parametrize("name", JOBS)
def test_from_a_segmentation_to_the_unloaded_shape(name: str, images: Path) -> None:
    (images / f"{name}.yaml").write_text(yaml.safe_dump(dict(JOBS[name])))
    done = hpcinv_here("run", f"{name}.yaml", cwd=images)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((images / "results" / name / "summary.json").read_text())
    assert summary["status"] == "converged"
    verdicts = {line["name"]: line["verdict"] for line in summary["certificate"]["lines"]}
    assert summary["certificate"]["verdict"] != "fail"
    assert verdicts["boundary facets that cross each other"] == "pass"
