"""The page of a job before it runs, in a browser: what a click says is what the job accepts and counts."""

from __future__ import annotations

import json
import re
import signal
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.browser import Page, needs_browser, opened
from helpers.command_line import Started
from selenium.webdriver.support.ui import WebDriverWait

from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import load
from hpcinv.mesh import build_body
from hpcinv.mesh.body import Body

pytestmark = needs_browser
MESHES = Path(__file__).parents[2] / "meshes"
TUBE = f"""\
# A tube that stands on a table.
analysis: inverse
mesh:
  file: {MESHES / "thick_cylinder.py"}
  parameters:
    {{inner: 10 mm, outer: 20 mm, length: 40 mm, around: 6, along: 4, radial: 2, quarter: false, hexahedra: true}}
regions: {{low: "z < 21 mm"}}   # half of it
material:
  wall: {{law: neo-hookean, mu: 20 kPa, lam: 80 kPa}}
supports:
  - {{region: z0, fix: [x, y, z]}}
effects:
  - {{effect: pressure, region: inner, pressure: 2 kPa}}
quantities:
  - {{name: top, of: uz, at: [15 mm, 0, 40 mm]}}
"""
LAYER = 4 * 6  # facets of the outer surface between two heights


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    directory = tmp_path_factory.mktemp("look")
    (directory / "tube.yaml").write_text(TUBE)
    assert main(["show", "--html", str(directory / "tube.yaml"), "--output", str(directory / "tube.html")]) == 0
    with opened(directory / "tube.html", directory / "profile") as page:
        yield page


def body_of(text: str, path: Path) -> Body:
    path.write_text(text)
    job = load(path)
    return build_body(job.mesh, job.regions, MPI.COMM_SELF, resolve=job.resolve)


def facets(page: Page) -> int:
    return int(re.search(r"facets(\d+)", page.text("#finding"))[1])  # type: ignore[index]


def test_lines_of_a_click_name_the_same_facets_in_a_job(page: Page, tmp_path: Path) -> None:
    page.run("document.querySelector('[data-view=x]').click()")
    counts = {}
    for tool, name in (("face", "mantle"), ("side", "right"), ("disc", "spot")):
        page.set("tool", tool)
        page.click_canvas(3, 2)
        page.set("name", name)
        line = page.text("#line")
        counts[name] = facets(page)
        text = TUBE.replace('regions: {low: "z < 21 mm"}   # half of it', line)
        assert name in yaml.safe_load(line)["regions"]
        assert body_of(text, tmp_path / "pasted.yaml").regions[name].facet_count == counts[name]
        page.run("document.getElementById('add').click()")
    assert counts["mantle"] == 4 * LAYER  # all around, without the ends
    assert 0 < counts["spot"] < LAYER
    page.run("document.querySelector('[data-view=z]').click()")
    page.set("tool", "side")
    page.click_canvas(0, -page.run("return canvas.clientHeight") // 3)
    assert facets(page) == 2 * LAYER  # the end: two rings of 24
    assert re.fullmatch(r'regions: {part: "z > 3\d mm"}', page.text("#line"))

    saved = page.text("#saved")
    assert "# A tube that stands on a table." in saved
    assert "# half of it" in saved
    regions = body_of(saved, tmp_path / "saved.yaml").regions
    assert {name: regions[name].facet_count for name in counts} == counts
    assert regions["low"].cell_count == 2 * 2 * LAYER
    assert page.complaints() == []
    assert page.requests() == []


def test_a_click_says_where_it_is(page: Page, tmp_path: Path) -> None:
    page.run("document.querySelector('[data-view=x]').click()")
    page.set("tool", "point")
    page.click_canvas()
    finding = page.text("#finding")
    assert "outer normal(0.99" in finding or "outer normal(1, 0" in finding
    assert "labelwall" in finding
    assert "outer" in finding
    at = yaml.safe_load(page.text("#line"))["at"]
    x, y, z = (float(str(value).removesuffix(" mm")) for value in at)
    assert np.hypot(x, y) == pytest.approx(20, abs=0.2)  # a chord of 15 degrees
    assert z == pytest.approx(20, abs=0.5)
    text = TUBE.replace("at: [15 mm, 0, 40 mm]", page.text("#line"))
    assert np.allclose(np.array(load_text(text, tmp_path)) * 1e3, [x, y, z])
    page.set("tool", "ruler")
    page.click_canvas(0, -60)
    page.click_canvas(0, 60)
    assert re.match(r"[\d.]+ mm between the points", page.text("#reading"))


def load_text(text: str, directory: Path) -> tuple[float, float, float]:
    (directory / "point.yaml").write_text(text)
    at = load(directory / "point.yaml").quantities[0].at
    assert at is not None
    return at


def test_regions_loads_and_the_section_are_seen(page: Page) -> None:
    assert "pressure on inner: pressure 2 kPa" in page.text("#symbol-list")
    assert "support z0: holds x, y, z" in page.text("#symbol-list")
    page.run("document.getElementById('reset').click()")
    page.set_all({"symbols": False, "clip-axis": "none"})
    whole = page.pixels()
    page.set("clip-axis", "x")
    cut = page.pixels()
    assert np.mean(np.abs(whole - cut).max(axis=2) > 0.05) > 0.02
    page.run("document.querySelector('[data-region=wall]').click()")
    page.settle()
    empty = page.pixels()
    assert np.mean(np.abs(empty - cut).max(axis=2) > 0.05) > 0.1  # without its one label nothing is left
    page.run("document.querySelector('[data-region=wall]').click()")
    page.at_width(390)
    assert not page.scrolls_sideways
    page.at_width(0)


def test_entries_are_written_where_a_job_has_them() -> None:
    from hpcinv.pages.reports.job_text import place_of_entries

    for text, style in (
        ("mesh: {file: a.msh}\nregions:\n    top: 'z > 1'\nmaterial: {}\n", "block"),
        ("mesh: {file: a.msh}\nregions: {top: 'z > 1'}\n", "flow"),
        ("mesh: {file: a.msh}\nregions: {}\n", "flow"),
        ("mesh: {file: a.msh}", "block"),
        ("", "block"),
    ):
        place = place_of_entries(text)
        assert place.style == style
        content = yaml.safe_load(place.with_entries(["new: 'z < 0'"]))
        old = yaml.safe_load(text) or {}
        assert content == {**old, "regions": {"new": "z < 0", **(old.get("regions") or {})}}


def test_the_page_writes_into_the_job(tmp_path: Path) -> None:
    job = tmp_path / "tube.yaml"
    job.write_text(TUBE)
    with Started(1, "show", "--edit", job, cwd=tmp_path) as server:
        server.wait_for("stop with Ctrl-C")
        (address,) = re.findall(r"edited at (http://127\.0\.0\.1:\d+/\S{32,}/)", server.text)
        with opened(address, tmp_path / "profile") as page:
            page.run("document.querySelector('[data-view=x]').click()")
            for tool, name in (("face", "mantle"), ("point", "belly")):
                page.set("tool", tool)
                page.click_canvas(3, 2)
                page.set("name", name)
                page.run("document.getElementById('add').click()")
            assert page.text("#save") == "Write into tube.yaml"
            page.run("document.getElementById('save').click()")
            WebDriverWait(page.driver, 20).until(lambda _: page.text("#written"))
            assert page.text("#written") == "written into tube.yaml"
            page.set("name", "belly")
            assert page.run("return document.getElementById('add').disabled")  # the name is taken
            assert page.complaints() == []
        written = job.read_text()
        assert [line for line in TUBE.splitlines() if line not in written.splitlines()] == TUBE.splitlines()[6:7]
        content = load(job)
        assert body_of(written, tmp_path / "copy.yaml").regions["mantle"].facet_count == 4 * LAYER
        assert [quantity.name for quantity in content.quantities] == ["belly", "top"]

        def post(path: str, *entries: tuple[str, str]) -> tuple[int, str]:
            request = urllib.request.Request(path, json.dumps({"entries": entries}).encode())
            try:
                with urllib.request.urlopen(request, timeout=20) as reply:
                    return reply.status, json.load(reply)["message"]
            except urllib.error.HTTPError as error:
                return error.code, json.load(error)["message"]

        for section, entry, text in (
            ("regions", "low: z < 1 mm", "there is a region 'low'"),
            ("regions", "deep: z < 1 s", "regions.deep"),
            ("regions", "a: z < 1 mm}\nmaterial: {}", "must be one line"),
            ("regions", "a: 'x > 0', b: {", "regions: a: "),
            ("material", "wall: {}", "must be one line of regions or quantities"),
            ("quantities", "{name: top, of: ux, at: [0, 0, 0]}", "quantities"),
            ("quantities", "{name: odd, of: ux, at: [0, 0]}", "quantities[0].at"),
        ):
            code, message = post(f"{address}save", (section, entry))
            assert (code, text in message) == (400, True), message
        assert post(address.replace(address[-10:], "x" * 10), ("regions", "a: z > 0"))[0] == 404
        assert job.read_text() == written
        server.send(signal.SIGTERM, server.ranks())
        assert server.exit_code() == 0, server.text
