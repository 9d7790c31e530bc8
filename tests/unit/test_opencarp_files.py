"""Files of openCARP, read back as its manual describes them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcinv.errors import OutputError
from hpcinv.geometry.workshop.opencarp import directions_of, write_opencarp
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.body import read_source
from hpcinv.mesh.source import DataArray, Floats, Group, MeshSource

MESHES = Path(__file__).parents[2] / "meshes"


def block(**more: Any) -> MeshSource:
    data = {"file": "box.py", "parameters": {"lx": 0.03, "ly": 0.02, "lz": 0.01, "nx": 3, "ny": 2, "nz": 1, **more}}
    return read_source(MeshSpec.model_validate(data, context={"directory": MESHES}), MESHES / "box.py")


def table(path: Path, skipped: int = 0) -> Floats:
    """The numbers below the first line, whose number of lines is checked."""
    head, *lines = path.read_text().splitlines()
    if path.suffix != ".lon":
        assert int(head) == len(lines)
    return np.array([line.split()[skipped:] for line in lines], dtype=float)


def with_fibres(source: MeshSource) -> MeshSource:
    """Fibres of nodes that turn along x, in part with the other sign, a sheet direction of cells, and a temperature."""
    angle = 20 * source.points[:, 0]
    fibres = (
        np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) * np.where(np.arange(len(angle)) % 2, 1, -1)[:, None]
    )
    sheets = np.tile([0.0, 0.0, 1.0], (len(source.cells), 1))
    arrays = [DataArray("sheet", "cells", sheets), DataArray("fibre", "nodes", fibres)]
    arrays.append(DataArray("warmth", "nodes", source.points[:, :1]))
    halves = np.array_split(np.arange(len(source.cells)), 2)
    groups = tuple(
        Group(name, 3, i, members) for i, (name, members) in enumerate(zip(("lv", "rv"), halves, strict=True), 1)
    )
    return replace(source, groups=groups, data={array.name: array for array in arrays})


def test_files_hold_points_cells_regions_and_fibres(tmp_path: Path) -> None:
    source = with_fibres(block())
    done = write_opencarp(tmp_path / "heart.pts", source, None, 2.0)
    points, elements, axes = (
        table(tmp_path / f"heart{suffix}", skipped) for suffix, skipped in ((".pts", 0), (".elem", 1), (".lon", 0))
    )
    assert (tmp_path / "heart.elem").read_text().count("Tt ") == len(source.cells)
    assert np.ptp(points, axis=0) == pytest.approx([60e3, 40e3, 20e3])  # µm
    corners = points[elements[:, :4].astype(int)]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(8 * 6e-6 * 1e18)
    assert done.volume == pytest.approx(8 * 6e-6)
    assert done.regions == {1: "lv", 2: "rv"}
    assert list(elements[:, 4]) == [1] * (len(elements) // 2) + [2] * (len(elements) - len(elements) // 2)
    assert (tmp_path / "heart.lon").read_text().startswith("2\n")
    assert done.directions == ("fibre", "sheet")
    assert np.linalg.norm(axes[:, :3], axis=1) == pytest.approx(1.0)
    assert axes[:, 3:] == pytest.approx(np.tile([0, 0, 1], (len(axes), 1)))
    middle = 20 * corners.mean(axis=1)[:, 0] / 2e6
    along = np.cos(middle) * axes[:, 0] + np.sin(middle) * axes[:, 1]
    assert np.abs(along) == pytest.approx(1.0, abs=0.01)


def test_a_part_has_only_its_points(tmp_path: Path) -> None:
    source = with_fibres(block())
    done = write_opencarp(tmp_path / "a.pts", source, source.groups[1].members, 1.0)
    assert done.cells == len(source.groups[1].members)
    nodes = table(tmp_path / "a.elem", 1)[:, :4]
    assert nodes.max() + 1 == len(np.unique(nodes)) == len(table(tmp_path / "a.pts"))
    assert done.regions == {2: "rv"}


def test_curved_cells_become_straight_without_fibres(tmp_path: Path) -> None:
    straight = block()
    done = write_opencarp(tmp_path / "a.pts", replace(straight, data={}), None, 1.0)
    assert done.directions == ()
    assert table(tmp_path / "a.lon")[0].tolist() == [1, 0, 0]
    data = {"file": "box.py", "parameters": {"lx": 0.03, "ly": 0.02, "lz": 0.01, "nx": 3, "ny": 2, "nz": 1}}
    spec = MeshSpec.model_validate(data | {"geometry_degree": 2}, context={"directory": MESHES})
    curved = write_opencarp(tmp_path / "b.pts", read_source(spec, MESHES / "box.py"), None, 1.0)
    assert curved.volume == pytest.approx(done.volume)
    assert len(table(tmp_path / "b.pts")) == len(table(tmp_path / "a.pts"))


def test_displacements_are_not_directions() -> None:
    source = block()
    longer = DataArray("u", "nodes", 1.1 * np.tile([1.0, 0, 0], (len(source.points), 1)))
    assert directions_of(replace(source, data={"u": longer})) == []


def test_hexahedra_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="these cells are hexahedra"):
        write_opencarp(tmp_path / "a.pts", block(hexahedra=True), None, 1.0)
    assert not list(tmp_path.iterdir())
