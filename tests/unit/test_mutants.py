"""Small faults that are planted to see what the tests catch: kinds, places, and tests that reach them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest
from mutants import Results, Trial, found_failures, parsed, table
from planted_faults import Fault, drawn, faults_of, is_program
from reaching_tests import Record, distances, mask, place_of, write_sources

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
    assert distances(Path("hpcinv/law.py"), tmp_path) == {
        Path("tests/system/test_law_command.py"): 1,
        Path("tests/unit/test_solver.py"): 2,
        Path("tests/verification/test_case.py"): 3,
    }


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
    assert list(distances(Path("hpcinv/cli/fit.py"), tmp_path)) == [Path("tests/unit/test_fit.py")]
    assert list(distances(Path("hpcinv/part.py"), tmp_path)) == [Path("tests/unit/test_part.py")]


def test_shares_are_counted_by_folder() -> None:
    one, two = (Fault(Path(f"hpcinv/{name}/a.py"), "sign", 0, 1, "+") for name in ("effects", "model"))
    lines = list(table([(one, "killed"), (one, "survived"), (two, "killed")]))
    assert [line.split() for line in lines[1:]] == [
        ["hpcinv/effects", "1", "1", "0", "50%"],
        ["hpcinv/model", "1", "0", "0", "100%"],
        ["all", "2", "1", "0", "67%"],
    ]


MODULE = """from functools import cache

LIMIT = 3
class Law:
    order = 2
    @cache
    def stress(self):
        return (1 +
            2)
def strain(x=4):
    return x + LIMIT
"""


@pytest.mark.parametrize(
    ("text", "lines", "scope", "runs_at_import", "is_kept", "names"),
    [
        ("3", [3], range(1, 13), True, False, ("LIMIT",)),
        ("order = 2", [5], range(4, 10), True, False, ("order",)),
        ("2)", [9], range(4, 10), False, True, ()),
        ("4", [10], range(1, 13), True, False, ()),
        ("x + LIMIT", [11], range(1, 13), False, False, ()),
    ],
)
def test_the_place_of_a_fault_says_when_it_runs(
    text: str,
    lines: list[int],
    scope: range,
    runs_at_import: bool,
    is_kept: bool,
    names: tuple[str, ...],
    tmp_path: Path,
) -> None:
    (tmp_path / "law.py").write_text(MODULE)
    begin = MODULE.index(text)
    place = place_of(Fault(Path("law.py"), "factor", begin, begin + len(text), "0"), tmp_path)
    assert list(place.lines) == lines
    assert (place.scope, place.runs_at_import, place.is_kept, place.names) == (scope, runs_at_import, is_kept, names)
    assert list(place.statement) == ([8, 9] if is_kept else lines)


def recorded(directory: Path) -> Record:
    """Lines of `MODULE` that three tests execute, one of them also in a command that imports it."""
    (directory / "hpcinv").mkdir()
    (directory / "hpcinv" / "law.py").write_text(MODULE)
    for name in ("a", "b"):
        (directory / "tests" / "unit").mkdir(parents=True, exist_ok=True)
        (directory / "tests" / "unit" / f"test_{name}.py").write_text("import hpcinv.law")
    tests = {"test_a.py::long": (9.0, {11}), "test_a.py::short": (1.0, {11}), "test_b.py::kept": (2.0, {8, 9})}
    with (directory / "1.jsonl").open("w") as file:
        for name, (seconds, numbers) in tests.items():
            lines = {"hpcinv/law.py": f"{mask(numbers):x}"}
            print(json.dumps({"test": f"tests/unit/{name}", "seconds": seconds, "ranks": 1, "lines": lines}), file=file)
    (directory / "2.lines").write_text("\ntests/unit/test_b.py::kept\nhpcinv/law.py 11\nhpcinv/law.py 3\nhpcinv/l")
    write_sources(directory, directory)
    return Record(directory, directory)


def planted(text: str) -> Fault:
    return Fault(Path("hpcinv/law.py"), "factor", MODULE.index(text), MODULE.index(text) + len(text), "0")


def test_a_fault_is_tried_on_the_tests_that_execute_its_lines(tmp_path: Path) -> None:
    record = recorded(tmp_path)
    of_strain = ["tests/unit/test_a.py::short", "tests/unit/test_b.py::kept", "tests/unit/test_a.py::long"]
    assert record.ordered(planted("x + LIMIT")) == of_strain
    assert record.ordered(planted("3")) == of_strain  # these use the name
    assert record.ordered(planted("order = 2")) == of_strain[1:2]  # it is of this class
    assert record.changed == set()


def test_a_changed_file_has_the_tests_of_all_its_lines(tmp_path: Path) -> None:
    recorded(tmp_path)
    (tmp_path / "hpcinv" / "law.py").write_text(MODULE + "\n")
    record = Record(tmp_path, tmp_path)
    assert record.changed == {"hpcinv/law.py"}
    assert len(record.ordered(planted("2)"))) == 3


def test_results_are_continued(source: Path, tmp_path: Path) -> None:
    one, two = drawn([source], 1, 2, tmp_path)
    trial = Trial("killed", "tests/unit/test_a.py::short", 3, 8, 1.5, 60.0)
    line = {**asdict(one), "path": str(one.path), **asdict(trial)}
    (tmp_path / "results").write_text(json.dumps(line) + "\n")
    results = Results(tmp_path / "results")
    assert results[one] == trial
    assert results[two] is None


def test_tests_to_record_are_given_to_pytest() -> None:
    assert parsed(["--record", "place", "-n", "0", "tests/unit"]).record == ["place", "-n", "0", "tests/unit"]


def test_names_of_failed_tests_are_read_from_the_summary() -> None:
    output = "FAILED tests/a.py::test_b[x - y] - assert 1 == 2\nERROR tests/c.py\nFAILED nothing\n1 failed"
    assert found_failures(output, ["tests/a.py::test_b[x", "tests/a.py::test_b[x - y]"]) == [
        "tests/a.py::test_b[x - y]",
        "tests/c.py",
    ]
