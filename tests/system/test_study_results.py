"""Results of studies: costs, statistics, errors, orders and published numbers."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.studies import plan
from helpers.study_runs import BAD, Begin, drain, good, reused

from hpcinv.errors import JobError, SolveError
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.study.directory import StudyDirectory
from hpcinv.studies.study.findings import accuracy, front
from hpcinv.studies.study.references import fitted_order, orders, richardson
from hpcinv.studies.study.result_rows import rows_of
from hpcinv.studies.study.study_plan import StudyPlan
from hpcinv.studies.study.study_report import not_refined
from hpcinv.studies.study.study_run import StudyTask, conclude
from hpcinv.studies.study.work_precision import work_precision

# Numbers


def test_no_other_point_beats_those_of_the_pareto_front() -> None:
    points = [(1.0, 9.0), (2.0, 5.0), (2.0, 6.0), (3.0, 5.0), (4.0, 1.0), (None, 0.1), (0.5, None), (4.0, 1.0)]
    assert front(points) == [True, True, False, False, True, False, False, True]


@pytest.mark.parametrize("sizes", [(0.4, 0.2, 0.1), (0.5, 0.3, 0.22)])
@pytest.mark.parametrize("order", [0.8, 1.7, 4.0])
def test_richardson_finds_limit_and_order_on_meshes_of_any_sizes(sizes: tuple[float, ...], order: float) -> None:
    limit, observed_order = richardson(sizes, [2.0 - 3.0 * h**order for h in sizes])
    assert limit == pytest.approx(2.0, abs=1e-10)
    assert observed_order == pytest.approx(order, abs=1e-9)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ((1.0, 1.2, 1.1), "are not monotone"),
        ((1.0, 1.1, 1.1), "are not monotone"),
        ((1.0, 1.1, 1.2), "do not come closer"),
        ((1.0, 1.1, 1.3), "do not come closer"),
        ((1.0, 1.1, 1.1 + 1e-16), "are not monotone"),
        ((0.0, 1.0, 1.0 + 2e-16), "have converged too far"),
    ],
)
def test_richardson_refuses_values_that_do_not_converge(values: tuple[float, ...], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        richardson((0.4, 0.2, 0.1), values)


def test_orders_are_slopes_between_runs_and_through_all() -> None:
    sizes, errors = [0.4, 0.2, 0.1, 0.05], [0.16, 0.02, None, 0.0]
    assert orders(sizes, errors) == [None, pytest.approx(3.0), None, None]
    assert fitted_order([0.4, 0.2, 0.1], [5 * h**2.5 for h in (0.4, 0.2, 0.1)]) == pytest.approx(2.5)
    # ln e = 0, 2, 1 at ln h = 0, 1, 2: covariance 1 over variance 2.
    assert fitted_order(np.exp([0, 1, 2]), np.exp([0, 2, 1])) == pytest.approx(0.5)
    assert fitted_order([0.1, 0.1], [1.0, 2.0]) is None


def test_values_are_taken_from_the_same_case_of_an_earlier_series(begin: Begin, tmp_path: Path) -> None:
    taken = {"series": "direct", "key": "errors.gap", "at_least": 1e-11}
    series = [{"name": "direct"}, {"name": "to its accuracy", "take": {"solver.tolerance": taken}}]
    cases = [{"grid": {"material.mu": [1e4, 2e4, 3e4, 4e4]}}]
    schedule = begin(plan(tmp_path, series=series, cases=cases, repeat=1), tmp_path)
    outcomes = {1e4: good(1.0, errors={"gap": 1e-5}), 2e4: good(1.0, errors={"gap": 0.0}), 3e4: BAD, 4e4: good(1.0)}
    tolerances = []
    while isinstance(task := schedule.next(), StudyTask):
        waits = not task.title.startswith("direct")
        tolerances += [task.job.solver.tolerance] if waits else []
        (law,) = task.job.laws.values()
        record = good(1.0) if waits else outcomes[law.mu]  # type: ignore[attr-defined]
        assert schedule.executions.ledger.commit(task.claim, record)
    assert tolerances == [1e-5, 1e-11]
    assert reused(begin(schedule.executions.plan, tmp_path)) == 6
    why = [row.status for row in rows_of(schedule.executions) if row.place.series != "direct"]
    assert why[:2] == ["converged", "converged"]
    assert why[2] == "not run: solver.tolerance is taken from series 'direct', which has failed"
    assert why[3].endswith("has no number at errors.gap")


def rows_and_accuracy(begin: Begin, plan: StudyPlan, directory: Path, records: list[CaseRecord]) -> Any:
    schedule = begin(plan, directory)
    drain(schedule, iter(records))
    rows = rows_of(schedule.executions)
    return rows, accuracy(plan, rows, plan.study.measure[0], "m")


def test_costs_are_medians_without_compilation_and_certificate(begin: Begin, tmp_path: Path) -> None:
    study = plan(tmp_path, series=[{"name": "P2"}], costs={"gap": "errors.gap"}, time="solver")
    more = {"compile_": 0.5, "errors": {"gap": 4.0}}
    records = [good(1.0, compiled=True, total=90.0, **more), *(good(1.0, total=t, **more) for t in (3.0, 9.0, 2.0))]
    [row], _ = rows_and_accuracy(begin, study, tmp_path, records)
    assert row.costs["run"] == pytest.approx(3.0 - 0.5 - 0.05)
    assert row.costs["solver"] == row.time == pytest.approx(0.3)
    assert (row.costs["gap"], row.costs["memory"], row.costs["factorizations"]) == (4.0, 200.0, 2.0)
    assert len(row.times) == 3


def test_statistics_over_cases_and_the_ratio_of_times(begin: Begin, tmp_path: Path) -> None:
    series = [{"name": "base"}, {"name": "other", "base": "base", "set": {"discretisation.displacement": 3}}]
    cases = [{"grid": {"material.mu": [1, 2, 3, 4]}}]
    study = plan(tmp_path, series=series, cases=cases, repeat=1, reference=10)
    records = [
        record
        for e, t in ((1.0, 2.0), (2.0, 3.0), (3.0, 5.0), (6.0, 7.0))
        for record in (good(10 - e, total=1.05), BAD if e == 3.0 else good(10 + 2 * e, total=t + 0.05))
    ]
    _, accuracies = rows_and_accuracy(begin, study, tmp_path, records)
    base, other = accuracies.points
    assert base.errors == pytest.approx((1, 2, 3, 6))
    names = ("average", "minimum", "maximum", "failed")
    assert [base.statistics[name] for name in names] == pytest.approx([3.0, 1.0, 6.0, 0])
    assert base.statistics["sd"] == pytest.approx((14 / 3) ** 0.5)  # 4 + 1 + 0 + 9, over n - 1
    assert (other.average, other.statistics["failed"]) == pytest.approx((6.0, 1))
    assert base.statistics["ratio"] is None
    assert other.statistics["ratio"] == pytest.approx((2 + 3 + 7) / 3)
    assert [point.is_on_front for point in accuracies.points] == [True, False]


def test_errors_against_the_finest_run_and_richardsons_limit(begin: Begin, tmp_path: Path) -> None:
    def values(order: float) -> list[CaseRecord]:
        cells = {"P2": (1, 2, 4), "P3": (1, 2)}
        sizes = [(1 / n, n) for ns in cells.values() for n in ns]
        return [good(5 + h**order, unknowns=n, total=n) for h, n in sizes]

    study = plan(tmp_path, repeat=1, reference="finest")
    rows, accuracies = rows_and_accuracy(begin, study, tmp_path, values(2.0))
    assert [row.size for row in rows] == [1, 0.5, 0.25, 1, 0.5]
    assert accuracies.errors == pytest.approx((1 - 0.0625, 0.25 - 0.0625, None, 1 - 0.0625, 0.25 - 0.0625))
    assert accuracies.references[0].origin == "finest run: P2, 4"

    study = plan(tmp_path, repeat=1, reference="richardson")
    _, accuracies = rows_and_accuracy(begin, study, tmp_path, [])
    assert accuracies.references[0].value == pytest.approx(5.0, abs=1e-12)
    assert accuracies.errors == pytest.approx((1, 0.25, 0.0625, 1, 0.25))
    assert accuracies.orders == pytest.approx((None, 2, 2, None, 2))
    assert accuracies.fitted == pytest.approx({"P2": 2, "P3": 2})

    with pytest.raises(JobError, match=r"reference\.all: richardson needs a series with 3 meshes; take finest or a"):
        plan(tmp_path, repeat=1, reference={"richardson": "P3"})


def test_no_order_is_given_where_more_than_the_mesh_varies(begin: Begin, tmp_path: Path) -> None:
    vary = {"mesh.parameters.nz": [1, 2, 4], "discretisation.displacement": [1, 2, 3]}
    series = [{"name": "all", "vary": vary}]
    with pytest.raises(JobError, match=r"reference\.all: richardson needs a series along which nothing but the mesh"):
        plan(tmp_path, repeat=1, series=series, reference="richardson")
    rows, _ = rows_and_accuracy(
        begin, plan(tmp_path, repeat=1, series=series), tmp_path, [good(v) for v in (1.0, 1.5, 1.75)]
    )
    assert [row.size for row in rows] == [None] * 3
    # Parameters that do not keep their proportion: the number of cells decides.
    vary = {"mesh.parameters.nz": [1, 2, 4], "mesh.parameters.nx": [1, 1, 2]}
    study = plan(tmp_path, repeat=1, series=[{"name": "all", "vary": vary}])
    rows, _ = rows_and_accuracy(begin, study, tmp_path / "b", [good(1.0, unknowns=n) for n in (1, 8, 64)])
    assert [row.size for row in rows] == pytest.approx([1, 0.5, 0.25])


def test_a_series_of_meshes_that_does_not_refine_is_reported(begin: Begin, tmp_path: Path) -> None:
    def message(*cells: int) -> list[str]:
        directory = tmp_path / "-".join(map(str, cells))
        directory.mkdir()
        records = [good(1.0 + 1 / n, unknowns=n, total=float(i)) for i, n in enumerate(cells)]
        rows, _ = rows_and_accuracy(begin, plan(directory, repeat=1, series=series), directory, records)
        assert [row.costs["cells"] for row in rows] == list(cells)
        return list(not_refined(rows))

    series = [{"name": "sizes", "vary": {"mesh.parameters.nz": [1, 2, 4, 8]}}]
    assert message(1000, 2000, 3000, 4000) == []
    (line,) = message(2001, 2365, 1439, 3788)
    assert "'sizes' do not become finer (2,001, 2,365, 1,439, 3,788 cells)" in line


def test_effectivity_is_the_estimated_over_the_true_error(begin: Begin, tmp_path: Path) -> None:
    study = plan(tmp_path, repeat=1, series=[{"name": "P2"}], reference=2.0, time="certified")
    estimate = {"estimate": {"quantities": {"length": 0.4}, "geometry": "left out"}}
    [row], accuracies = rows_and_accuracy(
        begin, study, tmp_path, [good(1.5, total=3.0, compile_=0.5, certificate=estimate)]
    )
    assert accuracies.effectivities == pytest.approx((0.8,))
    assert "1 of 1 runs, whose meshes differ in geometry" in accuracies.geometry_note([row])
    assert (accuracies.points[0].average, accuracies.points[0].promised) == (0.5, 0.4)
    assert row.time == row.costs["certified"] == pytest.approx(3.0 - 0.5)
    assert row.costs["run"] == pytest.approx(3.0 - 0.5 - 0.05)
    drawn = work_precision(study.study, accuracies, "seconds", {"P2": ""})["svg"]
    assert b'id="estimates-0"' in drawn
    assert b"dotted: as estimated by the certificate" in drawn


def test_a_study_ends_in_an_error_where_nothing_converged_or_nothing_can_be_compared(
    begin: Begin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def ended(directory: Path, records: list[CaseRecord], **changes: Any) -> None:
        schedule = begin(plan(tmp_path, repeat=1, **changes), tmp_path / directory)
        drain(schedule, iter(records))
        conclude(schedule.executions, StudyDirectory(tmp_path / directory / "out", "study"))

    with pytest.raises(SolveError, match="not one of the 5 runs converged; the first: stopped at load"):
        ended(Path("a"), [BAD] * 5)
    assert "failed: P3, 2: stopped at load factor 0.5 of 1" in capsys.readouterr().out
    with pytest.raises(
        JobError, match=r"reference.length: richardson: the values of series 'P2', 1, 3, 2, are not mono"
    ):
        ended(
            Path("b"),
            [good(v, unknowns=n) for n, v in enumerate((1.0, 3.0, 2.0, 1.0, 1.0))][:5],
            reference={"richardson": "P2"},
        )
    headers = (tmp_path / "b" / "out" / "table.csv").read_text().splitlines()[0].split(",")
    assert {"time [s]", "memory [B]"} <= set(headers), "the values are worth having all the same"
    with pytest.raises(JobError, match=r"measure: the summary has no number at solutions\[0\].strain"):
        ended(Path("c"), [good(1.0)] * 5, measure=["length", "solutions[0].strain"], reference={"all": 0})


def test_published_numbers_are_printed_next_to_ours(
    begin: Begin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    beside = {
        "source": "someone (1999)",
        "values": {"length": {"measured": "2.5 m"}},
        "statistics": {"length": {"all": {"average": 4.49e-12, "failed": 7}}},
    }
    study = plan(tmp_path, repeat=1, series=[{"name": "all"}], beside=beside, reference=2)
    schedule = begin(study, tmp_path)
    drain(schedule, iter([good(1.0)]))
    conclude(schedule.executions, StudyDirectory(tmp_path / "out", "study"))
    shown = capsys.readouterr().out
    assert "published: measured 2.5 m, +25.00% from the reference here" in shown
    assert "published numbers: someone (1999)" in shown
    cases = [{"grid": {"material.mu": [1, 2]}}]
    study = plan(tmp_path, repeat=1, series=[{"name": "all"}], beside=beside, reference=2, cases=cases)
    schedule = begin(study, tmp_path / "b")
    drain(schedule, iter([good(1.0), good(1.5)]))
    conclude(schedule.executions, StudyDirectory(tmp_path / "b" / "out", "study"))
    shown = capsys.readouterr().out
    ours, theirs = (line.split() for line in shown.splitlines() if line.startswith("all") or " published " in line)
    assert ours[1:5] == ["7.50e-01", "3.54e-01", "5.00e-01", "1.00e+00"]
    assert theirs[:3] == ["published", "4.49e-12", "-"]
    assert theirs[-1] == "7"
    table = list(csv.DictReader((tmp_path / "b" / "out" / "length-statistics.csv").open()))
    assert table[0]["published average [m]"] == "4.49e-12"
    assert (tmp_path / "b" / "out" / "length.svg").exists()
