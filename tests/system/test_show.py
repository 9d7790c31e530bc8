"""``hpcinv show``: pictures of jobs, meshes and results, from the command line."""

import io
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import pyvista
from helpers.command_line import BLOCK, hpcinv_here, write_job
from helpers.run_directories import run_directory

from hpcinv.pages.pictures.drawing import DrawnBody, View, figure, thumbnail

MESHES = Path(__file__).parents[2] / "meshes"
BLUE, ORANGE = (0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)


def pixels(path: Path, colour: tuple[int, int, int]) -> int:
    """Number of pixels of about the hue of a colour, whatever the light."""
    image = matplotlib.image.imread(path)[:, :, :3]
    norms = np.linalg.norm(image, axis=2)
    wanted = np.array(colour) / np.linalg.norm(colour)
    return int(((image @ wanted > 0.985 * norms) & (norms > 0.2)).sum())


def show(directory: Path, *arguments: object) -> str:
    done = hpcinv_here("show", *arguments, cwd=directory)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.release
def test_supports_and_loads_are_seen_before_a_run(tmp_path: Path) -> None:
    pressed = [*BLOCK["effects"], {"effect": "pressure", "region": "x1", "pressure": "1 kPa"}]
    write_job(tmp_path / "block.yaml", BLOCK, effects=pressed)
    assert show(tmp_path, "block.yaml").split() == ["block.png"]
    both = pixels(tmp_path / "block.png", BLUE)
    assert both > 2_000
    write_job(tmp_path / "bare.yaml", BLOCK, effects=[], supports=[{"region": "z0", "fix": ["x", "y", "z"]}])
    show(tmp_path, "bare.yaml")
    assert pixels(tmp_path / "block.png", ORANGE) > 500 > pixels(tmp_path / "bare.png", ORANGE)


@pytest.mark.release
def test_the_arrow_of_gravity_is_in_the_picture(tmp_path: Path) -> None:
    show(tmp_path, MESHES.parent / "jobs" / "pdms-beam.yaml", "--output", "beam.png")
    image = matplotlib.image.imread(tmp_path / "beam.png")
    matplotlib.image.imsave(tmp_path / "views.png", image[: 3 * len(image) // 4])  # without the legend
    assert pixels(tmp_path / "views.png", ORANGE) > 200


@pytest.mark.release
def test_a_mesh_is_drawn(tmp_path: Path) -> None:
    assert show(tmp_path, MESHES / "box.py").split() == ["box-mesh.png"]
    assert (tmp_path / "box-mesh.png").stat().st_size > 10_000
    done = hpcinv_here("mesh", "show", str(MESHES / "box.py"), "--output", "other.png", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "other.png").read_bytes() == (tmp_path / "box-mesh.png").read_bytes()


def test_all_states_of_a_run_are_drawn(tmp_path: Path) -> None:
    write_job(tmp_path / "block.yaml", BLOCK)
    run_directory(tmp_path / "run", 3, ("standing", "turned"))
    show(tmp_path, "run")
    show(tmp_path, "run", "--colour", "error")
    show(tmp_path, "block.yaml")
    first, second, before = (
        matplotlib.image.imread(tmp_path / name) for name in ("run-result.png", "run-result-error.png", "block.png")
    )
    assert first.shape[1] == 3 * before.shape[1] // 2  # three bodies next to each other, two views
    assert not np.array_equal(first, second)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.yaml"], "nothing.yaml: no such file or directory"),
        (["."], "has no summary of a run"),
        ([MESHES / "box.py", "--output", "box.jpg"], "box.jpg: pictures are PNG files"),
        ([MESHES / "box.py", "--output", "no/box.png"], "there is not a directory no"),
        ([MESHES / "box.py", "--colour", "J"], "--colour is for results"),
        (["wrong.yaml"], "no region 'bottom'"),
        (["wrong.yaml", "--unit", "mm"], "--unit is for meshes"),
        (["damaged"], "surface.npz: cannot be read"),
        (["damaged", "--html"], "damaged: --html is for jobs and meshes"),
        ([MESHES / "box.py", "--html", "--output", "box.png"], "box.png: --html writes HTML files"),
        ([MESHES / "box.py", "--section", "x"], "--section is for results"),
        (["wrong.yaml", "--edit", "--port", "99999"], "argument --port: must be 0 to 65535"),
        (["wrong.yaml", "--edit", "--html"], "wrong.yaml: --edit cannot be combined with --html"),
        (["wrong.yaml", "--port", "8000"], "--port is for --edit"),
        ([MESHES / "box.py", "--edit"], "box.py: --edit is for jobs"),
        (["older"], "older: its summary does not have what a picture needs"),
    ],
)
def test_invalid_show_arguments_get_one_message(arguments: list[object], message: str, tmp_path: Path) -> None:
    write_job(tmp_path / "wrong.yaml", BLOCK, supports=[{"region": "bottom", "fix": ["x", "y", "z"]}])
    (run_directory(tmp_path / "damaged", 2) / "surface.npz").write_bytes(b"PK\x03\x04")
    run_directory(tmp_path / "older", 2, job={"supports": []})
    done = hpcinv_here("show", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.glob("*.png"))


def sphere_in_a_larger_one(*, hollow: bool = False) -> tuple[DrawnBody, DrawnBody]:
    ball = pyvista.Sphere(radius=1)
    if hollow:
        ball += pyvista.Sphere(radius=0.9).flip_faces()
    points, triangles = np.asarray(ball.points, dtype=np.float64), np.asarray(ball.regular_faces)
    return DrawnBody(points, triangles, values=points[:, 2]), DrawnBody(1.5 * points, triangles, opacity=0.35)


def image_of(png: bytes) -> np.ndarray:
    return np.asarray(matplotlib.image.imread(io.BytesIO(png)))


@pytest.mark.everyday("solid")
@pytest.mark.usefixtures("whole_pictures")
@pytest.mark.parametrize("hollow", [False, True], ids=["solid", "shell"])
def test_a_shadow_around_a_body_does_not_veil_its_colours(hollow: bool) -> None:
    body, shadow = sphere_in_a_larger_one(hollow=hollow)
    frame, towards, up = shadow.points, np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    alone, both = (
        image_of(thumbnail(View(parts, frame, towards, up), (-1.0, 1.0))) for parts in ([body], [body, shadow])
    )
    rows, columns = alone.shape[0] // 2, alone.shape[1] // 2
    middle = np.s_[rows - 20 : rows + 20, columns - 20 : columns + 20]
    assert np.array_equal(alone[middle], both[middle])
    assert not np.array_equal(alone, both)


@pytest.mark.release
def test_many_bodies_are_drawn_in_rows() -> None:
    body, _ = sphere_in_a_larger_one()
    view = View([body], body.points, np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    one, five = (image_of(figure([view] * count, "spheres").png) for count in (1, 5))
    assert five.shape[1] == 3 * one.shape[1]
    assert five.shape[0] > 1.7 * one.shape[0]
