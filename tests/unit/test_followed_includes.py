"""Files that decks include: with --untrusted only a child process with limits follows them."""

import ast
import itertools
import os
from pathlib import Path
from typing import Never

import pytest
from helpers.command_line import hpcinv_here

import hpcinv
from hpcinv.base.mesh_formats import FORMATS, mesh_fault
from hpcinv.base.reading import bdf_files, included_files, reader_process
from hpcinv.base.reading.door import VARIABLE
from hpcinv.cli.cards import file_text
from hpcinv.errors import MeshError
from hpcinv.formats.readers import followed_includes
from hpcinv.job.resolved_job import file_digest

ROOT = Path(hpcinv.__file__).parent
LINES = {".inp": "*INCLUDE, INPUT={}\n", ".bdf": "INCLUDE '{}'\n"}
NODES = "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n"
BODY = (
    "*ELEMENT, TYPE=C3D4, ELSET=block\n1, 1, 2, 3, 4\n*NSET, NSET=base\n1, 2, 3\n*MATERIAL, NAME=a\n"
    "*HYPERELASTIC, NEO HOOKE\n1., 0.01\n*SOLID SECTION, ELSET=block, MATERIAL=a\n*BOUNDARY\nbase, 1, 3\n"
)
FOLLOWING = (
    "lines_of",
    "included_by",
    "Inclusions",
    "deck_includes",
    "FUNCTIONS",
    "inp_files",
    "inp_names",
    "inp_text",
)
"""what follows includes, by the names in the code"""


@pytest.fixture
def only_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """With --untrusted, in a process that cannot read a line of a deck."""

    def refuse(*_: object) -> Never:
        pytest.fail("includes were followed in the process of the command")

    monkeypatch.setenv(VARIABLE, "1")
    monkeypatch.setattr(included_files, "text_of", refuse)
    monkeypatch.setattr(bdf_files, "text_of", refuse)


def deck(directory: Path, suffix: str = ".inp") -> Path:
    """Write a deck in three files, one within another."""
    names = [f"{name}{suffix}" for name in ("deck", "inner", "nodes")]
    for name, included in itertools.pairwise(names):
        (directory / name).write_text(LINES[suffix].format(included) + (BODY if name == names[0] else ""))
    (directory / names[-1]).write_text(NODES if suffix == ".inp" else "$ nothing\n")
    return directory / names[0]


@pytest.mark.release
def test_only_one_module_follows_includes() -> None:
    """Outside of the readers, which child processes call."""
    for file in ROOT.rglob("*.py"):
        if file.parent.name == "reading" or file.name == "followed_includes.py":
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hpcinv.base.reading"):
                assert not {name.name for name in node.names} & set(FOLLOWING), file


@pytest.mark.release
@pytest.mark.parametrize("suffix", LINES)
def test_includes_followed_in_a_child_process_give_the_same_mesh(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    path = deck(tmp_path, suffix)
    trusted = [file_digest(path), FORMATS[suffix].groups(path), suffix == ".bdf" or file_text(path)]
    monkeypatch.setattr(followed_includes, "_known", {})
    request.getfixturevalue("only_elsewhere")
    assert mesh_fault(tmp_path, path.name) == ""
    assert [file_digest(path), FORMATS[suffix].groups(path), suffix == ".bdf" or file_text(path)] == trusted
    (tmp_path / f"nodes{suffix}").write_text("$ other\n")
    assert file_digest(path) != trusted[0]


@pytest.mark.release
@pytest.mark.usefixtures("only_elsewhere")
@pytest.mark.parametrize("suffix", LINES)
def test_a_file_that_comes_later_counts(suffix: str, tmp_path: Path) -> None:
    path = deck(tmp_path, suffix)
    (tmp_path / f"nodes{suffix}").unlink()
    before = file_digest(path)
    deck(tmp_path, suffix)
    assert file_digest(path) != before


@pytest.mark.usefixtures("only_elsewhere")
def test_hostile_trees_are_refused_by_the_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for level in range(4):  # a bomb
        (tmp_path / f"{level}.inp").write_text(LINES[".inp"].format(f"{level + 1}.inp") * 10)
    (tmp_path / "4.inp").write_text("")
    assert FORMATS[".inp"].groups(tmp_path / "0.inp") is None
    with pytest.raises(ValueError, match=r"includes more than 1,000 files"):
        file_text(tmp_path / "0.inp")
    (tmp_path / "outside.inp").write_text(LINES[".inp"].format("/etc/hostname"))
    assert mesh_fault(tmp_path, "outside.inp").startswith("has data in '/etc/hostname', which leads out of")
    (tmp_path / "circle.inp").write_text(LINES[".inp"].format("circle.inp"))
    with pytest.raises(ValueError, match=r"'circle\.inp' includes itself"):
        file_text(tmp_path / "circle.inp")
    monkeypatch.setattr(followed_includes, "_MEMORY", 64 << 20)
    (tmp_path / "sparse.inp").touch()
    os.truncate(tmp_path / "sparse.inp", 6 << 30)
    (tmp_path / "large.inp").write_text(LINES[".inp"].format("sparse.inp"))
    for name in ("sparse.inp", "large.inp"):
        assert "takes more than the 0.1 GB of memory" in mesh_fault(tmp_path, name)
        with pytest.raises(MeshError, match=r"takes more than the 0\.1 GB of memory"):
            file_digest(tmp_path / name)


def test_a_child_that_never_ends_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, program = deck(tmp_path), tmp_path / "reader.py"
    program.write_text("import time\ntime.sleep(600)")
    monkeypatch.setattr(reader_process, "_PROGRAM", program)
    monkeypatch.setattr(followed_includes, "_SECONDS", 1)
    monkeypatch.setattr(followed_includes, "_WAITING", 1)
    monkeypatch.setattr(followed_includes, "_known", {})
    assert "that takes too long" in mesh_fault(tmp_path, path.name)


@pytest.mark.release
@pytest.mark.usefixtures("only_elsewhere")
def test_commands_follow_no_includes_themselves(tmp_path: Path) -> None:
    path = deck(tmp_path)
    made = hpcinv_here(
        *("new", "job", "--untrusted", "--from", path.name, "--unit", "m", "--stress-unit", "MPa", "job.yaml"),
        cwd=tmp_path,
    )
    assert made.returncode == 0, made.stderr
    checked = hpcinv_here("validate", "--untrusted", "job.yaml", cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    laws = hpcinv_here("laws", "--untrusted", "--from", "abaqus", path.name, "--stress-unit", "MPa", cwd=tmp_path)
    assert laws.returncode == 0, laws.stderr
