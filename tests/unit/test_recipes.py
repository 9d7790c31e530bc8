"""The recipes "Add a …" of CONTRIBUTING.md, typed into a copy of the package from the text of the page alone."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import BLOCK, environment, write_job

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.slow


def type_recipes(copy: Path) -> None:
    """Write the files and lines that the page shows."""
    for path, code in re.findall(r"<!-- file: (hpcinv/\S+) -->\n```python\n(.*?)```", PAGE, re.DOTALL):
        assert not (copy / path).exists(), f"{path} is already there"
        (copy / path).write_text(code)
    lines = r"<!-- in: (\S+), (above|below): (.*?) -->\n```python\n(.*?)```"
    for path, place, text, code in re.findall(lines, PAGE, re.DOTALL):
        before = (copy / path).read_text().splitlines(keepends=True)
        (number,) = (i for i, line in enumerate(before) if line.strip().startswith(text))
        before.insert(number + (place == "below"), code)
        (copy / path).write_text("".join(before))


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package and of what its generated pages are made of, with all recipes."""
    copy = tmp_path_factory.mktemp("recipes")
    shutil.copytree(ROOT / "hpcinv", copy / "hpcinv", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "docs", copy / "docs", ignore=shutil.ignore_patterns("__pycache__", "pictures"))
    for name in ("jobs", "meshes", "tests", "benchmarks"):
        (copy / name).symlink_to(ROOT / name)
    type_recipes(copy)
    return copy


def typed(copy: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *map(str, arguments)]
    variables = environment() | {"PYTHONPATH": str(copy)}
    return subprocess.run(command, cwd=copy, env=variables, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def generated(copy: Path) -> Path:
    """The directory of the pages, after docs/generate.py."""
    done = typed(copy, "docs/generate.py")
    assert done.returncode == 0, done.stderr
    return copy / "docs" / "reference"


@pytest.fixture(scope="module")
def summary(copy: Path) -> dict[str, Any]:
    """One run with the law, the effect, the quantity, the line of the certificate and the unit."""
    job = write_job(
        copy / "job.yaml",
        BLOCK,
        analysis="forward",
        material={"law": "biderman", "c1": "4 kPa", "c2": "1 kPa", "d": "1 kPa", "kappa": "50 kPa"},
        effects=[{"effect": "drag", "region": "z1", "traction": ["1 ozf/m^2", 0, 0]}],
        quantities=[
            {"name": "pull", "of": "reaction", "on": "z0"},
            {"name": "stress", "of": "mises_plane", "at": [0.5, 0.5, 0.5]},
            {"name": "parts", "of": "sqrt(sxx^2 - sxx*syy + syy^2 + 3*sxy^2)", "at": [0.5, 0.5, 0.5]},
        ],
    )
    done = typed(copy, "-c", ALL, job)
    assert done.returncode == 0, done.stdout + done.stderr
    (copy / "screen.txt").write_text(done.stdout)
    content: dict[str, Any] = json.loads((copy / "results" / "summary.json").read_text())
    return content


def test_a_law(summary: dict[str, Any], generated: Path) -> None:
    assert summary["status"] == "converged"
    page = (generated / "laws.md").read_text()
    assert "## biderman" in page
    assert "{stress-plot} biderman" in page


def test_an_effect_and_a_unit(summary: dict[str, Any], generated: Path) -> None:
    """The support carries the traction, of an ounce of force on the unit area, but for the rotation of the face."""
    ounce = 9.80665 * 0.45359237 / 16
    assert summary["quantities"]["pull"] == pytest.approx([-ounce, 0, 0], abs=1e-3 * ounce)
    assert "## drag" in (generated / "effects.md").read_text()


def test_a_quantity(summary: dict[str, Any], generated: Path) -> None:
    assert summary["quantities"]["stress"] == pytest.approx(summary["quantities"]["parts"], rel=1e-12)
    assert "`mises_plane`" in (generated / "functions.md").read_text()


# One process, since its start takes longer than what it does.
ALL = """
import sys

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.updates import UPDATES
from hpcinv.job.job import Job

code = main(["run", sys.argv[1], "--output", "results"]) or main(["report", "results"]) or main(["gravity", "moon"])
rule = UPDATES["harmonic"](1.0, 0, lambda a, b: a * b)
print(rule.step(0.0, 8.0), rule.step(0.0, 8.0), "harmonic" in str(Job.model_json_schema()["properties"]["method"]))
job = hpcinv.Job.model_validate({
    "job": "glued",
    "mesh": {"file": "meshes/two_blocks.py", "parameters": {"lower": 1, "upper": 1}},
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "discretisation": {"displacement": 1},
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0.01, -0.05]}],
    "interfaces": [{"between": ["bottom", "top"], "kind": "contact", "friction": 0.1, "closure": "glued"}],
})
print(hpcinv.run(job, progress=False).solutions[0].contacts[0].assumption)
sys.exit(code)
"""


@pytest.fixture
def screen(summary: dict[str, Any], copy: Path) -> str:
    return (copy / "screen.txt").read_text()


def test_a_method(screen: str) -> None:
    assert "\n-8.0 -4.0 True\n" in screen


def test_a_closure(screen: str, generated: Path) -> None:
    assert "were glued there (assumed" in screen
    assert "| `glued` |" in (generated / "closures.md").read_text()


def test_a_command(screen: str, generated: Path) -> None:
    assert "\n1.62\n" in screen
    assert "## hpcinv gravity" in (generated / "commands.md").read_text()


def test_a_line_of_the_certificate(summary: dict[str, Any], copy: Path, generated: Path) -> None:
    lines = {line["name"]: line for line in summary["certificate"]["lines"]}
    line = lines["displacement relative to the body"]
    assert line["verdict"] == "pass"
    assert 0 < line["value"] < 1e-3
    assert line["meaning"] == "How far the body moves, relative to its size."
    assert line["meaning"] in (copy / "results" / "report.html").read_text()
    assert "displacement relative to the body" in (copy / "screen.txt").read_text()
    assert "| displacement relative to the body |" in (generated / "certificate-lines.md").read_text()
