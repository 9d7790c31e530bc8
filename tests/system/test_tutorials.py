"""Commands of the tutorials, where the project's jobs and meshes are, and the files that a page has.

Each day they run in the process of the test, with fewer cells and a quick certificate.
"""

import json
import re
import shutil
from pathlib import Path

import pytest
from helpers.typed import files, run_line, type_in

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
WITHOUT_SOLVE = re.compile(r"^sed | segmentation.py$| hpcinv (validate|sweep (plan|submit)) ")
SHORT = {"silicone-beam"}  # others take minutes
QUICKLY = re.compile(r" run (?!--certificate)(?=(jobs/pdms-beam|job).yaml)")
OWN_MESH = ROOT / "docs" / "start" / "your-own-mesh.md"
of_every_tutorial = pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)


def commands(page: Path) -> list[str]:
    blocks: list[str] = re.findall(r"^```sh\n(.*?)^```", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line and not line.startswith("#")]


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    shutil.copytree(ROOT / "jobs", tmp_path / "jobs")
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    return tmp_path


def type_all(page: Path, directory: Path, those: re.Pattern[str], *, daily: bool = True) -> None:
    for name, text in files(page).items():
        (directory / name).write_text(text)
    for line in commands(page):
        if those.search(line):
            if daily:
                run_line(QUICKLY.sub(" run --certificate quick ", line.replace('"8 mm"', '"12 mm"')), directory)
            else:
                type_in(line, directory)


@of_every_tutorial
def test_commands_without_a_solve(page: Path, directory: Path) -> None:
    type_all(page, directory, WITHOUT_SOLVE)


@pytest.mark.release
@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=() if page.stem in SHORT else pytest.mark.release, id=page.stem) for page in TUTORIALS],
)
def test_commands_of_whole_tutorials_run(page: Path, directory: Path) -> None:
    assert commands(page)
    type_all(page, directory, re.compile(""), daily=page.stem in SHORT)


@pytest.mark.everyday("True")
@pytest.mark.parametrize("daily", [True, False])
def test_the_tutorial_from_a_surface_to_a_report_runs(daily: bool, directory: Path) -> None:
    """With the ellipsoid of the page."""
    type_all(OWN_MESH, directory, re.compile(""), daily=daily)
    assert (directory / "results" / "job" / "report.html").is_file()
    summary = json.loads((directory / "results" / "job" / "summary.json").read_text())
    assert summary["certificate"]["verdict"] == "pass"
