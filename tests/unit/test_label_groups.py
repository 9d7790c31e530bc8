"""Regions by the values of an integer array in the cells of a mesh file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.schemas import refusals

from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import Job, parse
from hpcinv.mesh import build_body
from hpcinv.mesh.io.vtu import read_vtu, save_vtu
from hpcinv.mesh.label_groups import integer_arrays
from hpcinv.mesh.source import DataArray, MeshSource
from hpcinv.parallel.runtime import MPI

MATERIAL = {"law": "neo-hookean", "young": "1 kPa", "poisson": 0.3}


def bar(material: np.ndarray) -> MeshSource:
    """Cubes in a row."""
    count = len(material)
    points = np.array([[i, j, k] for i in range(count + 1) for j in (0.0, 1.0) for k in (0.0, 1.0)])
    cells = 4 * np.arange(count)[:, None] + np.array([0, 4, 2, 6, 1, 5, 3, 7])
    arrays = [DataArray("material", "cells", material[:, None]), DataArray("wall", "nodes", points[:, :1])]
    return MeshSource(
        path=Path("bar.vtu"),
        kind="hexahedron",
        degree=1,
        points=points,
        node_tags=np.arange(1, len(points) + 1),
        cells=cells,
        cell_tags=np.arange(1, count + 1),
        facets=np.zeros((0, 4), dtype=np.int64),
        data={array.name: array for array in arrays},
    )


def job(directory: Path, labels: dict[str, Any], **changes: Any) -> Job:
    sections = {
        "mesh": {"file": "bar.vtu", "labels": labels},
        "material": MATERIAL,
        "supports": [{"region": "boundary", "fix": ["x", "y", "z"]}],
    }
    return parse(sections | changes, directory / "job.yaml")


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    path = tmp_path / "bar.vtu"
    source = bar(np.array([1, 1, 2, 7, 7, 7]))
    save_vtu(path, source, source.points)
    assert read_vtu(path).data.keys() == {"material", "wall"}
    return tmp_path


def counts(given: Job) -> dict[str, int]:
    body = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve)
    return {name: region.cell_count for name, region in body.regions.items() if region.cell_count}


def test_values_of_an_array_are_regions(directory: Path) -> None:
    assert counts(job(directory, {"array": "material"})) == {"material-1": 2, "material-2": 1, "material-7": 3}
    names = {"plaque": 2, "wall": [1, 7]}
    by_name = job(directory, {"array": "material", "names": names}, material={"plaque": MATERIAL, "wall": MATERIAL})
    assert counts(by_name) == {"plaque": 1, "wall": 5}
    union = job(directory, {"array": "material"}, regions={"soft": ["material-1", "material-2"]})
    assert counts(union) == {"material-1": 2, "material-2": 1, "material-7": 3, "soft": 3}
    assert not refusals(by_name.data)


@pytest.mark.parametrize(
    ("labels", "message", "advice"),
    [
        ({"array": "materal"}, "has no array 'materal'. Did you mean 'material'", "material (1, 2, 7)"),
        ({"array": "wall"}, "the array 'wall' does not have integers in the cells", "material (1, 2, 7)"),
        ({"array": "material", "names": {"plaque": 3}}, "no cell has the value 3", "Its values are 1, 2, 7."),
    ],
)
def test_what_is_not_there_is_listed(labels: dict[str, Any], message: str, advice: str, directory: Path) -> None:
    with pytest.raises(MeshError) as refused:
        counts(job(directory, labels))
    assert message in refused.value.message
    assert advice in refused.value.advice


def test_unknown_regions_list_the_arrays(directory: Path) -> None:
    given = job(directory, {"array": "material"}, regions={"soft": ["material-3"]})
    with pytest.raises(MeshError) as refused:
        counts(given)
    assert "no region 'material-3'" in refused.value.message
    assert "Arrays of integers can be regions (mesh.labels: {array: …}): material (1, 2, 7)" in refused.value.advice


def test_labels_of_arrays_are_for_meshes_and_numbers(directory: Path) -> None:
    for labels, message in (
        ({"array": "material", "names": {"plaque": "two"}}, "must be numbers, not 'two'"),
        ({"array": "material", "names": {"a": 1, "b": [2, 1]}}, "has the number 1, which 'a' has too"),
        ({"array": "material", "names": {"boundary": 1}}, "is the name of another region"),
        ({"array": "material", "name": {"a": 1}}, "unknown key"),
    ):
        with pytest.raises(JobError, match=message):
            job(directory, labels)


def test_arrays_of_other_numbers_are_not_labels() -> None:
    assert list(integer_arrays(bar(np.array([0.5, 1.0])))) == []
    assert list(integer_arrays(bar(np.arange(20.0)))) == ["material (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, …)"]
