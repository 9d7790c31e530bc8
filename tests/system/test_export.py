"""``hpcinv export`` of a run on two ranks."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import pyvista
from helpers.command_line import BLOCK, hpcinv_here, write_job


def test_shape_of_a_run(tmp_path: Path) -> None:
    job = write_job(tmp_path / "block.yaml", BLOCK, job="block")
    ran = hpcinv_here("run", job, "--output", "run", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    exported = hpcinv_here("export", "run", "--to", "block.stl", "--unit", "m", "--mould", "mould.3mf", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    assert "the cavity is closed all around" in exported.stderr
    # Its cells are straight, and its displacement has degree 2.
    assert "shape.msh, .vtu: up to" in ran.stdout
    lines = json.loads((tmp_path / "run" / "summary.json").read_text())["certificate"]["lines"]
    assert any(line["name"].startswith("shape files") and "geometry_degree: 2" in line["note"] for line in lines)
    assert "shape.msh has fewer nodes than the computed body" in exported.stderr
    assert (tmp_path / "mould.3mf").is_file()
    surface, cells = pyvista.read(tmp_path / "block.stl"), pyvista.read(tmp_path / "run" / "shape.vtu")
    assert surface.is_manifold
    assert surface.volume == pytest.approx(cells.volume, rel=1e-5)
    # The block was given as a unit cube, and is larger without its weight.
    assert surface.volume > 1.0


@pytest.mark.release
def test_states_are_exported_by_name(tmp_path: Path) -> None:
    up, down = ([{"effect": "gravity", "acceleration": [0, 0, g], "density": 500}] for g in (1.0, -1.0))
    states = [{"name": "hung", "given": True, "effects": up}, {"name": "stood", "effects": down}]
    without = {name: value for name, value in BLOCK.items() if name not in ("effects", "analysis")}
    job = write_job(tmp_path / "block.yaml", without, job="block", states=states)
    ran = hpcinv_here("run", job, "--output", "run", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    heights = {}
    for shape in ("undeformed", "rest", "hung", "stood"):
        done = hpcinv_here("export", "run", "--shape", shape, "--to", f"{shape}.stl", "--unit", "m", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        heights[shape] = pyvista.read(tmp_path / f"{shape}.stl").bounds[5]
    assert heights["stood"] < heights["rest"] == heights["undeformed"] < heights["hung"]
    refused = hpcinv_here("export", "run", "--shape", "deformed", "--to", "block.stl", cwd=tmp_path)
    assert refused.returncode == 2
    assert "has no state 'deformed'; its states are hung, stood, rest" in refused.stderr


@pytest.mark.parallel([2])
def test_several_ranks_are_refused_once(run_directory: Path) -> None:
    refused = hpcinv_here("export", "run", "--to", "block.stl", cwd=run_directory)
    assert refused.returncode == 2
    assert refused.stderr.count("works on one process") == 1
