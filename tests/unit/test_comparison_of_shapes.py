"""``hpcinv compare``: balls whose distances, volumes and overlap are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import pyvista

from hpcinv.__main__ import main
from hpcinv.workshop.comparison import compare, surface_in


def ball(path: Path, radius: float = 10.0, centre: tuple[float, float, float] = (0, 0, 0)) -> Path:
    pyvista.Sphere(radius=radius, center=centre, theta_resolution=90, phi_resolution=90).save(path)
    return path


def egg() -> pyvista.PolyData:
    """An ellipsoid without an axis of symmetry in its triangles, in m."""
    egg = pyvista.Sphere(radius=1.0, theta_resolution=60, phi_resolution=60).triangulate()
    egg.points = np.asarray(egg.points, dtype=np.float64) * [0.01, 0.02, 0.03]
    return egg


def test_balls_of_two_sizes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small, large = ball(tmp_path / "small.stl"), ball(tmp_path / "large.ply", 11.0)
    figures, distances = tmp_path / "figures.json", tmp_path / "distances.vtp"
    arguments = ["compare", str(small), str(large), "--unit", "mm", "--json", str(figures), "--to", str(distances)]
    assert main(arguments) == 0
    assert "overlap (Dice): 0.8" in capsys.readouterr().out
    found = json.loads(figures.read_text())
    assert found["one"]["mean"] == pytest.approx(-1e-3, rel=0.02)  # inside the other one
    assert found["other"]["mean"] == pytest.approx(1e-3, rel=0.02)
    assert found["other"]["largest"] == pytest.approx(1e-3, rel=0.02)
    assert found["one"]["volume"] == pytest.approx(4 / 3 * np.pi * 1e-6, rel=0.01)
    assert found["dice"] == pytest.approx(2 * 10**3 / (10**3 + 11**3), abs=0.01)
    assert pyvista.read(distances)["distance"] == pytest.approx(-1e-3, rel=0.05)


def test_a_body_that_was_moved_is_moved_back() -> None:
    turned = egg().rotate_z(12).rotate_x(5).translate([0.004, -0.001, 0.002])
    found = compare(turned, egg(), align=True)
    print(f"{found.one.largest:.1e} m left, turned by {np.degrees(found.rotation):.2f} degrees")
    assert found.one.largest < 2e-5
    assert found.rotation == pytest.approx(np.radians(np.hypot(12, 5)), rel=0.05)
    assert found.dice > 0.99
    left = compare(turned, egg(), align=False)
    assert left.one.largest > 3e-3
    assert (left.rotation, left.translation) == (0, 0)


def test_a_mesh_beside_a_surface(meshes: Path, tmp_path: Path) -> None:
    pyvista.Cube(center=(0.5, 0.5, 0.5)).triangulate().save(tmp_path / "cube.stl")
    found = compare(surface_in(meshes / "box.py", 1.0), surface_in(tmp_path / "cube.stl", 1.0), align=False)
    assert found.one.largest < 1e-7
    assert found.one.centre == pytest.approx([0.5, 0.5, 0.5])
    assert found.one.volume == pytest.approx(found.other.volume, rel=1e-6)
    assert found.dice == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["missing.stl", "ball.stl"], "missing.stl: "),
        (["ball.stl", "notes.txt"], "notes.txt: is no mesh, surface or run"),
        (["ball.stl", "ball.stl", "--unit", "kg"], "--unit kg: is no unit of length"),
        (["ball.stl", "ball.stl", "--to", "far.stl"], "far.stl: a surface with distances ends in .vtp"),
    ],
)
def test_bad_input_is_told(
    arguments: list[str],
    fault: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    ball(tmp_path / "ball.stl")
    (tmp_path / "notes.txt").write_text("no body")
    assert main(["compare", *arguments]) == 2
    assert fault in capsys.readouterr().err
