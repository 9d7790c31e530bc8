"""``hpcinv compare``: balls whose distances, volumes and overlap are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import pyvista
import SimpleITK
from helpers.small_files import small_files

from hpcinv.__main__ import main
from hpcinv.geometry.workshop.comparison import surface_in
from hpcinv.geometry.workshop.surface_comparison import compare
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh import read_source

pytestmark = pytest.mark.usefixtures("warm_reader")


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
    content = json.loads(figures.read_text())
    assert content["one"]["mean"] == pytest.approx(-1e-3, rel=0.02)  # inside the other one
    assert content["other"]["mean"] == pytest.approx(1e-3, rel=0.02)
    assert content["other"]["largest"] == pytest.approx(1e-3, rel=0.02)
    assert content["one"]["volume"] == pytest.approx(4 / 3 * np.pi * 1e-6, rel=0.01)
    assert content["dice"] == pytest.approx(2 * 10**3 / (10**3 + 11**3), abs=0.01)
    assert pyvista.read(distances)["distance"] == pytest.approx(-1e-3, rel=0.05)


def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Files may have 20,000 bytes; VTK would crash."""
    body = ball(tmp_path / "ball.stl")
    with small_files(20_000):
        code = main(["compare", str(body), str(body), "--unit", "mm", "--to", str(tmp_path / "distances.vtp")])
    assert (code, capsys.readouterr().err.partition(":")[0]) == (2, str(tmp_path / "distances.vtp"))
    assert [path.name for path in tmp_path.iterdir()] == ["ball.stl"]


@pytest.mark.release
def test_a_body_that_was_moved_is_moved_back() -> None:
    turned = egg().rotate_z(12).rotate_x(5).translate([0.004, -0.001, 0.002])
    comparison = compare(turned, egg(), (turned, egg()))
    print(f"{comparison.first.largest:.1e} m left, turned by {np.degrees(comparison.rotation):.2f} degrees")
    assert comparison.first.largest < 2e-5
    assert comparison.rotation == pytest.approx(np.radians(np.hypot(12, 5)), rel=0.05)
    assert comparison.dice > 0.99
    left = compare(turned, egg())
    assert left.first.largest > 3e-3
    assert (left.rotation, left.translation) == (0, 0)


def test_a_mesh_next_to_a_surface(meshes: Path, tmp_path: Path) -> None:
    pyvista.Cube(center=(0.5, 0.5, 0.5)).triangulate().save(tmp_path / "cube.stl")
    comparison = compare(surface_in(meshes / "box.py", 1.0).surface, surface_in(tmp_path / "cube.stl", 1.0).surface)
    assert comparison.first.largest < 1e-7
    assert comparison.first.centre == pytest.approx([0.5, 0.5, 0.5])
    assert comparison.first.volume == pytest.approx(comparison.second.volume, rel=1e-6)
    assert comparison.dice == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["missing.stl", "ball.stl"], "missing.stl: "),
        (["ball.stl", "notes.txt"], "notes.txt: is not a mesh, surface, image or run"),
        (["ball.stl", "ball.stl", "--unit", "kg"], "--unit kg: is not a unit of length"),
        (["ball.stl", "ball.stl", "--to", "far.stl"], "far.stl: a surface with distances ends in .vtp"),
    ],
)
def test_bad_input_is_reported(
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


def written(path: Path, direction: tuple[float, ...] = (1, 0, 0, 0, 1, 0, 0, 0, 1)) -> Path:
    """Image of a ball of 10 mm about (50, 0, 0) mm as labels 3 and 4, in voxels of 1 mm along turned axes."""
    axis = np.arange(28) - 13.5
    voxels = (np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1), axis=-1) < 10).astype(int)
    voxels[14:] *= 2
    image = SimpleITK.GetImageFromArray((voxels + 2 * (voxels > 0)).astype(np.uint8).transpose())
    image.SetDirection(direction)
    matrix = np.array(direction).reshape(3, 3)
    image.SetOrigin((np.array([50, 0, 0]) - matrix @ np.full(3, 13.5)).tolist())
    SimpleITK.WriteImage(image, str(path))
    return path


@pytest.mark.everyday("direction2")
@pytest.mark.parametrize(
    "direction", [(1, 0, 0, 0, 1, 0, 0, 0, 1), (-1, 0, 0, 0, 0, 1, 0, 1, 0), (0, 1, 0, 1, 0, 0, 0, 0, 1)]
)
def test_an_image_next_to_a_surface(direction: tuple[float, ...], tmp_path: Path) -> None:
    """Volume, place and distances of a ball, also with axes that are turned and mirrored."""
    image = surface_in(written(tmp_path / "ball.nii.gz", direction), None)
    comparison = compare(image.surface, surface_in(ball(tmp_path / "ball.stl", centre=(50, 0, 0)), 1e-3).surface)
    print(f"rms {comparison.first.rms:.1e}, largest {comparison.first.largest:.1e} m, Dice {comparison.dice:.4f}")
    assert image.surface.volume == pytest.approx(4224e-9, rel=2e-3)  # the volume of its voxels
    assert comparison.first.centre == pytest.approx([0.05, 0, 0], abs=2e-5)
    assert comparison.first.largest < 0.5e-3
    assert comparison.first.rms < 0.25e-3
    half = surface_in(tmp_path / "ball.nii.gz", None, labels=[3])
    assert half.surface.volume == pytest.approx(2112e-9, rel=2e-3)


def test_principal_axes_of_an_ellipsoid() -> None:
    turned = egg().rotate_z(30)
    comparison = compare(turned, turned).first
    assert np.abs(comparison.axes[0]) == pytest.approx([0, 0, 1], abs=1e-6)
    assert np.abs(comparison.axes[1]) == pytest.approx([0.5, 3**0.5 / 2, 0], abs=2e-3)


def test_alignment_by_regions(meshes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A block that has grown at its top is laid on its base, not on its middle."""
    from hpcinv.mesh.mesh_files import save

    source = read_source(MeshSpec.model_validate({"file": str(meshes / "box.py")}), meshes / "box.py")
    grown = source.points * [1, 1, 1.2] + [0.3, 0, 0.1]
    save(tmp_path / "one.msh", source, grown)
    save(tmp_path / "other.msh", source, source.points)
    out = tmp_path / "figures.json"
    command = ["compare", str(tmp_path / "one.msh"), str(tmp_path / "other.msh"), "--json", str(out)]
    assert main([*command, "--align", "z0"]) == 0
    content = json.loads(out.read_text())
    assert content["one"]["largest"] == pytest.approx(0.2, abs=1e-3)
    assert content["moved"]["translation"] == pytest.approx(np.hypot(0.3, 0.1), rel=1e-2)
    assert main([*command, "--align", "z9"]) == 2
    assert "one.msh: there is no region of the surface 'z9'" in capsys.readouterr().err
