"""CalculiX next to us on equal meshes: its decks, and the differences where it is installed."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import ROOT

DIVISIONS = {"mesh.parameters.nx": 1, "mesh.parameters.ny": 1, "mesh.parameters.nz": 2}
CELLS = {
    "C3D8": {"mesh.parameters.hexahedra": True, "discretisation.displacement": 1},
    "C3D10": {"mesh.parameters.hexahedra": False, "discretisation.displacement": 2},
    "C3D20": {"mesh.parameters.hexahedra": True, "discretisation.displacement": 2},
}


@pytest.fixture(autouse=True)
def benchmarks_importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT)


@pytest.mark.parametrize("element", CELLS)
def test_nodal_forces_have_resultant_and_moment_of_the_traction(element: str, tmp_path: Path) -> None:
    from benchmarks.published.calculix import deck
    from hpcinv.base.quantity.keys import assigned
    from hpcinv.job.job import parse
    from hpcinv.job.yaml_reader import read_yaml
    from hpcinv.mesh.body import read_source

    path = ROOT / "benchmarks" / "published" / "calculix" / "block.yaml"
    degree = CELLS[element]["discretisation.displacement"]
    job = parse(assigned(read_yaml(path), DIVISIONS | CELLS[element] | {"mesh.geometry_degree": degree}), path)
    source = read_source(job.mesh, job.resolve(job.mesh.file))
    nodes = deck.write(tmp_path / "body.inp", source, job)
    lines = (tmp_path / "body.inp").read_text().splitlines()
    forces = np.zeros_like(source.points)
    for line in lines[lines.index("*CLOAD") + 1 : lines.index("*NODE PRINT, NSET=ALL")]:
        node, axis, force = line.split(",")
        forces[int(node) - 1, int(axis) - 1] = float(force)
    traction = np.array([1e5, 0.0, -1.5e5])  # on the unit square at z = 1 m
    assert deck.element(source) == element
    assert set(np.flatnonzero(forces.any(axis=1))) <= set(nodes)
    assert forces.sum(axis=0) == pytest.approx(traction, abs=1e-5)
    moment = np.cross(source.points, forces).sum(axis=0)
    assert moment == pytest.approx(np.cross([0.5, 0.5, 1.0], traction), abs=1e-5)


def test_last_displacements_of_a_file_are_read(tmp_path: Path) -> None:
    from benchmarks.published.calculix.deck import displacements

    text = "\n displacements (vx,vy,vz) for set ALL and time  {}\n\n         1  {}  0.000000E+00 -2.500000E-01\n"
    path = tmp_path / "body.dat"
    path.write_text(text.format("0.5000000E+00", "1.000000E+00") + text.format("0.1000000E+01", "3.000000E+00"))
    assert displacements(path).tolist() == [[3.0, 0.0, -0.25]]


def test_without_calculix_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.published.calculix import beside

    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(sys, "argv", ["beside"])
    with pytest.raises(SystemExit, match="CalculiX is not installed") as stop:
        beside.main()
    assert "\n" not in str(stop.value)


@pytest.mark.everyday("C3D8")
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
@pytest.mark.parametrize("element", ["C3D8", "C3D10"])
def test_equal_cells_give_the_displacement_and_the_unloaded_shape_of_calculix(element: str, tmp_path: Path) -> None:
    from benchmarks.published.calculix.beside import compared

    comparison = compared("block", DIVISIONS | CELLS[element], tmp_path)
    assert comparison.difference < 1e-6  # 7 digits in its file
    assert comparison.back is not None
    assert comparison.back < 1e-6


def differences(directory: Path, **parameters: Any) -> tuple[float, float]:
    """Return how much CalculiX differs on two pressed blocks: in force and largest displacement, relative to ours."""
    from benchmarks.published.calculix.contact import compared_blocks

    force, displacement = compared_blocks({"layers": 2, **parameters}, directory)
    print(f"{parameters}: force {force:.1e}, displacement {displacement:.1e}")
    return force, displacement


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_contact_of_flat_blocks_has_the_force_of_calculix(tmp_path: Path) -> None:
    """CalculiX's penalty lets surfaces overlap by pressure/stiffness: 3e-6 of 0.02, and of the force as much."""
    force, displacement = differences(tmp_path, lower=2, upper=3)
    assert force < 3 * 1.5e-4
    assert displacement < 2e-3


@pytest.mark.release
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_contact_of_curved_blocks_comes_near_to_calculix_on_finer_meshes(tmp_path: Path) -> None:
    """Our gaps are means around vertices, its gaps are at points of facets: they differ at the edge of the contact."""
    forces = [differences(tmp_path, lower=n, upper=n, crown=0.02)[0] for n in (3, 6)]
    assert forces[0] < 4e-3
    assert forces[1] < 0.6 * forces[0]
