"""What the command line tells of laws and effects: complete, and examples that are right as they are printed."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest
import yaml

from hpcinv.__main__ import main
from hpcinv.effects import effects
from hpcinv.materials import laws
from hpcinv.meanings import meanings

EVERYTHING = [("laws", name, kind) for name, kind in laws().items()]
EVERYTHING += [("effects", name, kind) for name, kind in effects().items()]


@pytest.mark.parametrize(("command", "known"), [("laws", laws()), ("effects", effects())])
def test_all_are_listed_with_a_line(command: str, known: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command]) == 0
    printed = capsys.readouterr().out
    assert all(f"{name} " in printed for name in known)
    assert "``" not in printed


@pytest.mark.parametrize(("command", "name", "kind"), EVERYTHING, ids=lambda v: v if isinstance(v, str) else "")
def test_each_is_shown_with_its_parameters_and_an_example(
    command: str, name: str, kind: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, name]) == 0
    printed = capsys.readouterr().out
    table, example = printed.split("\nmaterial:" if command == "laws" else "\neffects:")
    for key in kind.model_fields.keys() - {"law", "effect"}:
        assert f"\n{key} " in table
        assert meanings(kind).get(key), f"{key} has no meaning"
    section = yaml.safe_load(f"section:{example}")["section"]
    assert kind.model_validate(section if command == "laws" else section[0])
    if command == "laws":
        assert "energy: " in table


def test_a_misspelt_name_is_refused_with_a_proposal() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hpcinv", "laws", "gentt"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.strip() == "unknown law 'gentt'. Did you mean 'gent'?"
    assert done.stdout == ""
