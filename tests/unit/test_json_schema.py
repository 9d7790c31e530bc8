"""The JSON Schema for editors accepts what `validate` accepts, and refuses what that refuses for its structure."""

from __future__ import annotations

import copy
import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import ROOT
from helpers.schemas import kind_of, refusals

from hpcinv.errors import JobError
from hpcinv.job.job import Job, parse
from hpcinv.job.yaml_reader import read_yaml

SHIPPED = sorted((ROOT / "jobs").glob("*.yaml"))


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.name)
def test_shipped_files_are_valid_by_the_schema(file: Path) -> None:
    assert refusals(read_yaml(file)) == []


MATERIAL = {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}
SCAN = {"image": "scan.nii.gz", "labels": {"liver": 5, "vessels": [7, 8]}, "size": "5 mm", "unit": "mm"}


@pytest.mark.parametrize(
    "mesh",
    [
        SCAN,
        {"surface": "part.stl", "unit": "mm", "size": "5 mm", "surface_error": {"sd": "0.1 mm"}},
        {"surfaces": {"wall": ["outer.stl", "inner.stl"], "core": "core.stl"}, "unit": 1e-3, "size": 0.01},
        {"file": "a.msh", "unit": "cm"},
    ],
)
def test_all_sources_of_meshes_are_valid(mesh: dict[str, Any]) -> None:
    assert refusals({"mesh": mesh, "material": MATERIAL}) == []


@pytest.mark.parametrize(
    "change",
    [
        {"mesh": {"file": "a.msh", "image": "scan.nii"}},
        {"mesh": {"unit": "mm"}},
        {"mesh": {"file": "a.msh", "unit": 0}},
        {"mesh": {"file": "a.msh", "sizes": 1}},
        {"material": {"law": "neo-hooke"}},
        {"material": {"mu": "10 kPa"}},
        {"effects": [{"effect": "gravity", "density": 1}]},
        {"effects": {"effect": "gravity"}},
        {"supports": [{"region": "x0"}]},
        {"supports": [{"region": "x0", "fix": ["x"], "displacement": [0, 0, 0]}]},
        {"fibres": {"f": {"given_on": "reference"}}},
        {"fibres": {"f": {"given_on": "reference", "data": "a", "direction": [1, 0, 0]}}},
        {"quantities": [{"of": "x"}]},
        {"checkpoint": {"every": True}},
        {"solver": {"strategy": "quick"}},
        {"colour": "red"},
    ],
)
def test_faults_of_structure_are_refused_by_both(change: dict[str, Any]) -> None:
    good = {"mesh": {"file": str(ROOT / "meshes" / "box.py")}, "material": MATERIAL}
    assert refusals(good) == []
    assert refusals(good | change) != []
    with pytest.raises(JobError):
        parse(good | change, ROOT / "jobs" / "job.yaml")


_STRUCTURE = re.compile(r"unknown key|is needed(: |$)|must be (a list|text|a mapping|true or false|a whole number)")
_OTHERS: tuple[Any, ...] = (True, [[[]]], {"colour": {"red": 1}})
"""values that hardly any key can have"""


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Containers in a value, with each of their keys."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in entries:
        yield value, key
        yield from places(entry)


def damaged(content: dict[str, Any], dice: random.Random) -> dict[str, Any]:
    """A copy with one key left out or misspelt, or another value at it."""
    changed_content = copy.deepcopy(content)
    owner, key = dice.choice(list(places(changed_content)))
    match dice.choice(("other", "other", "without", "misspelt")):
        case "without":
            del owner[key]
        case "misspelt" if isinstance(owner, dict):
            owner[f"{key}x"] = owner.pop(key)
        case _:
            owner[key] = dice.choice(_OTHERS)
    return changed_content


def test_schema_and_validate_agree_on_damaged_jobs() -> None:
    dice = random.Random(40)
    jobs = [(file, content) for file in SHIPPED if kind_of(content := read_yaml(file)) is Job]
    differences = []
    for _ in range(200):
        file, content = dice.choice(jobs)
        changed = damaged(content, dice)
        problems: tuple[str, ...] = ()
        try:
            parse(changed, file)
        except JobError as error:
            problems = error.problems
        said = refusals(changed)
        if said and not problems:
            differences.append(f"{file.name}: only the schema refuses: {said[0]}")
        # Only the generator knows which values its parameters may have.
        of_structure = [text for text in problems if _STRUCTURE.search(text) and "mesh.parameters." not in text]
        if of_structure and not said:
            differences.append(f"only validate refuses: {of_structure[0]}")
    assert differences == []
