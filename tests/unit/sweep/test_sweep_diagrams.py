"""Diagrams of sweeps: lines, samples, failed cases, axes, and what cannot be drawn."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree

import pytest
from helpers.sweep_report_cases import DENSITY, MU, NO_EQUILIBRIUM, bad, good, plan
from helpers.sweeps import finish

from hpcinv.__main__ import main
from hpcinv.errors import JobError
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.sweep.parameter_columns import log_uniform
from hpcinv.studies.sweep.results import finished
from hpcinv.studies.sweep.sweep_plan import Case
from hpcinv.studies.sweep.sweep_plot import is_even_in_log, plot


@pytest.fixture
def commit(tmp_path: Path) -> Iterator[Callable[[Case, CaseRecord], None]]:
    """Put a record in the store, as a process does that has solved a case."""
    with Holder(tmp_path / "store") as holder:
        ledger = Ledger(tmp_path / "store", holder)
        yield lambda case, record: finish(ledger, case.key, record)


# Diagrams


def drawn(files: Mapping[str, bytes], group: str) -> int:
    """Number of markers in a group of the SVG."""
    assert files["png"].startswith(b"\x89PNG")
    root = ElementTree.fromstring(files["svg"].decode())
    [elements] = [element for element in root.iter() if element.get("id") == group]
    return sum(element.tag.endswith("use") for element in elements.iter())


def groups(files: Mapping[str, bytes]) -> list[str]:
    return sorted(re.findall(r'id="((?:series|failed|outcome)[-\d]*)"', files["svg"].decode()))


def test_laws_are_lines_over_one_parameter_and_failed_cases_crosses(tmp_path: Path) -> None:
    laws = {name: {"set": {"material.lam": lam}} for name, lam in (("soft", 4e4), ("stiff", 9e4))}
    sweep_plan = plan(tmp_path, {"branches": laws, "name": "law"}, {"grid": {DENSITY: [1, 2, 3, 4]}})
    records = {case.key: good(quantities={"top": case.parameters[DENSITY]}) for case in sweep_plan.cases[:7]}
    records[sweep_plan.cases[2].key] = bad()  # the last is open
    files, _ = plot(sweep_plan, records.items(), "top", [DENSITY])
    assert groups(files) == ["failed", "series-0", "series-1"]
    assert [drawn(files, name) for name in groups(files)] == [1, 3, 3]
    text = files["svg"].decode()
    assert all(label in text for label in (">soft<", ">stiff<", ">failed (1)<", f">{DENSITY}<", ">top / m<"))


def test_samples_are_points_over_two_parameters(tmp_path: Path) -> None:
    axis = {"sobol": {MU: {"log-uniform": ["1 kPa", "100 kPa"]}, DENSITY: [1, 2]}, "count": 32}
    sweep_plan = plan(tmp_path, axis)
    assert log_uniform(sweep_plan) == {MU}
    records = {
        case.key: bad() if case.parameters[MU] < 1e4 else good(quantities={"top": case.parameters[DENSITY]})
        for case in sweep_plan.cases
    }
    files, _ = plot(sweep_plan, records.items(), "top", [MU, DENSITY])
    assert groups(files) == ["failed-0", "series-0"]
    assert [drawn(files, name) for name in groups(files)] == [16, 16]  # half of them are in each decade
    files, _ = plot(sweep_plan, records.items(), "failures", [MU, DENSITY])
    assert groups(files) == ["outcome-0", "outcome-1"]
    assert [drawn(files, name) for name in groups(files)] == [16, 16]
    assert f">{NO_EQUILIBRIUM} (16)<" in files["svg"].decode()


def test_a_diagram_names_the_cases_that_it_leaves_out(
    tmp_path: Path, commit: Callable[[Case, CaseRecord], None], capsys: pytest.CaptureFixture[str]
) -> None:
    """Laws have different parameters: over one of them, cases of other laws have no place."""
    branches = {
        "neo-Hooke": {
            "set": {"material": {"law": "neo-hookean", "lam": 4e4}},
            "axes": [{"grid": {MU: [1e4, 2e4, 3e4]}}],
        },
        "Yeoh": {
            "set": {"material": {"law": "yeoh", "c2": 0, "c3": 0, "kappa": 1e6}},
            "axes": [{"grid": {"material.c1": [5e3, 1e4]}}],
        },
    }
    sweep_plan = plan(tmp_path, {"branches": branches, "name": "law"})
    commit(sweep_plan.cases[0], good())
    commit(sweep_plan.cases[1], good(quantities={}))
    for case in sweep_plan.cases[3:]:
        commit(case, good())
    message = ["1 of 5 cases, not finished (neo-Hooke)", f"2 of 5 cases, without {MU} (Yeoh)"]
    message.append("1 of 5 cases, without top (neo-Hooke)")
    files, left_out = plot(sweep_plan, finished(sweep_plan, ledger_of(sweep_plan.store)), "top", [MU])
    assert left_out == message
    assert drawn(files, "series-0") == 1
    assert all(f"left out: {text}" in files["svg"].decode() for text in message)
    assert main(["sweep", "plot", str(sweep_plan.path), "top", "--over", MU, "--output", str(tmp_path / "top")]) == 0
    assert capsys.readouterr().out.splitlines()[2:] == [f"left out: {text}" for text in message]


def test_an_axis_with_a_zero_is_not_logarithmic(tmp_path: Path) -> None:
    """A grid in one branch may have a zero where another is sampled evenly in the logarithm."""
    branches = {
        "sample": {"axes": [{"random": {DENSITY: {"log-uniform": [1, 1000]}}, "count": 3}]},
        "grid": {"axes": [{"grid": {DENSITY: [0, 10]}}]},
    }
    sweep_plan = plan(tmp_path, {"branches": branches})
    records = {case.key: good() for case in sweep_plan.cases}
    files, _ = plot(sweep_plan, records.items(), "top", [DENSITY])
    assert sum(drawn(files, name) for name in groups(files)) == 5


def test_scales_are_logarithmic_where_values_are_even_in_that() -> None:
    assert is_even_in_log([1, 10, 100, 1000])
    assert is_even_in_log([2e3 * 100 ** (i / 9) for i in range(10)])
    assert not is_even_in_log([1 + i for i in range(200)])
    assert not is_even_in_log([1, 3, 10, 30])
    assert not is_even_in_log([-1, 10, 1000])


@pytest.mark.parametrize(
    ("quantity", "over", "expected"),
    [
        ("tip", [MU], "there is no quantity 'tip'. Did you mean 'top'?"),
        ("status", [MU], "there is no quantity 'status'"),
        ("top", ["material.nu"], "there is no parameter 'material.nu'. Did you mean 'material.mu'?"),
        ("top", [MU, MU], "a diagram is over one or two different parameters"),
        ("failures", [MU], "the map of failures is over two parameters"),
    ],
)
def test_impossible_diagrams_are_reported(quantity: str, over: list[str], expected: str, tmp_path: Path) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: [1e4, 2e4]}})
    with pytest.raises(JobError) as caught:
        plot(sweep_plan, [(sweep_plan.cases[0].key, good())], quantity, over)
    [problem] = caught.value.problems
    assert expected in problem


def test_without_results_there_is_not_a_diagram(tmp_path: Path) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: [1e4]}})
    with pytest.raises(JobError, match=r"no case with material\.mu is finished"):
        plot(sweep_plan, [], "seconds", [MU])
    with pytest.raises(JobError, match="no finished case has a value of unknowns"):
        plot(sweep_plan, [(sweep_plan.cases[0].key, bad())], "unknowns", [MU])
