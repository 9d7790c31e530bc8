"""``hpcinv dossier`` as it is typed: its context file, its evidence, and what it refuses."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.command_line import BLOCK, hpcinv_here, write_job

from hpcinv.__main__ import main
from hpcinv.studies.dossier.context import OPEN, DossierContext

JOB: Mapping[str, Any] = BLOCK | {
    "analysis": "inverse",
    "certificate": "quick",
    "sensitivities": {"material.mu": "1 kPa"},
    "output": {"fields": False},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("dossier")
    ended = hpcinv_here("run", write_job(place / "block.yaml", JOB), "--output", place / "run", cwd=place)
    assert ended.returncode == 0, ended.stderr
    return place / "run"


def text_of(page: Path) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page.read_text()))


def test_a_dossier_has_the_evidence_of_its_run(run: Path, tmp_path: Path) -> None:
    context = tmp_path / "context.yaml"
    assert main(["dossier", str(run), "--ask", str(context)]) == 0
    asked = yaml.safe_load(context.read_text())
    assert asked.keys() == DossierContext.model_fields.keys()
    assert set(asked["sources"]) == {"material.mu", "material.lam", "effects[0].acceleration", "effects[0].density"}
    asked |= {"question": "Is <b>it</b> small enough?", "influence": "high"}
    asked["sources"]["material.mu"] = "uniaxial tests"
    context.write_text(yaml.safe_dump(asked))
    page = tmp_path / "dossier.html"
    assert main(["dossier", str(run), "--context", str(context), "--output", str(page)]) == 0
    text, summary = text_of(page), json.loads((run / "summary.json").read_text())
    assert "Is &lt;b&gt;it&lt;/b&gt; small enough?" in page.read_text()
    assert "material.mu 10000 uniaxial tests" in text
    assert f"material.lam 40000 {OPEN}" in text
    assert "1 of 4 sources named" in text
    for line in summary["certificate"]["lines"]:
        assert f"{line['verdict']} {line['name']}" in text
    assert hashlib.sha256((run / "summary.json").read_bytes()).hexdigest() in text
    sd = summary["sensitivities"]["quantities"]["top"]["sd"]
    assert f"{1e3 * sd:.6g} mm by the parameters" in text
    assert "stability: unstable directions: not checked" in text  # among the limits
    assert not re.search(r"(?:src|href)=.https?:", page.read_text())


def test_empty_texts_are_marked_and_counted(run: Path) -> None:
    assert main(["dossier", str(run)]) == 0
    text = text_of(run / "dossier.html")
    assert f"question of interest {OPEN}" in text
    assert "validation activities " + OPEN in text
    (number,) = re.findall(rf"(\d+) texts are {OPEN}", text)
    assert int(number) == len(DossierContext.model_fields) - 1  # limits may be empty


def test_wrong_contexts_and_runs_are_refused(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    context = tmp_path / "context.yaml"
    for content, message in (
        ("influence: huge", "context.yaml: influence: must be '', 'low', 'medium' or 'high', not 'huge'"),
        ("autor: I", "context.yaml: autor: unknown key. Did you mean 'author'?"),
        ("validation: [{activity: a}]", "context.yaml: validation[0].agreement: is needed"),
        ("[", "context.yaml"),
    ):
        context.write_text(content)
        assert main(["dossier", str(run), "--context", str(context)]) == 2
        assert message in capsys.readouterr().err
    assert main(["dossier", str(run), "--ask", str(context)]) == 2
    assert "exists already" in capsys.readouterr().err
    for change, message in (
        ({"status": "stopped"}, "did not reach its end"),
        ({"job": {}}, "lacks what a dossier needs"),
    ):
        other = tmp_path / message[:3]
        other.mkdir()
        summary = json.loads((run / "summary.json").read_text()) | change
        (other / "summary.json").write_text(json.dumps(summary))
        assert main(["dossier", str(other)]) == 2
        assert message in capsys.readouterr().err
        assert not (other / "dossier.html").exists()
    assert main(["dossier", str(tmp_path)]) == 2
    assert "has no summary of a run" in capsys.readouterr().err
    (tmp_path / "identification.json").write_text("{}")  # of an older version, which had fewer figures
    (tmp_path / "run").symlink_to(run)
    assert main(["dossier", str(tmp_path)]) == 2
    assert re.search(r"identification lacks .*Run 'hpcinv identify' again", capsys.readouterr().err, re.DOTALL)
