"""Result files of a run in ParaView, and the state that ``hpcinv export --to NAME.py`` writes for it."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.command_line import BLOCK, hpcinv_here, write_job
from helpers.display import display
from PIL import Image

from hpcinv.geometry.workshop.paraview_state import VIEWS

PROGRAMS = ("Xvfb", "pvpython")
needs_paraview = pytest.mark.skipif(
    not all(map(shutil.which, PROGRAMS)), reason="ParaView is not installed (Debian: python3-paraview, xvfb)"
)
STATES: dict[str, Any] = {
    "states": [
        {"name": "stood", "given": True, "effects": BLOCK["effects"]},
        {"name": "hung", "effects": [BLOCK["effects"][0] | {"acceleration": [0, 0, 9.81]}]},
    ],
}

OPENED = """
import json, sys
from paraview import simple, vtk
from paraview.servermanager import Fetch

found = {}
for body in ("undeformed", "deformed"):
    reader = simple.PVDReader(FileName=f"run/fields/{body}.pvd")
    arrays, units = {}, {}
    for time in reader.TimestepValues:
        reader.UpdatePipeline(time)
    grid = Fetch(reader)
    for data in (grid.GetPointData(), grid.GetCellData()):
        for i in range(data.GetNumberOfArrays()):
            array = data.GetArray(i)
            arrays[array.GetName()] = [list(array.GetRange(k)) for k in range(array.GetNumberOfComponents())]
            information = array.GetInformation()
            if information.Has(vtk.vtkDataArray.UNITS_LABEL()):
                units[array.GetName()] = information.Get(vtk.vtkDataArray.UNITS_LABEL())
    found[body] = {"times": list(reader.TimestepValues), "bounds": grid.GetBounds(), "arrays": arrays, "units": units}
json.dump(found, open("found.json", "w"))
"""

DRAWN = """
from paraview import simple

with open("view.py") as script:
    exec(compile(script.read(), "view.py", "exec"))
simple.SaveScreenshot("drawn.png", simple.GetLayout(views[0]), ImageResolution=[600, 300])
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory in which ``run`` has finished, with the state next to it."""
    directory = tmp_path_factory.mktemp("paraview")
    without = {name: value for name, value in BLOCK.items() if name not in ("effects", "analysis")}
    job = write_job(directory / "block.yaml", without, **STATES)
    ran = hpcinv_here("run", job, "--output", "run", cwd=directory)
    assert ran.returncode == 0, ran.stderr
    exported = hpcinv_here("export", "run", "--to", "view.py", cwd=directory)
    assert exported.returncode == 0, exported.stderr
    assert "by displacement and von_mises" in exported.stdout
    return directory


def pvpython(script: str, directory: Path) -> None:
    (directory / "typed.py").write_text(script)
    with display() as environment:  # Debian's ParaView draws in windows only
        command = ["pvpython", "typed.py"]
        done = subprocess.run(
            command, cwd=directory, env=environment, capture_output=True, text=True, timeout=120, check=False
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr, done.stderr


def test_the_state_names_arrays_and_files_of_the_run(run: Path) -> None:
    """What ParaView does in the release test."""
    text = (run / "view.py").read_text()
    compile(text, "view.py", "exec")
    assert f"FIELDS = {str((run / 'run' / 'fields').resolve())!r}" in text
    for body in ("undeformed", "deformed"):
        grid = pyvista.read(run / "run" / "fields" / f"{body}.pvd")[0]
        for association, array, _, unit in VIEWS:
            held = (grid.GetPointData() if association == "POINTS" else grid.GetCellData()).GetArray(array)
            assert held is not None
            information = held.GetInformation()
            assert information.Get(type(held).UNITS_LABEL()) == unit


def test_a_run_without_fields_has_no_state(run: Path) -> None:
    job = write_job(run / "bare.yaml", BLOCK, output={"fields": False})
    assert hpcinv_here("run", job, "--output", "bare", cwd=run).returncode == 0
    refused = hpcinv_here("export", "bare", "--to", "bare.py", cwd=run)
    assert refused.returncode == 2
    assert "bare: has no fields/undeformed.pvd, which ParaView opens" in refused.stderr
    assert not (run / "bare.py").exists()


@pytest.mark.release
@needs_paraview
def test_paraview_opens_both_bodies_with_units_regions_and_states(run: Path) -> None:
    pvpython(OPENED, run)
    found = json.loads((run / "found.json").read_text())
    for body in ("undeformed", "deformed"):
        opened = found[body]
        grid = pyvista.read(run / "run" / "fields" / f"{body}-hung.vtu")
        assert opened["times"] == [0.0, 1.0]
        assert opened["bounds"] == pytest.approx(grid.bounds, abs=1e-6)
        assert {"displacement", "J", "von_mises", "cauchy_stress", "node_tag"} <= opened["arrays"].keys()
        assert opened["units"]["displacement"] == "m"
        assert opened["units"]["von_mises"] == opened["units"]["cauchy_stress"] == "Pa"
        assert opened["arrays"]["region:block"] == [[1, 1]]
    heights = [found[body]["bounds"][5] for body in ("undeformed", "deformed")]
    assert abs(heights[0] - heights[1]) > 0.01


@pytest.mark.release
@needs_paraview
def test_paraview_draws_the_state_in_colours(run: Path) -> None:
    pvpython(DRAWN, run)
    picture = np.asarray(Image.open(run / "drawn.png").convert("RGB")).astype(int)
    assert picture.shape == (300, 600, 3)
    for view in (picture[:, :300], picture[:, 300:]):
        coloured = np.ptp(view, axis=2) > 60
        assert 0.02 < coloured.mean() < 0.9  # a body on a white background
        assert len(np.unique(view[coloured] // 32, axis=0)) > 5
