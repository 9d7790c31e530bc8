"""Decks that FreeCAD writes, and what it opens of the rest shape: meshes and solids."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.command_line import NO_CERTIFICATE, ROOT, hpcinv_here
from helpers.freecad_deck import LOAD, deck
from helpers.typed import files

from hpcinv.studies.second_opinion.calculix import command, displacements

PAGE = ROOT / "docs" / "how-to" / "freecad.md"
needs_freecad = pytest.mark.skipif(
    shutil.which("freecadcmd") is None, reason="FreeCAD is not installed (Debian: freecad, freecad-python3, gmsh)"
)

OPENED = """
import json, sys
import FreeCAD, Part
from feminout import importInpMesh
from pathlib import Path

found = {}
for path in sorted(Path.cwd().glob("*.inp")):
    document = FreeCAD.newDocument(path.stem)
    importInpMesh.insert(str(path), path.stem)
    (mesh,) = (item.FemMesh for item in document.Objects)
    nodes = {tag: list(place) for tag, place in mesh.Nodes.items()}
    found[path.name] = {"volume": mesh.Volume.Value, "cells": mesh.TetraCount, "nodes": nodes}
for path in sorted(Path.cwd().glob("*.step")):
    shape = Part.read(str(path))
    found[path.name] = {
        "volume": shape.Volume, "solids": len(shape.Solids), "valid": shape.isValid(), "faces": len(shape.Faces)
    }
Path("found.json").write_text(json.dumps(found))
"""


def freecad(script: Path) -> None:
    done = subprocess.run(
        ["freecadcmd", script.name],
        cwd=script.parent,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr + done.stdout, done.stdout + done.stderr


def opened(directory: Path) -> dict[str, Any]:
    """Return what FreeCAD finds in the decks and solids of a directory."""
    (directory / "open.py").write_text(OPENED)
    freecad(directory / "open.py")
    return dict(json.loads((directory / "found.json").read_text()))


def typed(directory: Path, *lines: str) -> str:
    """Type commands that must succeed; return what they print."""
    printed = ""
    for line in lines:
        ended = hpcinv_here(*line.split(), cwd=directory)
        assert ended.returncode == 0, f"{line}\n{ended.stdout}\n{ended.stderr}"
        printed += ended.stdout
    return printed


def inverse(directory: Path, **changes: Any) -> None:
    job = directory / "part.yaml"
    content = yaml.safe_load(job.read_text()) | {"analysis": "inverse", "certificate": NO_CERTIFICATE} | changes
    job.write_text(yaml.safe_dump(content))


def check_job(directory: Path, force: float) -> None:
    """Check the job of a deck: supports, loads and law, with nothing left out.

    Args:
        force: along z on the loaded end, in MPa.
    """
    text = (directory / "part.yaml").read_text()
    assert "Not taken" not in text
    assert "CalculiX with NLGEOM takes 'law: st-venant-kirchhoff' there" in text
    content = yaml.safe_load(text)
    assert content["material"] == {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.4}
    assert content["supports"] == [{"region": "Fixed", "fix": ["x", "y", "z"]}]
    weight, pressure, traction = content["effects"]
    assert weight["density"] == "1000 kg/m^3"
    assert pressure == {"effect": "pressure", "region": "pressed", "pressure": "0.002 MPa"}
    assert (traction["effect"], traction["region"]) == ("traction", "loaded")
    assert float(traction["traction"][2].split()[0]) == pytest.approx(force, rel=1e-6)


def test_a_deck_in_the_layout_of_freecad_becomes_a_job_and_its_copy_a_rest_shape(tmp_path: Path) -> None:
    (tmp_path / "Mesh.inp").write_text(deck())
    typed(tmp_path, "new job --from Mesh.inp --unit mm --stress-unit MPa part.yaml")
    check_job(tmp_path, 9 * float(LOAD) / 100)
    inverse(tmp_path, output={"mesh": ["msh"], "fields": False})
    typed(tmp_path, "run part.yaml --quiet", "export results/part --to rest.inp --copy-of Mesh.inp")
    old, new = ((tmp_path / name).read_text().splitlines() for name in ("Mesh.inp", "rest.inp"))
    changed = [number for number, lines in enumerate(zip(old, new, strict=True)) if lines[0] != lines[1]]
    first, last = old.index("*Node, NSET=Nall"), old.index("** Volume elements")
    assert changed
    assert first < min(changed)
    assert max(changed) < last


@pytest.mark.release
@needs_freecad
def test_a_deck_of_freecad_comes_back_as_the_rest_shape(tmp_path: Path) -> None:
    """CalculiX loads the copy into the body that FreeCAD drew, by the law that it takes there."""
    (tmp_path / "part.py").write_text(files(PAGE)["part_in_freecad.py"])
    freecad(tmp_path / "part.py")
    typed(tmp_path, "new job --from Mesh.inp --unit mm --stress-unit MPa part.yaml")
    check_job(tmp_path, 0.05 / 100)
    law = {"law": "st-venant-kirchhoff", "young": "1 MPa", "poisson": 0.4}
    inverse(tmp_path, material=law, discretisation={"displacement": 2, "formulation": "displacement"})
    typed(tmp_path, "run part.yaml --quiet", "export results/part --to rest.inp --copy-of Mesh.inp")
    printed = typed(tmp_path, "export results/part --to rest.step --unit mm")
    assert "ratio 1.0000" in printed
    found = opened(tmp_path)
    tags = np.array(sorted(map(int, found["Mesh.inp"]["nodes"])))
    drawn, rest = (np.array([found[name]["nodes"][str(tag)] for tag in tags]) for name in ("Mesh.inp", "rest.inp"))
    assert found["rest.inp"]["cells"] == found["Mesh.inp"]["cells"] > 50
    assert found["Mesh.inp"]["volume"] == pytest.approx(4000.0, rel=1e-9)
    assert found["rest.inp"]["volume"] == pytest.approx(found["rest.step"]["volume"], rel=2e-3)  # of straight cells
    assert found["rest.step"]["solids"] == 1
    assert found["rest.step"]["valid"]
    largest = float(np.abs(drawn - rest).max())
    assert largest > 2.0  # mm
    if shutil.which("ccx"):
        text = (tmp_path / "rest.inp").read_text()
        (tmp_path / "load.inp").write_text(
            text.replace("*NODE PRINT, NSET=Fixed, TOTALS=ONLY\nRF", "*NODE PRINT, NSET=Nall\nU")
        )
        moved = displacements(command(None), tmp_path / "load.inp", tags, 60)
        away = float(np.abs(rest + moved - drawn).max())
        print(f"CalculiX loads the copy to within {away / largest:.1e} of the largest displacement")
        assert away < 0.01 * largest


@pytest.mark.release
@needs_freecad
def test_freecad_opens_refitted_and_faceted_solids_of_its_own_step_file(tmp_path: Path) -> None:
    (tmp_path / "part.py").write_text(files(PAGE)["part_in_freecad.py"])
    freecad(tmp_path / "part.py")
    job: dict[str, Any] = {
        "job": "part",
        "analysis": "inverse",
        "mesh": {"cad": "block.step", "size": "4 mm", "geometry_degree": 2},
        "regions": {"foot": "x < 0.01 mm"},
        "material": {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.4},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        "supports": [{"region": "foot", "fix": ["x", "y", "z"]}],
        "certificate": NO_CERTIFICATE,
    }
    (tmp_path / "part.yaml").write_text(yaml.safe_dump(job))
    printed = typed(tmp_path, "run part.yaml --quiet", "export results/part --to faceted.step")
    refitted = hpcinv_here("export", "results/part", "--to", "refitted.step", "--refit", "0.05 mm", cwd=tmp_path)
    assert "6 refitted faces, one solid" in refitted.stdout, refitted.stderr
    found = opened(tmp_path)
    volume = float(found["faceted.step"]["volume"])
    for name, faces in (("faceted.step", None), ("refitted.step", 6)):
        assert found[name]["valid"], printed
        assert found[name]["solids"] == 1
        assert found[name]["volume"] == pytest.approx(volume, rel=1e-3)
        assert faces is None or found[name]["faces"] == faces
    assert abs(volume / found["block.step"]["volume"] - 1) < 0.05
