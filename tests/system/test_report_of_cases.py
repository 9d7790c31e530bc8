"""Reports of sweeps and studies: their tables, maps and shapes in a browser, and the command line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.browser import Page, needs_browser, opened
from helpers.command_line import write_job
from helpers.run_directories import run_directory, summary
from helpers.studies import plan as study_plan
from helpers.sweeps import finish

from hpcinv.__main__ import main
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.study.directory import STORE, StudyDirectory
from hpcinv.studies.study.study_page import write_study_report
from hpcinv.studies.study.study_run import StudySchedule, StudyTask
from hpcinv.studies.sweep.sweep_page import write_sweep_report
from hpcinv.studies.sweep.sweep_plan import SweepPlan, load_sweep

COUNT = 8
JOB: dict[str, Any] = {
    "job": "block",
    "analysis": "forward",
    "mesh": {"file": str(Path(__file__).parents[2] / "meshes" / "box.py")},
    "material": {"law": "neo-hookean", "young": "12 kPa", "poisson": 0.4},
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "reference"}],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    "quantities": [{"name": "tip", "of": "z", "at": [1, 1, 1]}],
}
AXES = [
    {
        "sobol": {"material.young": {"uniform": ["5 kPa", "20 kPa"]}, "material.poisson": {"uniform": [0.2, 0.4]}},
        "count": COUNT,
        "seed": 1,
    }
]
FAILED = "an element would turn inside out (det F ≤ 0)"


def finished(directory: Path) -> SweepPlan:
    """A sweep whose records are made up: soft cases fail, the last one is open, some have kept their boundary."""
    write_job(directory / "block.yaml", JOB)
    plan = load_sweep({"job": "block.yaml", "store": "store", "axes": AXES, "sweep": "soft"}, directory)
    with Holder(plan.store) as holder:
        ledger = Ledger(plan.store, holder)
        for case in plan.cases[:-1]:
            young = float(case.parameters["material.young"])
            fails = young < 7e3
            made = summary(status=FAILED) if fails else summary()
            made["quantities"] = {} if fails else {"tip": 1e3 / young}
            if not fails and case.number % 5 == 0:
                run_directory(ledger.directory(case.key) / "run-1-1", 4)
            record = CaseRecord(FAILED if fails else "converged", "Refine the mesh." if fails else "", made, 1.5, 1)
            finish(ledger, case.key, record)
    return plan


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[SweepPlan, Path]:
    directory = tmp_path_factory.mktemp("sweep")
    plan = finished(directory)
    return plan, write_sweep_report(plan, ledger_of(plan.store), directory / "pages" / "report.html", each=True)


@pytest.fixture(scope="module")
def page(sweep: tuple[SweepPlan, Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with opened(sweep[1], tmp_path_factory.mktemp("profile")) as page:
        yield page


def soft(plan: SweepPlan) -> int:
    return sum(float(case.parameters["material.young"]) < 7e3 for case in plan.cases[:-1])


@pytest.mark.release
def test_the_file_is_small_and_names_what_failed(sweep: tuple[SweepPlan, Path]) -> None:
    plan, path = sweep
    assert path.stat().st_size < 5_000_000
    text = path.read_text()
    assert f"{soft(plan)} failed: {FAILED}. Refine the mesh." in text
    assert (
        f"{COUNT - 1 - soft(plan)} of {COUNT} cases are solved without doubt, {soft(plan)} failed, 1 are open" in text
    )
    reports = list((path.parent / "cases").iterdir())
    assert len(reports) == COUNT - 1
    assert all(f'href="cases/{report.name}"' in text for report in reports[:5])


@needs_browser
def test_the_table_is_filtered_with_its_diagrams_and_sorted(sweep: tuple[SweepPlan, Path], page: Page) -> None:
    plan, _ = sweep
    visible = "return [...document.querySelectorAll('#table tbody tr:not([hidden])')].length"
    marks = "return document.querySelectorAll('#map [data-case]').length"
    lines = "return document.querySelectorAll('#parallel path[data-case]').length"
    assert [page.run(part) for part in (visible, marks, lines)] == [COUNT, COUNT, COUNT]
    page.set("filter", "status = converged, material.young > 15e3")
    stiff = sum(float(case.parameters["material.young"]) > 15e3 for case in plan.cases[:-1])
    assert [page.run(part) for part in (visible, marks, lines)] == [stiff, stiff, stiff]
    assert page.text("#filter-count") == f"{stiff} of {COUNT} cases"
    page.set("filter", "turn inside out")
    assert page.run(visible) == soft(plan)
    page.set("filter", "nothing > 2")
    assert "no column for: nothing > 2" in page.text("#filter-count")
    page.set("filter", "")
    crosses = "return document.querySelectorAll('#map path.case').length"
    assert page.run(crosses) == soft(plan)
    page.set(
        "map-y",
        page.run("return [...document.getElementById('map-y').options].find((o) => o.text.startsWith('tip')).value"),
    )
    assert page.run(marks) == COUNT - 1 - soft(plan)  # the others have no value
    column = "[...document.querySelectorAll('#table thead th')].findIndex((h) => h.textContent.startsWith('tip'))"
    page.run(f"document.querySelectorAll('#table thead button')[{column}].click()")
    values = page.run(
        f"return [...document.querySelectorAll('#table tbody tr')].map((r) => r.cells[{column}].dataset.value)"
    )
    numbers = [float(value) for value in values if value]
    assert numbers == sorted(numbers)
    assert values[: len(numbers)] == [value for value in values if value]


@needs_browser
def test_diagrams_are_not_clipped_and_marks_say_why_cases_failed(sweep: tuple[SweepPlan, Path], page: Page) -> None:
    outside = (
        "return [...document.querySelectorAll('.pair svg text')].filter((e) => {"
        "  const own = e.getBoundingClientRect(), whole = e.closest('svg').getBoundingClientRect();"
        "  return own.left < whole.left || own.right > whole.right || own.top < whole.top || own.bottom > whole.bottom;"
        "}).map((e) => e.textContent)"
    )
    assert page.run(outside) == []
    titles = page.run("return [...document.querySelectorAll('#map path.case title')].map((e) => e.textContent)")
    assert all(title.endswith(FAILED) for title in titles)
    page.at_width(390)
    try:
        assert page.run(outside) == []
        assert not page.scrolls_sideways
    finally:
        page.at_width(0)
    corner = (  # of a small picture: its opacity, which is none, so that it is seen on a dark ground
        "const image = document.querySelector('.gallery img'), canvas = document.createElement('canvas');"
        "canvas.getContext('2d').drawImage(image, 0, 0);"
        "return canvas.getContext('2d').getImageData(2, 2, 1, 1).data[3]"
    )
    assert page.run(corner) == 0


@needs_browser
def test_the_mean_shape_and_cases_are_drawn(page: Page) -> None:
    assert page.run("return document.documentElement.dataset.viewer") == "ready"
    before = page.pixels()
    page.set("colour", "deviation")
    assert (abs(page.pixels() - before).max(axis=2) > 0.05).mean() > 0.01
    assert page.run("return document.getElementById('state').options[0].text").startswith("mean of ")
    assert page.run("return [...document.querySelectorAll('.gallery img')].every((i) => i.naturalWidth > 100)")
    assert 2 <= page.run("return document.querySelectorAll('.gallery img').length") <= 5
    assert page.complaints() == []
    assert page.requests() == []


@pytest.fixture(scope="module")
def study_page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """The report of a study whose records are made up: the second run has failed, errors fall by 4 from run to run."""
    directory = tmp_path_factory.mktemp("study")
    plan = study_plan(directory, repeat=1)
    store = StudyDirectory(directory / "out", plan.study.study).path / STORE
    with Holder(store) as holder:
        schedule = StudySchedule(plan, Ledger(store, holder), 0.0, 1)
        for number in range(5):
            task = schedule.next()
            assert isinstance(task, StudyTask)
            made = summary()
            made["quantities"] = {"length": 1.0802799 + 0.1 / 4**number}
            made["timings"]["total"] = 2.0**number
            failed = CaseRecord(FAILED, "Refine the mesh.", {}, 1.0, 1)
            record = failed if number == 1 else CaseRecord("converged", "", made, 1.0, 1)
            assert schedule.executions.ledger.commit(task.claim, record)
        assert schedule.next() is None
        path = write_study_report(schedule.executions, directory / "report.html")
    assert path.stat().st_size < 5_000_000
    with opened(path, tmp_path_factory.mktemp("profile")) as page:
        yield page


@needs_browser
def test_a_study_has_its_diagrams_its_fronts_and_a_table(study_page: Page) -> None:
    page = study_page
    assert "4 of 5 runs converged" in page.text("main")
    assert "Pareto front of length, from fast to accurate: P2, 1; P2, 4; P3, 1; P3, 2." in page.text("main")
    assert page.run("return [...document.querySelectorAll('figure img')].every((i) => i.naturalWidth > 100)")
    assert page.run("return document.querySelectorAll('figure img').length") >= 1
    visible = "return [...document.querySelectorAll('#table tbody tr:not([hidden])')].length"
    assert page.run(visible) == 5
    page.set("filter", "status = converged")
    assert page.run(visible) == 4
    assert page.run("return document.querySelectorAll('#map path.case').length") == 0
    page.set("filter", "")
    assert page.complaints() == []
    assert page.requests() == []


def test_reports_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run, a sweep without a case yet, a study that has not begun, and what is none of these."""
    monkeypatch.chdir(tmp_path)
    run_directory(tmp_path / "run", 3)
    assert main(["report", "run", "--output", "page.html"]) == 0
    assert capsys.readouterr().out == "page.html\n"
    assert "block &lt;&amp;&gt; beam" in (tmp_path / "page.html").read_text()
    write_job(tmp_path / "block.yaml", JOB)
    (tmp_path / "sweep.yaml").write_text("sweep: s\njob: block.yaml\naxes: [{grid: {material.poisson: [0.2, 0.3]}}]\n")
    assert main(["report", "sweep.yaml"]) == 0
    assert "2 are open" in Path(capsys.readouterr().out.strip()).read_text()
    series = "series: [{name: a, vary: {material.poisson: [0.2, 0.3]}}]"
    (tmp_path / "study.yaml").write_text(
        f"study: s2\njob: block.yaml\n{series}\nmeasure: [tip]\nreference: {{tip: 1 m}}\n"
    )
    (tmp_path / "empty").mkdir()
    for arguments, message in (
        (["empty"], "has no summary of a run"),
        (["nothing"], "no such file or directory"),
        (["block.yaml"], "is neither a sweep nor a study"),
        (["study.yaml"], "results/s2: no such directory"),
        (["run", "--cases"], "--cases is for sweeps"),
        (["run", "--output", "page.pdf"], "reports are HTML files"),
        (["run", "--output", "no/page.html"], "cannot be written"),
    ):
        assert main(["report", *arguments]) == 2, arguments
        assert message in capsys.readouterr().err
