"""Pictures of jobs: loads in closed cavities are drawn on a body that is cut open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import NEO_HOOKEAN
from helpers.verification import box, job

from hpcinv.output.surfaces.boundary_surface import Boundary
from hpcinv.pages.pictures import job_picture
from hpcinv.pages.pictures.drawing import DrawnBody, Glyphs, View, draw_bar, pixel_size, round_length

OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
FACES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])


PRESSURE = {"effect": "pressure", "region": "z1", "pressure": 1.0}


def drawn(monkeypatch: pytest.MonkeyPatch, inside: np.ndarray, effect: Any = PRESSURE) -> Sequence[View]:
    """Views of a job with a load on the region z1, which is a closed surface of its own."""
    seen: list[Sequence[View]] = []
    monkeypatch.setattr(job_picture, "figure", lambda views, *_, **__: seen.append(views))
    shells = [OCTAHEDRON, inside]
    triangles = np.concatenate([FACES, FACES[:, ::-1] + 6])
    regions = {"z0": np.arange(16) < 2, "z1": np.arange(16) >= 8}
    held = [{"region": "z0", "fix": ["x", "y", "z"]}]
    made = job(mesh=box((1, 1, 1)), effects=[effect], supports=held, analysis="forward", material=NEO_HOOKEAN)
    job_picture.draw_job(made, Boundary(np.concatenate(shells), triangles, regions))
    return seen[0]


def test_the_pressure_of_a_closed_cavity_is_drawn_in_a_body_cut_open(monkeypatch: pytest.MonkeyPatch) -> None:
    *_, cut = drawn(monkeypatch, 0.5 * OCTAHEDRON)
    assert cut.title == "cut open"
    (arrows,) = (part for part in cut.parts if isinstance(part, Glyphs) and part.vectors is not None)
    middle = arrows.points @ cut.direction
    assert 0 < len(arrows.points) < 8
    assert (middle > 0).all()
    assert (np.einsum("ni,ni->n", arrows.points, arrows.vectors) > 0).all()  # outwards, onto the wall
    for body in (part for part in cut.parts if isinstance(part, DrawnBody)):
        assert body.cut is not None
        assert body.cut[0] @ cut.direction > 0


def test_a_surface_outside_of_another_is_not_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(drawn(monkeypatch, OCTAHEDRON + np.array([3.0, 0, 0]))) == 2


def test_arrows_are_as_long_for_any_load(monkeypatch: pytest.MonkeyPatch) -> None:
    def arrows(effect: Any) -> np.ndarray:
        parts = drawn(monkeypatch, OCTAHEDRON + np.array([3.0, 0, 0]), effect)[0].parts
        (found,) = (part.vectors for part in parts if isinstance(part, Glyphs) and part.vectors is not None)
        return np.asarray(found)

    length = np.linalg.norm(arrows(PRESSURE), axis=1)
    for traction in ([0.0, 0.3, 0.4], [0.0, 300.0, 400.0]):
        pull = arrows({"effect": "traction", "region": "z1", "area_in": "current", "traction": traction})
        np.testing.assert_allclose(pull, length[:, None] * [0, 0.6, 0.8], rtol=1e-12)


@pytest.mark.usefixtures("whole_pictures")
def test_scale_bars_have_round_lengths_and_the_scale_of_the_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cube of 2 units of 10 mm that fills the rendering: the bar is a fifth of the width at most."""
    assert [round_length(most) for most in (0.0049, 0.005, 0.3, 9.99)] == pytest.approx([0.002, 0.005, 0.2, 5.0])
    texts, lines = list[str](), list[Any]()

    class Axis:
        def plot(self, ends: Sequence[float], *_: Any, **__: Any) -> None:
            lines.append(ends)

        def text(self, _x: float, _y: float, text: str, **_: Any) -> None:
            texts.append(text)

    view = View([], 0.02 * np.array([[0, 0, 0], [1, 1, 1.0]]), np.array([0, 1.0, 0]), np.array([0, 0, 1.0]))
    draw_bar(Axis(), pixel_size(view), (1000, 800), {"m": "mm"})
    assert texts == ["5 mm"]
    (left, right), side = lines[0], 800 / 1.2  # the frame has a margin of a fifth
    assert (right - left) / side == pytest.approx(5 / 20)
