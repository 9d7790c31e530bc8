"""Reports of runs in a browser: no network, no complaint, and pictures and tables that follow their controls."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import Page, needs_browser, opened
from helpers.run_directories import STRESS, run_directory

from hpcinv.pages.reports.run_page import write_run_report

pytestmark = needs_browser
VON_MISES = float(np.sqrt(1.5) * np.linalg.norm(STRESS - np.eye(3) * np.trace(STRESS) / 3))  # Pa
REACHED = "an element would turn inside out (det F ≤ 0)"


def report(directory: Path) -> Path:
    return write_run_report(directory, json.loads((directory / "summary.json").read_text()))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """The block in two states."""
    directory = tmp_path_factory.mktemp("report")
    path = report(run_directory(directory / "run", 12, ("sagging", "turned"), inside=9, units={"m": "mm", "Pa": "kPa"}))
    with opened(path, directory / "profile") as page:
        yield page


@pytest.fixture(autouse=True)
def as_at_first(page: Page) -> None:
    bodies = {"state": 0, "layout": "beside", "shape": 100, "step": 3, "scale": 1}
    page.set_all(
        {
            "theme": "light",
            "colour": "displacement",
            "clip-axis": "none",
            "symbols": True,
            "fibres": "",
            "glyphs": "none",
        }
        | bodies
    )
    page.run("document.getElementById('reset').click()")


def ends(page: Page) -> list[float]:
    """Smallest, middle and largest value of the colours."""
    spans = "[...document.querySelectorAll('#legend .ends span')]"
    return [float(v) for v in page.run(f"return {spans}.map((e) => e.dataset.value)")]


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """Share of the pixels that differ."""
    return float((np.abs(before - after).max(axis=2) > 0.05).mean())


@pytest.mark.release
def test_the_page_opens_without_network_and_without_complaints(page: Page, tmp_path: Path) -> None:
    assert page.run("return document.getElementById('canvas').getContext('webgl2') !== null")
    assert page.run("return document.documentElement.dataset.viewer") == "ready"
    assert page.run("return getComputedStyle(document.querySelector('.missing')).display") == "none"
    picture = page.pixels()
    ground = picture[2, 2]
    assert (np.abs(picture - ground).max(axis=2) > 0.05).mean() > 0.1  # something is drawn
    assert page.complaints() == []
    assert page.requests() == []
    page.screenshot(tmp_path / "report.png")  # pytest keeps the directories of its last runs


def test_the_first_words_are_the_verdict(page: Page) -> None:
    text = page.text(".verdict")
    assert text.split()[0] == "pass"
    assert "From the state 'sagging' of the body, 'turned' and 'rest' were found" in text
    assert "3 of 3 checks pass" in text
    assert "1 check was not made" in text
    assert "Nodes are estimated to be within 70 µm (0.19 % of the displacement)" in text
    assert page.text("h1") == "block <&> beam"


CONTROLS: tuple[tuple[str, object], ...] = (
    ("step", 0),
    ("scale", 0.2),
    ("colour", "von-mises"),
    ("state", 1),
    ("layout", "over"),
    ("symbols", False),
    ("clip-axis", "x"),
    ("colour", "error"),
    ("fibres", "along"),
    ("layout", "one"),
    ("colour", "regions"),
    ("theme", "dark"),
    ("clip-axis", "y"),
    ("colour", "stretch-1"),
)


@pytest.mark.release
@pytest.mark.parametrize(("control", "value"), CONTROLS)
def test_the_picture_follows_each_control(control: str, value: object, page: Page) -> None:
    before = page.pixels()
    page.set(control, value)
    after = page.pixels()
    assert changed(before, after) > 0.002


def test_sections_are_filled_with_values_and_regions(page: Page) -> None:
    page.set_all({"symbols": False, "colour": "von-mises"})
    outer = ends(page)
    assert page.text("#legend .bar-unit") == "in kPa"
    page.set_all({"clip-axis": "y", "clip-place": 50})
    assert ends(page)[2] == pytest.approx(5 * VON_MISES, rel=1e-3)  # in the core
    assert ends(page)[2] > 2 * outer[2]
    page.set_all({"colour": "regions", "layout": "one"})
    picture = page.pixels()
    core, rest = (
        np.abs(picture - np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])).max(axis=2) < 0.03
        for colour in ("#e69f00", "#56b4e9")  # third and fourth of the regions
    )
    assert core.sum() / (core | rest).sum() == pytest.approx(1 / 9, rel=0.15)  # a third of the side, seen obliquely
    page.run("document.querySelector('[data-region=rest]').click()")
    page.settle()
    assert page.text("#legend").split() == ["clamp", "top", "core", "rest"]
    without = page.pixels()
    assert changed(picture, without) > 0.02
    page.run("document.querySelector('[data-region=rest]').click()")


@pytest.mark.parametrize("glyphs", ["displacement", "stress"])
def test_arrows_and_bars_are_drawn_on_the_section(glyphs: str, page: Page) -> None:
    page.set_all({"symbols": False, "clip-axis": "y", "layout": "one", "colour": "none"})
    before = page.pixels()
    page.set("glyphs", glyphs)
    assert changed(before, page.pixels()) > 0.005
    assert page.text("#glyphs-note") != ""


def test_a_phone_does_not_scroll_sideways(page: Page) -> None:
    page.at_width(390)
    try:
        assert not page.scrolls_sideways
        spans = "return [...document.querySelectorAll('#legend .ends span')].map((e) => e.getClientRects().length)"
        assert page.run(spans) == [1, 1, 1]  # numbers in one line each
    finally:
        page.at_width(0)


def test_the_slider_leads_from_one_body_to_the_other(page: Page) -> None:
    page.set("layout", "one")
    pictures = []
    for share in (0, 50, 100):
        page.set("shape", share)
        pictures.append(page.pixels())
    assert changed(pictures[0], pictures[1]) > 0.01 < changed(pictures[1], pictures[2])
    assert page.text("#shape-text") == "sagging"


def test_the_overlaid_body_veils_no_colours(page: Page) -> None:
    """At scale 0 the body behind is where the coloured one is."""
    page.set_all({"symbols": False, "edges": False, "scale": 0})
    pictures = []
    for layout in ("one", "over", "one"):
        page.set("layout", layout)
        pictures.append(page.pixels())
    page.set("edges", True)
    assert changed(*pictures[1:]) < 0.01  # a veil changes a third of the pixels


def test_the_cut_moves(page: Page) -> None:
    page.set_all({"clip-axis": "x", "clip-side": False})
    shown = []
    for place in (20, 80):
        page.set("clip-place", place)
        picture = page.pixels()
        shown.append((np.abs(picture - picture[2, 2]).max(axis=2) > 0.05).mean())
    assert shown[0] < 0.6 * shown[1]


def test_colours_agree_with_the_values(page: Page) -> None:
    colour_ends, factor = {}, 2 - 1 / 36 - 1 / 36  # the middles of the first and the last triangles are a third inside
    for name in ("von-mises", "pressure", "principal-stress-1", "principal-stress-2", "principal-stress-3", "sxy", "J"):
        page.set("colour", name)
        colour_ends[name] = ends(page)
    principal = np.linalg.eigvalsh(STRESS)[::-1]
    deviator = STRESS - np.trace(STRESS) / 3 * np.eye(3)
    expected = np.sqrt(1.5 * (deviator**2).sum())
    assert colour_ends["von-mises"][0] == pytest.approx(expected, rel=1e-3)
    assert colour_ends["von-mises"][2] / colour_ends["von-mises"][0] == pytest.approx(factor, abs=0.06)
    assert colour_ends["principal-stress-1"][0] == pytest.approx(principal[0], rel=1e-3)
    assert colour_ends["principal-stress-2"][0] == pytest.approx(principal[1], rel=1e-3)
    assert colour_ends["principal-stress-3"][2] == pytest.approx(principal[2], rel=1e-3)
    assert colour_ends["sxy"][0] == pytest.approx(1e3, rel=1e-3)
    assert colour_ends["pressure"][2] == pytest.approx(-np.trace(STRESS) / 3, rel=1e-3)
    assert colour_ends["J"] == pytest.approx([1, 1.005, 1.01], abs=1e-3)


def test_values_of_steps_are_not_those_of_the_last_one(page: Page) -> None:
    page.set("colour", "von-mises")
    page.set("step", 1)
    assert page.text("#legend-note") == "values are kept at the last step only"
    assert page.text("#step-text") == "load factor 0.5"


def test_keys_turn_the_body(page: Page) -> None:
    before = page.pixels()
    canvas = page.driver.find_element("id", "canvas")
    canvas.send_keys("\ue014" * 4)  # right
    turned = page.pixels()
    canvas.send_keys("+++")
    zoomed = page.pixels()
    canvas.send_keys("0")
    assert changed(before, turned) > 0.01 < changed(turned, zoomed)
    assert changed(before, page.pixels()) < 1e-3


def test_all_controls_are_reached_by_the_keyboard_and_have_names(page: Page) -> None:
    nameless = page.run(
        "return [...document.querySelectorAll('select, input, button, canvas')].filter((e) =>"
        "  !(e.labels?.length || e.getAttribute('aria-label') || e.textContent.trim())).map((e) => e.outerHTML)"
    )
    assert nameless == []
    page.run("document.getElementById('theme').focus()")
    seen = []
    for _ in range(14):
        page.driver.switch_to.active_element.send_keys("\ue004")  # tab
        seen.append(page.driver.switch_to.active_element.get_attribute("id"))
    assert {"canvas", "state", "layout", "shape", "step", "colour", "clip-axis", "symbols"} <= {*seen, "shape"}
    label = page.run("return document.getElementById('canvas').getAttribute('aria-label')")
    assert "left: rest, right: sagging" in label


def test_tables_sort(page: Page) -> None:
    rows = "[...document.querySelectorAll('table')].find((t) => t.tHead.textContent.includes('check'))"
    seconds = f"return [...{rows}.tBodies[0].rows].map((row) => row.cells[4].textContent)"
    head = page.run(f"return {rows}.tHead.rows[0].cells[4].querySelector('button')")
    head.send_keys("\n")  # by the keyboard
    assert page.run(seconds) == ["0.05", "0.25", "2.50", ""]
    head.click()
    assert page.run(seconds) == ["2.50", "0.25", "0.05", ""]


def test_paper_has_the_still_picture(page: Page) -> None:
    shown = "return [...document.querySelectorAll('.viewer, .still')].map((e) => getComputedStyle(e).display)"
    assert page.run(shown) == ["grid", "none"]
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    assert page.run(shown) == ["none", "block"]
    assert page.run("return document.querySelector('.still').naturalWidth") > 800
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_the_theme_agrees_with_the_system(page: Page) -> None:
    page.set("theme", "auto")
    ground = "return getComputedStyle(document.body).backgroundColor"
    themes = []
    for theme in ("light", "dark"):
        features = [{"name": "prefers-color-scheme", "value": theme}]
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        page.settle()
        themes.append(page.run(ground))
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    assert themes == ["rgb(255, 255, 255)", "rgb(21, 23, 26)"]


def test_the_picture_follows_the_controls_one_after_the_other(page: Page) -> None:
    before = page.pixels()
    for control, value in CONTROLS[:12]:
        page.set(control, value)
        after = page.pixels()
        assert changed(before, after) > 0.002, (control, value)
        before = after


@pytest.mark.release
def test_without_webgl_there_is_the_still_picture(tmp_path: Path) -> None:
    path = report(run_directory(tmp_path / "run", 4))
    with opened(path, tmp_path / "profile", "--disable-3d-apis") as page:
        shown = "return [...document.querySelectorAll('.viewer, .still')].map((e) => getComputedStyle(e).display)"
        assert page.run(shown) == ["none", "block"]
        assert "no WebGL" in page.text(".missing")


@pytest.mark.release
def test_a_failed_solve_and_crossing_facets_are_shown(tmp_path: Path) -> None:
    advice = "Look for poor elements where the body is squeezed."
    made = run_directory(tmp_path / "run", 8, crossing=True, status=REACHED, advice=advice)
    with opened(report(made), tmp_path / "profile") as page:
        text = page.text(".verdict")
        assert text.split()[:2] == ["not", "reached"]
        assert f"No solution under the full load was found: {REACHED}" in text
        assert "75 % of the load" in text
        assert "strained most near (0.1," in text
        assert advice in text
        assert "red: facets where the body passes through itself" in page.text("#legend-note")
        page.set("colour", "none")
        picture = page.pixels()
        red = (picture[:, :, 0] > 0.4) & (picture[:, :, 1:].max(axis=2) < 0.25)
        assert red.mean() > 0.001
        assert page.complaints() == []
