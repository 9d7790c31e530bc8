"""Sections of results in pictures: what they show of the body, its colours and values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import NEO_HOOKEAN
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.cli.show import _run_picture
from hpcinv.errors import OutputError
from hpcinv.output.surfaces.picture import Colour
from hpcinv.pages.pictures import result_picture
from hpcinv.pages.pictures.drawing import DrawnBody, View

STRETCH = 1.25


@pytest.fixture(scope="module")
def stretched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a unit cube that was stretched along x, in two regions."""
    directory = tmp_path_factory.mktemp("stretched") / "run"
    sides = [{"region": f"{axis}0", "fix": [axis]} for axis in "yz"]
    moved = [{"region": f"x{end}", "displacement": [str(u), None, None]} for end, u in ((0, 0), (1, STRETCH - 1))]
    posed = job(
        mesh=box((2, 2, 2)),
        regions={"left": "x < 0.6 m"},
        material={"left": NEO_HOOKEAN, "elsewhere": NEO_HOOKEAN},
        supports=[*sides, *moved],
        analysis="forward",
        certificate="off",
    )
    hpcinv.run(posed, MPI.COMM_SELF, directory=directory)
    return directory


type Drawn = Callable[[Colour, tuple[str, float | None]], tuple[Sequence[View], dict[str, Any]]]


@pytest.fixture
def drawn(stretched: Path, monkeypatch: pytest.MonkeyPatch) -> Drawn:
    """Return the views of a picture with a section, and what else it has, without drawing it."""
    seen = list[tuple[Sequence[View], dict[str, Any]]]()
    monkeypatch.setattr(result_picture, "figure", lambda views, _, **others: seen.append((views, others)))

    def draw(colour: Colour, section: tuple[str, float | None]) -> tuple[Sequence[View], dict[str, Any]]:
        _run_picture(stretched, colour, section)
        return seen[-1]

    return draw


def area(body: DrawnBody) -> float:
    a, b, c = (body.points[body.triangles[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def sections(view: View) -> list[DrawnBody]:
    return [part for part in view.parts if isinstance(part, DrawnBody) and part.is_section]


def test_a_section_has_the_area_and_values_of_each_body(drawn: Drawn) -> None:
    views, others = drawn("J", ("y", 0.3))
    areas = [[area(part) for part in sections(view)] for view in views]
    (volume_ratio,) = {round(float(value), 9) for part in sections(views[0]) for value in np.ravel(part.values)}
    # J = STRETCH t² where the sides contract by t, and the section has the area STRETCH t.
    assert sorted(total for (total,) in areas) == pytest.approx([1.0, (STRETCH * volume_ratio) ** 0.5])
    assert {view.title.rpartition(", ")[2] for view in views} == {"y = 0.3 m"}
    label, lowest, highest = others["colours"]
    assert label.startswith("volume ratio J")
    assert (lowest, highest) == pytest.approx((volume_ratio, volume_ratio))


def test_regions_have_their_colours_in_the_section_and_on_the_boundary(drawn: Drawn) -> None:
    views, others = drawn("regions", ("z", None))
    colours = {colour: name for name, colour in others["legend"]}
    halves = [{colours[part.colour]: area(part) for part in sections(view)} for view in views]
    assert halves[0] == pytest.approx({"left": 0.5, "block": 0.5})
    assert halves[1]["left"] == pytest.approx(halves[1]["block"])
    assert 0.5 < halves[1]["left"] < STRETCH / 2


def test_a_section_that_misses_the_body_is_refused(stretched: Path) -> None:
    with pytest.raises(OutputError, match=r"the section x = 3 m misses a body from 0 m to 1\.?\d* m"):
        _run_picture(stretched, "J", ("x", 3.0))
