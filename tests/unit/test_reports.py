"""Reports by themselves: arrays, decimated surfaces, sizes, words, and directories without a run."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.run_directories import SIZE, boundary, cube, interior, run_directory, summary

from hpcinv.errors import OutputError
from hpcinv.job.quantity_of_interest import is_of_nodes
from hpcinv.output.surfaces.boundary_surface import NAME, read_boundary
from hpcinv.output.surfaces.decimation import decimated
from hpcinv.output.surfaces.snapshots import NAME as SNAPSHOTS
from hpcinv.output.surfaces.snapshots import Snapshot, read_snapshots, write_snapshot
from hpcinv.pages.reports.charts import convergence_chart, load_chart
from hpcinv.pages.reports.packed_arrays import PackedArrays
from hpcinv.pages.reports.run_page import run_page, write_run_report
from hpcinv.pages.reports.wording import words
from hpcinv.trust.certificate import TOPICS, Line, Verdict
from hpcinv.trust.certificate.stability import STABILITY


def decoded(spec: dict[str, Any], text: str) -> np.ndarray:
    """What ``viewer/src/arrays.js`` does."""
    content = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(2, -1).astype(np.uint16)
    steps = (content[0] + 256 * content[1]).reshape(spec["components"], spec["rows"])
    levels = np.cumsum(steps, axis=1, dtype=np.uint16)
    return (np.array(spec["low"])[:, None] + levels / 65535 * np.array(spec["span"])[:, None]).T


def test_arrays_keep_numbers_to_a_part_of_their_range() -> None:
    arrays, random = PackedArrays(), np.random.default_rng(1)
    values = random.normal(size=(1000, 3)) * [1e-9, 1.0, 1e9]
    whole = random.integers(0, 65536, size=(500, 3))
    constant = np.full(7, 3.25)
    for kept in (arrays.add(values), arrays.add(constant), arrays.add(np.array([1.0, np.nan]))):
        assert kept == arrays.specs.index(arrays.specs[kept])
    arrays.add_whole(whole)
    decoded_arrays = [decoded(*packed) for packed in zip(arrays.specs, arrays.texts(), strict=True)]
    assert (np.abs(decoded_arrays[0] - values).max(axis=0) <= np.ptp(values, axis=0) / 65535).all()
    assert np.array_equal(decoded_arrays[1][:, 0], constant)
    assert np.array_equal(decoded_arrays[3], whole)


@pytest.mark.parametrize("most", [300, 2_000])
def test_a_large_surface_keeps_some_of_its_points_and_its_shape(most: int) -> None:
    points, triangles = cube(40)
    small = decimated(points, triangles, most)
    again = decimated(points, triangles, most)
    assert np.array_equal(small.points, again.points)
    assert most / 4 < len(small.points) <= most
    corners = points[small.points][small.triangles]
    volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume == pytest.approx(SIZE**3, rel=0.1)
    middles, expected = corners.mean(axis=1), points[triangles[small.rows]].mean(axis=1)
    assert np.linalg.norm(middles - expected, axis=1).max() < 3 * SIZE / np.sqrt(most / 6)


def test_a_thin_plate_keeps_both_sides() -> None:
    points, triangles = cube(30)
    small = decimated(points * [1, 1, 0.01], triangles, 400)
    heights = points[small.points][:, 2]
    assert {heights.min(), heights.max()} == {0.0, SIZE}
    corners = points[small.points][small.triangles]
    # The others are on the rim; if the two sides were one, nearly all would lead from one to the other.
    assert (corners[:, :, 2].max(axis=1) == corners[:, :, 2].min(axis=1)).mean() > 0.6


@pytest.mark.release
def test_a_large_body_makes_less_than_ten_megabytes() -> None:
    made = boundary(58, ("a", "b", "c"))
    assert len(made.points) > 20_000
    random = np.random.default_rng(0)
    rough = [  # nothing that compresses
        type(entry)(
            **vars(entry) | {"stress": random.normal(size=entry.stress.shape), "J": random.normal(size=entry.J.shape)}
        )
        for entry in made.results
    ]
    made = type(made)(**vars(made) | {"results": tuple(rough)})
    rows = np.arange(len(made.points))
    steps = [Snapshot(0, k, "a", k / 30, np.nan, rows, random.normal(size=made.points.shape)) for k in range(1, 30)]
    inside = interior(21, ("a", "b", "c"))
    assert len(inside.tetrahedra) > 50_000
    rough = [replace(entry, stress=random.normal(size=entry.stress.shape)) for entry in inside.results]
    page = run_page(summary(("a", "b", "c")), made, steps, replace(inside, results=tuple(rough)))
    assert len(page) < 10_000_000
    assert b'"decimated":false' in page


def test_a_larger_surface_is_drawn_with_fewer_points_and_says_so() -> None:
    made = boundary(70)
    page = run_page(summary(), made, []).decode()
    assert "The surface has 29,402 points" in page
    assert len(page) < 5_000_000


@pytest.mark.release
def test_text_of_users_is_not_executed(tmp_path: Path) -> None:
    run = run_directory(tmp_path / "run", 3)
    content = json.loads((run / "summary.json").read_text())
    attack = "</script><script>alert(1)</script>"
    content["job"]["job"] = attack
    content["certificate"]["lines"][0]["note"] = attack
    page = run_page(content, boundary(3), []).decode()
    assert "alert(1)</script>" not in page
    assert len(re.findall("<script", page)) == len(re.findall("</script>", page))


@pytest.mark.release
def test_the_page_names_no_other_file() -> None:
    page = run_page(summary(), boundary(3), []).decode()
    markup = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.findall(r'(?:src|href)="(?!data:|#)', markup)
    assert "three.js" in page
    assert "Permission is hereby granted" in page


def changed(run: Path, change: Any) -> None:
    """Write the boundary of a run again, with other arrays."""
    with np.load(run / NAME) as file:
        arrays = dict(file)
    change(arrays)
    np.savez_compressed(run / NAME, **arrays)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda run: (run / "summary.json").unlink(), "has no summary of a run"),
        (lambda run: (run / "summary.json").write_text("{"), "has no summary of a run"),
        (lambda run: (run / "summary.json").write_text('{"status": 1}'), "has no summary of a run"),
        (lambda run: (run / NAME).write_bytes(b"PK\x03\x04"), r"surface\.npz: cannot be read"),
        (
            lambda run: changed(run, lambda arrays: arrays.pop("result:0:stretches")),
            "has no stretches: another version",
        ),
        (
            lambda run: changed(run, lambda arrays: arrays.update(pores=arrays["points"])),
            "has pores, which this version",
        ),
        (lambda run: changed(run, lambda arrays: arrays.update(points=arrays["points"][:9])), "do not fit together"),
        (lambda run: (run / SNAPSHOTS / "000-000001.npz").write_bytes(b""), r"000-000001\.npz: cannot be read"),
    ],
)
def test_damaged_directories_get_a_message(damage: Any, message: str, tmp_path: Path) -> None:
    run = run_directory(tmp_path / "run", 3)
    damage(run)
    try:
        content = json.loads((run / "summary.json").read_text())
    except (OSError, ValueError):
        content = None
    with pytest.raises(OutputError, match=message):
        write_run_report(run, content)
    assert not (run / "report.html").exists()


def test_a_file_with_changed_bytes_gets_a_message_or_is_read(tmp_path: Path) -> None:
    path = run_directory(tmp_path / "run", 2) / NAME
    content, numbers = path.read_bytes(), np.random.default_rng(1)
    refused = 0
    for place in numbers.integers(len(content), size=100):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x5A]) + content[place + 1 :])
        try:
            read_boundary(path)
        except OutputError:
            refused += 1
    assert refused > 20


def test_a_summary_without_a_part_gets_a_message(tmp_path: Path) -> None:
    run = run_directory(tmp_path / "run", 3)
    content = summary()
    del content["certificate"]["lines"]
    with pytest.raises(OutputError, match="does not have what a report needs"):
        write_run_report(run, content)


def test_a_run_without_a_shape_has_a_report(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    path = write_run_report(tmp_path / "run", summary(status="stopped by a signal"))
    assert "No shape was kept" in path.read_text()
    with pytest.raises(OutputError, match="reports are HTML files"):
        write_run_report(tmp_path / "run", summary(), tmp_path / "report.txt")


def test_snapshots_are_thinned(tmp_path: Path) -> None:
    points, values = np.arange(4), np.random.default_rng(0).normal(size=(4, 3))
    for solves in range(1, 12):
        write_snapshot(tmp_path / SNAPSHOTS, Snapshot(0, solves, "", solves / 12, np.nan, points, values * solves), 5)
    snapshots = read_snapshots(tmp_path / SNAPSHOTS)
    assert len(snapshots) <= 5
    assert snapshots[-1].solves == 11
    assert np.diff([snapshot.solves for snapshot in snapshots]).max() <= 5
    for snapshot in snapshots:
        assert np.allclose(snapshot.displacement, values * snapshot.solves, atol=1e-3)


@pytest.mark.parametrize("verdict", ["pass", "not checked", "not decided", "warning", "fail"])
def test_each_verdict_has_words(verdict: str) -> None:
    content = summary()
    content["certificate"]["verdict"] = content["certificate"]["lines"][0]["verdict"] = verdict
    said = words(content, overlapping=False)
    assert said.verdict == verdict
    assert said.next
    assert ("Use the shape" in said.next[0]) == (verdict == "pass")
    assert said.finding.startswith("The certificate fails") == (verdict == "fail")


def test_a_passing_run_with_a_warning_in_its_log_asks_to_read_it() -> None:
    content = summary()
    content["certificate"]["verdict"] = content["certificate"]["lines"][0]["verdict"] = "pass"
    content["body"] = {"warnings": ["the body is 2 km long"]}
    said = words(content, overlapping=False)
    assert said.verdict == "warning"
    assert said.next[0].startswith("Read the warnings")
    assert said.next[-1] == "The body is 2 km long."


@pytest.mark.parametrize(("estimate", "is_said"), [({"shape": 1e-5}, True), ({"shape": 1e-2}, False), (None, False)])
def test_mesh_and_surface_are_compared_where_both_errors_are_known(estimate: Any, is_said: bool) -> None:
    content = summary() | {"surface_errors": {"shape": {"sd": 1e-3}}}
    content["certificate"] |= {"verdict": "warning", "estimate": estimate and {"quantities": {}} | estimate}
    assert any("finer mesh does not help" in text for text in words(content, overlapping=False).next) == is_said


def test_lines_that_do_not_pass_have_one_remedy_of_one_row() -> None:
    for topic in TOPICS.values():
        assert topic.meaning.endswith(".")
        for verdict in (Verdict.FAIL, Verdict.WARN, Verdict.UNDECIDED):
            text = Line(topic.placed("x0"), None, "", "", verdict).remedy
            assert text.count(". ") == 0
            assert text.endswith(".") or not topic.remedy
            assert len(text) <= 96
        assert Line(topic, None, "", "", Verdict.PASS).remedy == ""
    failed = Line(STABILITY, None, "", "", Verdict.FAIL)
    assert failed.remedy != replace(failed, verdict=Verdict.UNDECIDED).remedy


def test_charts_show_each_iteration_and_leave_out_what_has_no_place() -> None:
    def iteration(correction: float | None, *, new: bool) -> dict[str, object]:
        return {"correction": correction, "state": 2.0, "residual": correction, "new_tangent": new}

    first = {
        "load": 0.5,
        "iterations": [iteration(1e-3, new=True), iteration(1e-9, new=False), iteration(0.0, new=True)],
    }
    second = {"load": 1.0, "iterations": [iteration(1e-2, new=True), iteration(None, new=True)]}
    chart = convergence_chart([first, second], "Newton's <method>")
    assert chart.startswith('<svg class="chart" role="img" aria-label="Newton&#x27;s &lt;method&gt;" viewBox=')
    marks = re.findall(r'<use xlink:href="#(\w+)" [^>]*stroke: var\(--c0\)', chart)
    assert len(marks) == 3 + 1  # and one in the legend
    assert len({*marks}) == 2  # full and empty
    assert convergence_chart([{"load": 1.0, "iterations": []}], "t") == ""
    assert convergence_chart([{"load": 1.0, "iterations": [iteration(0.0, new=True)]}], "t") == ""
    assert load_chart([first], "t") == ""
    assert load_chart([first, second], "t").count("<use ") > 2
    for text in (chart, load_chart([first, second], "t")):
        ElementTree.fromstring(text.replace("<svg ", '<svg xmlns:xlink="x" ', 1))
        assert "<style" not in text
        assert "#01000" not in text


@pytest.mark.parametrize(
    ("quantity", "of_nodes"),
    [
        ({"of": "Z", "on": "top", "reduce": "mean"}, True),
        ({"of": "ux**2", "on": "top", "reduce": "rms", "over": None}, True),
        ({"of": "Z", "on": "top", "reduce": "mean", "over": "reference"}, False),
        ({"of": "Z", "on": "top", "reduce": "max"}, False),
        ({"of": "Z", "at": [0, 0, 1]}, False),
        ({"of": "szz - p", "on": "top", "reduce": "mean"}, False),
        ({"of": "2*height", "on": "top", "reduce": "mean"}, True),
        ({"of": "2*share", "on": "top", "reduce": "mean"}, False),
    ],
)
def test_means_of_nodes_and_means_over_a_body_are_distinguished(quantity: dict[str, Any], of_nodes: bool) -> None:
    let = {"height": "Z - z", "share": "height*slope", "slope": "J**2"}
    assert is_of_nodes(quantity, let) == of_nodes
