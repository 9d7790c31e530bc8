"""Small faults that are planted to see what the tests catch: kinds, places, and tests that reach a module."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Fault, drawn, faults_of, is_program, nearest_tests, table

SOURCE = '''"""A text - with 1 + 2."""
def energy(c: float, x: float = 2.0) -> float:
    """Not 3 < 4."""
    y = mean(c, x) + 2 * x
    if x < 1 and c > 0:
        raise ValueError(f"{x + 1}")
    return -y - c / 3
'''
PLANTED = {
    ("factor", "4.0"),
    ("deleted line", "pass"),
    ("sign", "-"),
    ("dropped term", "mean(c, x)"),
    ("swapped arguments", "x, c"),
    ("factor", "/"),
    ("constant", "3"),
    ("condition", "not (x < 1 and c > 0)"),
    ("condition", "or"),
    ("bound", "<="),
    ("constant", "2"),
    ("bound", ">="),
    ("constant", "1"),
    ("sign", "(y)"),
    ("sign", "+"),
    ("dropped term", "-y"),
    ("factor", "*"),
    ("constant", "4"),
}


@pytest.fixture
def source(tmp_path: Path) -> Path:
    (tmp_path / "hpcinv" / "laws").mkdir(parents=True)
    (tmp_path / "hpcinv" / "laws" / "law.py").write_text(SOURCE)
    return Path("hpcinv/laws/law.py")


def test_all_kinds_of_faults_are_found_outside_of_texts(source: Path, tmp_path: Path) -> None:
    faults = faults_of(source, tmp_path)
    assert {(fault.kind, fault.text) for fault in faults} == PLANTED
    for fault in faults:
        assert is_program(fault, tmp_path)
        changed = fault.planted(SOURCE.encode()).decode().splitlines()
        assert sum(a != b for a, b in zip(changed, SOURCE.splitlines(), strict=True)) == 1
        assert fault.diff(tmp_path).startswith(f"hpcinv/laws/law.py: {fault.kind}\n@@ ")


def test_the_same_seed_draws_the_same_faults(source: Path, tmp_path: Path) -> None:
    first, again, other = (drawn([Path("hpcinv")], seed, 5, tmp_path) for seed in (1, 1, 2))
    assert first == again != other
    assert len(drawn([source], 1, 1000, tmp_path)) == len(faults_of(source, tmp_path))


def test_tests_that_reach_a_module_are_ordered_by_distance(tmp_path: Path) -> None:
    files = {
        "hpcinv/law.py": "",
        "hpcinv/solver.py": "from hpcinv import law",
        "tests/helpers/case.py": "def made():\n    import hpcinv.solver",
        "tests/system/test_law_command.py": "import hpcinv.law",
        "tests/unit/test_solver.py": "from hpcinv.solver import law",
        "tests/verification/test_case.py": "from helpers.case import made",
        "tests/unit/test_nothing.py": "import hpcinv.other",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    names = [str(path) for path in nearest_tests(Path("hpcinv/law.py"), tmp_path)]
    assert names == ["tests/system/test_law_command.py", "tests/unit/test_solver.py", "tests/verification/test_case.py"]


def test_commands_and_parts_on_demand_reach_the_tests_of_their_users(tmp_path: Path) -> None:
    files = {
        "hpcinv/__main__.py": "",
        "hpcinv/cli/fit.py": "",
        "hpcinv/part.py": "",
        "hpcinv/on_demand.py": "PARTS = {'part': 'hpcinv.part:Part'}",
        "tests/unit/test_fit.py": "from hpcinv.__main__ import main",
        "tests/unit/test_part.py": "from hpcinv.on_demand import PARTS",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert nearest_tests(Path("hpcinv/cli/fit.py"), tmp_path) == [Path("tests/unit/test_fit.py")]
    assert nearest_tests(Path("hpcinv/part.py"), tmp_path) == [Path("tests/unit/test_part.py")]


def test_shares_are_counted_by_folder() -> None:
    one, two = (Fault(Path(f"hpcinv/{name}/a.py"), "sign", 0, 1, "+") for name in ("effects", "model"))
    lines = list(table([(one, "killed"), (one, "survived"), (two, "killed")]))
    assert [line.split() for line in lines[1:]] == [
        ["hpcinv/effects", "1", "1", "0", "50%"],
        ["hpcinv/model", "1", "0", "0", "100%"],
        ["all", "2", "1", "0", "67%"],
    ]
