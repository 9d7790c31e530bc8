"""Values that others published: the tables, the judgement of a row, and the rows that are small."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from helpers.command_line import ROOT

from hpcinv.base.parallel.runtime import MPI

if TYPE_CHECKING:
    from benchmarks.published.references import PublishedValue

TABLES = sorted((ROOT / "benchmarks" / "published").glob("*/references.csv"))
LONG = ("anand", "balloon", "bimetal", "cook", "land", "tahoe")
"""Sources that take 3 s and more, whose bodies have closed forms in daily tests: of homogeneous states, shells, strips
of two layers, bent beams, and cavities."""
SOURCES = [pytest.param(s, marks=[pytest.mark.release] if s in LONG else []) for s in (t.parent.name for t in TABLES)]


@pytest.fixture(autouse=True)
def benchmarks_importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT)


@pytest.mark.parametrize(("printed", "unit"), [("14.74", 0.01), ("60", 1.0), ("8.40e-6", 1e-8), ("1e3", 1e3)])
def test_error_of_a_printed_value_is_one_unit_of_its_last_digit(printed: str, unit: float) -> None:
    from benchmarks.published.references import last_digit

    assert last_digit(printed) == pytest.approx(unit, rel=1e-15)


def test_each_source_has_a_table_whose_jobs_exist_and_a_readme() -> None:
    from benchmarks.published.references import FOLDER, read, sources

    assert len(sources()) >= 3
    for source in sources():
        assert (FOLDER / source / "README.md").read_text().startswith("# ")
        for row in read(source):
            assert row.source
            assert row.place
            makes_jobs = (FOLDER / source / "cases.py").exists()
            assert makes_jobs or (FOLDER / source / f"{row.job}.yaml").exists()
            assert makes_jobs or not row.loaded or (FOLDER / source / f"{row.loaded}.yaml").exists()


def test_an_unreadable_table_is_named_with_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.published import references

    (tmp_path / "odd").mkdir()
    head = ",".join(references.COLUMNS)
    (tmp_path / "odd" / "references.csv").write_text(f"{head}\nbeam,,tip,1.0,furlong,,mesh,,,doi,table,\n")
    monkeypatch.setattr(references, "FOLDER", tmp_path)
    with pytest.raises(references.TableError, match=r"references.csv: line 2: .*furlong"):
        references.read("odd")


def test_jobs_of_the_same_name_in_two_sources_are_two_cases() -> None:
    from benchmarks.published.references import cases, read

    here = read("cook")[0]
    there = dataclasses.replace(here, folder="elsewhere")
    assert list(cases([here, there, here]).values()) == [[here, here], [there]]


def test_rows_are_judged_by_both_error_bars() -> None:
    from benchmarks.published.comparison import ComparedValue, compare
    from benchmarks.published.references import read

    limit = dataclasses.replace(read("cook")[0], comparison="limit", value="14.74", spread=0.01)

    def row(
        tip: float, error: float | None, analysis: str = "forward", *, reliable: bool = True, at: str = ""
    ) -> ComparedValue:
        singular = {"singular": {"reliable": reliable}, "unreliable": [at]}
        estimate = None if error is None else {"quantities": {"tip": error}} | singular
        summary = {
            "quantities": {"tip": tip},
            "certificate": {"estimate": estimate},
            "mesh": {"unknowns": 1},
            "timings": {"total": 1.0},
            "job": {"analysis": analysis},
        }
        return compare(limit, summary)

    assert row(14.745e-3, 1e-8).verdict == "inside"
    assert row(14.755e-3, 1e-8).verdict == "outside"
    assert row(14.755e-3, -1e-5).verdict == "inside"  # by our own error
    assert row(14.745e-3, None).verdict == "not reliable"
    assert row(14.745e-3, 1e-8, reliable=False).verdict == "not reliable"
    assert row(14.745e-3, 1e-8, at="tip").verdict == "not reliable"
    assert compare(limit, {"failure": "no solution"}).verdict == "failed"
    assert [row(14.745e-3, 1e-8, analysis).inverse for analysis in ("forward", "inverse")] == [False, True]


def test_changes_on_finer_meshes_give_the_error_where_an_estimate_is_not_reliable() -> None:
    from benchmarks.published.comparison import compare
    from benchmarks.published.references import read

    limit = dataclasses.replace(read("cook")[0], comparison="limit", value="14.74", spread=0.01)

    def mesh(size: float, unknowns: int, order: float) -> dict[str, object]:
        return {"quantities": {"tip": 14.75e-3 - 0.05e-3 * size**order}, "mesh": {"unknowns": unknowns}}

    summary = mesh(1.0, 1000, 1.0) | {
        "certificate": {"estimate": {"quantities": {"tip": 1e-9}, "unreliable": ["tip"]}},
        "timings": {"total": 1.0},
        "job": {"analysis": "forward"},
    }
    for order in (1.0, 2.0):  # the bar holds the exact value, for slightly finer and for halved cells
        for ratio in (1.3, 2.0):
            finer = mesh(1 / ratio, round(1000 * ratio**3), order)
            row = compare(limit, summary | {"finer": [mesh(1.0, 1000, 1.0), finer]})
            assert row.verdict == "inside"
            assert 14.75 - row.ours < row.error < 0.15
    shell = summary | {
        "job": {"analysis": "forward", "mesh": {"shell": {"thickness": 0.01}}},
        "finer": [mesh(0.5, 4000, 1.0)],
    }
    assert compare(limit, shell).error == pytest.approx(3 * 0.05 * 0.5)  # halved cells: 4 times as many in a surface
    moved = {"quantities": {"tip": 14.71e-3}, "mesh": {"unknowns": 1000}}
    assert compare(limit, summary | {"finer": [moved]}).error == pytest.approx(0.03)  # as if its cells were halved
    assert compare(limit, summary | {"finer": []}).verdict == "not reliable"
    assert next(row.finer for row in read("land") if row.quantity == "twisted-x")[1] == {"mesh.parameters.apex": 0.5}


def test_rows_without_the_files_of_the_user_are_skipped_and_not_counted() -> None:
    from benchmarks.published import page
    from benchmarks.published.comparison import compare
    from benchmarks.published.references import read

    row = compare(read("cook")[0], {"missing": "set SUITE to its folder"})
    assert row.verdict == "skipped"
    assert "skipped: set SUITE to its folder" in page.table([row])
    assert "\n0 values of 0 sources" in page.page([row])


@pytest.mark.everyday(
    "bathe", "biot", "bisshopp", "calculix", "code-aster", "fourc", "frontistr", "moose", "oofem", "pulse", "sanm"
)
@pytest.mark.parametrize("source", SOURCES)
def test_small_rows_are_inside_both_error_bars(source: str, shared_by_workers: Path) -> None:
    from benchmarks.published.__main__ import rows_of
    from benchmarks.published.references import read

    small = [row for row in read(source) if row.small]
    rows = rows_of(small, shared_by_workers / "published", MPI.COMM_SELF)
    assert [row.reference for row in rows] == small
    assert [row.reference.place for row in rows if row.verdict not in ("inside", "skipped")] == []
    assert all(math.isfinite(row.difference) for row in rows if not row.missing)


def test_most_sources_have_small_rows_and_some_recover_unloaded_shapes() -> None:
    from benchmarks.published.references import read, sources

    small = [row for source in sources() for row in read(source) if row.small]
    assert len({row.folder for row in small}) >= 13
    assert len({row.folder for row in small if row.loaded}) >= 5


@pytest.mark.parallel([1, 2])
def test_ranks_share_the_cases_and_each_is_solved_once(
    comm: MPI.Intracomm, run_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from benchmarks.published import __main__ as command
    from benchmarks.published.references import cases, read

    solved: list[tuple[str, ...]] = []

    def without_files(row: PublishedValue, *_: object) -> dict[str, str]:
        solved.append(row.case)
        return {"missing": "not solved here"}

    monkeypatch.setattr(command, "summary_of", without_files)
    references = read("sze")
    rows = command.rows_of(references, run_directory, comm)
    assert [row.reference for row in rows] == [row for case in cases(references).values() for row in case]
    assert sorted(itertools.chain(*comm.allgather(solved))) == sorted(cases(references))
    assert not any(run_directory.iterdir())
