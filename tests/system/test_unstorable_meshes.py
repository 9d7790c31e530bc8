"""A solved state is not lost for what a format of its files cannot store."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK, write_job

from hpcinv.__main__ import main
from hpcinv.mesh import mesh_files as export
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.io.vtu import read_vtu, save_vtu
from hpcinv.mesh.readers import read_msh
from hpcinv.mesh.source import MeshSource


def two_regions(path: Path) -> MeshSource:
    """Two bricks, each in a region whose array has 1 there and 0 elsewhere."""
    import pyvista

    grid = pyvista.ImageData(dimensions=(3, 2, 2), spacing=(0.1, 0.1, 0.1)).cast_to_unstructured_grid()
    nodes = np.array([[0, 1, 4, 3, 6, 7, 10, 9], [1, 2, 5, 4, 7, 8, 11, 10]])
    bricks = pyvista.UnstructuredGrid({pyvista.CellType.HEXAHEDRON: nodes}, np.array(grid.points, dtype=float))
    bricks.cell_data["region:A"] = np.array([1, 0], np.int8)
    bricks.cell_data["region:B"] = np.array([0, 1], np.int8)
    bricks.save(path)
    return read_vtu(path)


@pytest.mark.release
@pytest.mark.parametrize("names", [("A", "B"), ('the "left"', "two\nlines")])
def test_regions_that_are_marked_by_1_are_kept_in_all_formats(names: tuple[str, str], tmp_path: Path) -> None:
    source = two_regions(tmp_path / "two.vtu")
    groups = tuple(
        type(group)(name, group.dim, group.tag, group.members) for group, name in zip(source.groups, names, strict=True)
    )
    source = type(source)(**{**vars(source), "groups": groups})
    save_msh(tmp_path / "two.msh", source, source.points)
    save_vtu(tmp_path / "again.vtu", source, source.points)
    for mesh_read in (read_msh(tmp_path / "two.msh"), read_vtu(tmp_path / "again.vtu")):
        assert [list(group.members) for group in mesh_read.groups] == [[0], [1]]
        assert len({group.tag for group in mesh_read.groups}) == 2


@pytest.mark.release
def test_tags_that_gmsh_refuses_are_numbered_again(tmp_path: Path) -> None:
    source = two_regions(tmp_path / "two.vtu")
    source = type(source)(**{**vars(source), "node_tags": np.zeros(12, dtype=np.int64)})
    save_msh(tmp_path / "two.msh", source, source.points)
    assert len(read_msh(tmp_path / "two.msh").points) == 12


def test_a_solved_state_is_kept_without_a_file_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: Any) -> None:
        raise RuntimeError("Physical volume 1 already exists")

    savers: dict[str, Any] = {".msh": refuse, ".vtu": export.SAVERS[".vtu"]}
    monkeypatch.setattr(export, "SAVERS", savers)
    monkeypatch.chdir(tmp_path)
    job = write_job(tmp_path / "block.yaml", BLOCK)
    assert main(["run", str(job)]) == 2
    (directory,) = (tmp_path / "results").iterdir()
    summary = json.loads((directory / "summary.json").read_text())
    assert summary["status"] == "converged"
    (said,) = summary["unwritten"]
    assert "shape.msh: cannot be written: Physical volume 1 already exists" in said
    assert {path.name for path in directory.glob("shape*")} == {"shape.vtu"}
    assert "shape.msh: cannot be written" in capsys.readouterr().out
