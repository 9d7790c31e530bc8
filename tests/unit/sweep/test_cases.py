"""Cases of a sweep: points by their number, columns, and views of them."""

from __future__ import annotations

import itertools
import pickle
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.command_line import COLUMN

from hpcinv.errors import JobError
from hpcinv.studies.batch.axes import Axis
from hpcinv.studies.batch.points import CombinedPoints
from hpcinv.studies.sweep.sweep_plan import SweepFile, read_sweep

MU = "material.mu"


def sweep(directory: Path, axis: dict[str, Any]) -> SweepFile:
    (directory / "column.yaml").write_text(yaml.safe_dump(COLUMN))
    return read_sweep({"job": "column.yaml", "axes": [axis]}, directory)


def test_points_by_number_are_those_of_nested_loops() -> None:
    axes = [
        {"grid": {"a": [1, 2], "b": [3, 4, 5]}},
        {"branches": {"p": {"set": {"c": 6}}, "q": {"axes": [{"zip": {"d": [7, 8], "e": [9, 10]}}]}}},
    ]
    points = CombinedPoints([Axis.model_validate(axis) for axis in axes])
    expected = [
        ({"a": a, "b": b, **parameters}, {"a": a, "b": b, **settings})
        for a, b in itertools.product([1, 2], [3, 4, 5])
        for parameters, settings in (
            ({"branch": "p"}, {"c": 6}),
            ({"branch": "q", "d": 7, "e": 9}, {"d": 7, "e": 9}),
            ({"branch": "q", "d": 8, "e": 10}, {"d": 8, "e": 10}),
        )
    ]
    assert [*points] == [*map(points.__getitem__, range(len(points)))] == expected
    assert [*CombinedPoints([])] == [({}, {})]


def test_cases_take_few_bytes_and_views_of_them_none(tmp_path: Path) -> None:
    """A million of them must fit into the memory of each process."""
    cases = sweep(tmp_path, {"random": {MU: ["1 kPa", "2 kPa"]}, "count": 400}).plan().cases
    assert len(pickle.dumps(cases)) < 150 * len(cases) + 10_000
    assert [case.number for case in cases[100:200:50]] == [100, 150]
    assert [case.key for case in cases.chosen([7, 3])] == [cases[7].key, cases[3].key]
    assert [*cases.keys] == [case.key for case in cases]
    assert [*cases.numbers] == [case.numbers for case in cases]


def test_the_first_cases_are_checked_alone(tmp_path: Path) -> None:
    file = sweep(tmp_path, {"grid": {MU: ["1 kPa", "2 kPa", "-1 kPa"]}})
    assert file.case_count == 3
    assert [case.parameters[MU] for case in file.plan(2).cases] == ["1 kPa", "2 kPa"]
    with pytest.raises(JobError, match="case 2, mu -1 kPa: material: the shear modulus"):
        file.plan()
