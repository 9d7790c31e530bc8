"""Second opinions of FEBio: a program with its command line and its file of data stands for it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from helpers.verification import job

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.cli.second_opinion import PROGRAMS as CHOICES
from hpcinv.studies.second_opinion.febio import version
from hpcinv.studies.second_opinion.opinion import FOLDER, second_opinion
from hpcinv.studies.second_opinion.program_run import NoOpinion
from hpcinv.studies.second_opinion.programs import PROGRAMS
from hpcinv.trust.certificate import Verdict

BODY: dict[str, Any] = {
    "mesh": {"file": "../meshes/box.py", "parameters": {"lx": 0.1, "ly": 0.1, "lz": 0.2, "nx": 1, "ny": 1, "nz": 2}},
    "material": {"law": "neo-hookean", "mu": 1e4, "lam": 2e4},
    "discretisation": {"displacement": 1, "formulation": "displacement"},
    "effects": [{"effect": "gravity", "acceleration": [1, 0, -2], "density": 1000}],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "output": {"mesh": ["msh"], "fields": False},
}
STEPS = """[ "$1" = -i ] && [ "${2%.feb}" != "$2" ] || exit 9
echo "  version 4.7.0"
name="${2%.feb}"
printf '*Step  = 1\\n*Time  = 0.1\\n*Data  = displacement\\n1,0,0,0\\n' > "$name-displacement.txt"
step() {
  printf '*Step  = 10\\n*Time  = %s\\n*Data  = displacement\\n' $1
  awk -F, -v s="$2" 'NR > 1 {printf "%d,%.12g,%.12g,%.12g\\n", $1, s*($5-$2), s*($6-$3), s*($7-$4)}' \\
    "$name-expected.csv"
}
"""
"""FEBio's file of data for the displacements of the table next to the model, at a time and times a factor"""


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("first") / "run"
    hpcinv.run(job(**BODY), MPI.COMM_SELF, directory=directory, progress=False)
    return directory


@pytest.fixture
def run(first_run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(first_run, tmp_path / "run"))


def written(path: Path, script: str) -> str:
    """Write a program that is called as FEBio is, and return its command."""
    path.write_text(f"#!/bin/sh\n{STEPS}{script}\n")
    path.chmod(0o755)
    return str(path)


def verdict(run: Path) -> str:
    lines: list[dict[str, Any]] = json.loads((run / "summary.json").read_text())["certificate"]["lines"]
    [line] = [line for line in lines if line["name"] == "second opinion"]
    return str(line["verdict"])


def test_a_program_that_finds_the_given_body_agrees(run: Path, tmp_path: Path) -> None:
    program = written(tmp_path / "febio4", 'step 1 1 >> "$name-displacement.txt"')
    opinion = second_opinion(run, program, 60, name="febio")
    assert (opinion.program, opinion.element, opinion.verdict) == ("FEBio 4.7.0", "tet4", Verdict.PASS)
    assert opinion.largest < 1e-9 * opinion.displacement
    assert verdict(run) == "pass"
    assert main(["second-opinion", str(run), "--with", "febio", "--command", program]) == 0


def test_a_program_that_finds_another_body_is_a_warning(run: Path, tmp_path: Path) -> None:
    program = written(tmp_path / "febio4", 'step 1 1.01 >> "$name-displacement.txt"')
    opinion = second_opinion(run, program, 60, name="febio")
    assert opinion.largest == pytest.approx(0.01 * opinion.displacement, rel=1e-6)
    assert verdict(run) == "warning"


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("echo begun; sleep 60", "FEBio was stopped after 1 s; its last lines:\n  version 4.7.0\n  begun"),
        ('rm "$name-displacement.txt"; echo E R R O R; exit 1', "FEBio reached no load"),
        ('step 0.4 1 >> "$name-displacement.txt"; exit 1', "FEBio ended at 0.4 of the load"),
        ('step 1 1 | head -n 5 >> "$name-displacement.txt"', "FEBio printed no displacement of node"),
        ('step 1 1 | sed "s/^2,.*/2,nan,0,0/" >> "$name-displacement.txt"', "displacements that are not finite"),
        ('step 1 1 | sed "s/^1,/x,/" >> "$name-displacement.txt"', "FEBio printed no displacement of node 1;"),
    ],
)
def test_a_program_that_fails_is_not_decided(script: str, message: str, run: Path, tmp_path: Path) -> None:
    with pytest.raises(NoOpinion) as error:
        second_opinion(run, written(tmp_path / "febio4", script), 1, name="febio")
    assert message in str(error.value)
    assert str(run / FOLDER) in str(error.value)
    assert verdict(run) == "not decided"


def test_elements_of_nearly_incompressible_laws_are_not_ours(tmp_path: Path) -> None:
    law = {"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 1e8}
    hpcinv.run(job(**BODY | {"material": law}), MPI.COMM_SELF, directory=tmp_path / "run", progress=False)
    program = written(tmp_path / "febio4", 'step 1 1.2 >> "$name-displacement.txt"')
    opinion = second_opinion(tmp_path / "run", program, 60, name="febio")
    assert opinion.by_elements is None
    assert "one pressure each" in opinion.lines()[1]
    assert verdict(tmp_path / "run") == "not decided"


def test_a_missing_program_is_one_message(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["second-opinion", str(run), "--with", "febio", "--command", "no-such-program"]) == 5
    assert "no-such-program: is not installed" in capsys.readouterr().err


def test_the_command_line_has_all_programs(tmp_path: Path) -> None:
    assert tuple(PROGRAMS) == CHOICES
    assert version("febio4", tmp_path / "part.feb") == ""
