"""Fingerprints of jobs: equal for the same physics, other for other physics and files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.job_cases import GENERATOR, Loader

from hpcinv.job.fingerprint import difference, fingerprint
from hpcinv.job.resolved_job import file_digest

# fingerprints


def test_the_fingerprint_ignores_how_the_same_physics_is_written_and_solved(load: Loader, tmp_path: Path) -> None:
    def edit(job: dict[str, Any]) -> None:
        job["material"]["c1"] = "101.709668 kPa"
        job["mesh"].update(partition="scotch", file="../meshes/moved.py")
        job["discretisation"] = {"formulation": "mixed", "pressure": 1}
        job["solver"] = {"strategy": "fixed"}
        job["output"] = {"fields": False}

    (tmp_path / "meshes" / "moved.py").write_text(GENERATOR)
    assert difference(fingerprint(load()), fingerprint(load(edit))) == []


def test_the_fingerprint_is_json_and_differs_for_other_physics(load: Loader) -> None:
    def edit(job: dict[str, Any]) -> None:
        job["material"].update(c1=99999, d1="incompressible")
        job["effects"][0]["density_in"] = "reference"
        job["supports"].append({"region": "tip", "fix": ["x"]})

    old, new = fingerprint(load()), fingerprint(load(edit))
    assert difference(json.loads(json.dumps(old)), new) == [
        "material.c1: 101709.668 -> 99999.0",
        "material.d1: 796527268.9 -> incompressible",
        "effects[0].density_in: current -> reference",
        "supports[1].region: absent -> tip",
        "supports[1].fix[0]: absent -> x",
    ]


def test_the_fingerprint_follows_the_contents_of_the_mesh_file(load: Loader, tmp_path: Path) -> None:
    old = fingerprint(load())
    (tmp_path / "meshes" / "beam.py").write_text(GENERATOR + "\n# changed\n")
    [line] = difference(old, fingerprint(load()))
    assert line.startswith("mesh.file: ")


def test_the_fingerprint_of_an_xdmf_mesh_covers_its_hdf5_file(load: Loader, tmp_path: Path) -> None:
    (tmp_path / "meshes" / "m.xdmf").write_text('<DataItem Format="HDF">m.h5:/Mesh/topology</DataItem>')
    (tmp_path / "meshes" / "m.h5").write_bytes(b"one")
    old = fingerprint(load(lambda j: j.update(mesh={"file": "../meshes/m.xdmf"})))
    (tmp_path / "meshes" / "m.h5").write_bytes(b"two")
    assert old != fingerprint(load(lambda j: j.update(mesh={"file": "../meshes/m.xdmf"})))


@pytest.mark.parametrize(
    ("header", "voxels"),
    [
        ("a.mhd: ElementDataFile = a.raw", "a.raw"),
        ("a.mhd: ElementDataFile = LIST\na1.raw\na2.raw", "a2.raw"),
        ("a.mhd: ElementDataFile = a%02d.raw 1 9 1", "a07.raw"),
        ("a.nrrd: data file: a.bin", "a.bin"),
        ("a.nrrd: datafile: LIST\na.bin\nb.bin", "b.bin"),
    ],
)
def test_the_identity_of_an_image_has_the_files_of_its_voxels(header: str, voxels: str, tmp_path: Path) -> None:
    name, _, text = header.partition(": ")
    (tmp_path / name).write_text(f"NDims = 3\n{text}\n")
    digests = set()
    for content in ("yesterday", "today"):
        (tmp_path / voxels).write_text(content)
        digests.add(file_digest(tmp_path / name))
    assert len(digests) == 2
