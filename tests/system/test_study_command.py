"""Studies from the command line: tables, diagrams, signals, kills, and two that share their runs."""

from __future__ import annotations

import csv
import json
import re
import signal
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from random import Random

import h5py
import matplotlib.image
import numpy as np
import pytest
import yaml
from helpers.command_line import COLUMN, NO_CERTIFICATE, Started, hpcinv, hpcinv_here
from helpers.ledger_files import committed
from helpers.studies import STUDY
from helpers.study_runs import CLOSED_FORM, NZ

import hpcinv as api
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import parse


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a study, one of whose runs cannot be solved."""
    place = tmp_path_factory.mktemp("study")
    (place / "column.yaml").write_text(yaml.safe_dump(COLUMN | {"certificate": NO_CERTIFICATE}))
    series = [
        {"name": "P2", "vary": {"mesh.parameters.nz": [*NZ]}},
        {
            "name": "one iteration",
            "set": {"solver": {"strategy": "fixed", "steps": 1, "maximum_iterations": 1}},
            "vary": {"mesh.parameters.nz": [2]},
        },
        {"name": "tolerance", "set": {"mesh.parameters.nz": 4}, "vary": {"solver.tolerance": [1e-1, 1e-3]}},
    ]
    study = STUDY | {"series": series, "reference": f"{CLOSED_FORM} m", "repeat": 2}
    (place / "column-study.yaml").write_text(yaml.safe_dump(study, sort_keys=False))
    # Many quick repetitions, for those who interrupt.
    study |= {"series": [series[0] | {"vary": {"mesh.parameters.nz": [1, 2]}}], "repeat": 4}
    (place / "long.yaml").write_text(yaml.safe_dump(study, sort_keys=False))
    return place


@pytest.fixture(scope="module")
def results(place: Path) -> Path:
    """The results of the study, on one rank."""
    done = hpcinv_here("study", "column-study.yaml", cwd=place)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("column-study: 6 runs, 1 rank; results in results/column-study\n")
    assert "failed: one iteration, 2: stopped at load factor 0 of 1: Newton's method took too many" in done.stdout
    assert "Traceback" not in done.stderr
    return place / "results" / "column-study"


@pytest.fixture(scope="module")
def table(results: Path) -> list[dict[str, str]]:
    rows = csv.DictReader((results / "table.csv").open())
    return [{header.partition(" [")[0]: value for header, value in row.items()} for row in rows]


@pytest.mark.release
def test_the_table_has_every_run_with_its_value_error_and_cost(table: list[dict[str, str]]) -> None:
    assert [(r["series"], r["label"]) for r in table] == [
        *(("P2", str(n)) for n in NZ),
        ("one iteration", "2"),
        ("tolerance", "0.1"),
        ("tolerance", "0.001"),
    ]
    failed, solved = table[3], table[:3] + table[4:]
    assert failed["status"].startswith("stopped at load factor 0 of 1")
    assert failed["length"] == failed["length error"] == failed["time"] == ""
    for row, n in zip(solved, (*NZ, 4, 4), strict=True):
        # The same job, run by itself on one rank.
        job = COLUMN | {"certificate": NO_CERTIFICATE, "solver": {"tolerance": float(row["solver.tolerance"] or 1e-12)}}
        job["mesh"] = COLUMN["mesh"] | {"parameters": COLUMN["mesh"]["parameters"] | {"nz": n}}
        alone = api.run(parse(job, Path("job.yaml")), MPI.COMM_SELF)
        assert float(row["length"]) == pytest.approx(alone.quantities["length"], rel=1e-12)
        assert float(row["length error"]) == pytest.approx(abs(alone.quantities["length"] - CLOSED_FORM), rel=1e-5)
        assert float(row["unknowns"]) == 3 * 3 * 3 * (2 * n + 1)
        assert float(row["cells"]) == 6 * n
        assert float(row["factorizations"]) == alone.solutions[0].factorizations
        assert (row["repetitions"], row["certificate"]) == ("2", alone.certificate.verdict.value)
        assert 0 < float(row["time_min"]) <= float(row["time"]) <= float(row["time_max"])
        assert float(row["solver"]) < float(row["run"]) == float(row["time"])
        assert 5e7 < float(row["memory"]) < 2e9
    errors = [float(r["length error"]) for r in solved[:3]]
    assert errors[0] > errors[1] > errors[2]
    for i, row in enumerate(solved[1:3], start=1):
        assert float(row["length order"]) == pytest.approx(np.log2(errors[i - 1] / errors[i]), rel=1e-9)
    points = [(float(r["time"]), float(r["length error"])) for r in solved]
    best = [not any(t <= time and e <= error and (t, e) != (time, error) for t, e in points) for time, error in points]
    assert [r["length on Pareto front"] == "True" for r in solved] == best


def test_hdf5_holds_the_same_and_every_time(results: Path, table: list[dict[str, str]]) -> None:
    with h5py.File(results / "table.h5") as file:
        assert (file.attrs["study"], file.attrs["ranks"]) == ("column-study", 1)
        runs = file["runs"]
        assert list(runs["series"].asstr()[:]) == [r["series"] for r in table]
        for name in ("length", "length error", "time", "unknowns"):
            expected = [float(r[name] or "nan") for r in table]
            np.testing.assert_array_equal(runs[name][:], expected)
        assert (runs["length"].attrs["unit"], runs["time"].attrs["unit"]) == ("m", "s")
        times = file["times"][:]
        assert times.shape == (6, 2)
        kept = [i for i in range(6) if i != 3]
        assert np.isnan(times[3]).all()
        np.testing.assert_array_equal(np.median(times[kept], axis=1), runs["time"][kept])
        assert file["quantities/length/reference"][0] == CLOSED_FORM
        assert file["quantities/length/reference"].attrs["origin"] == "closed form"
        assert file["quantities/length/orders"].attrs["P2"] > 1.0


def test_diagrams_show_every_series_and_the_front(results: Path, table: list[dict[str, str]]) -> None:
    image = matplotlib.image.imread(results / "length.png")
    assert image.shape[0] > 700
    assert image.shape[1] > 1000
    assert np.ptp(image[..., :3]) > 0.9, "it is not blank"
    svg = ET.parse(results / "length.svg").getroot()
    groups = {g.get("id"): g for g in svg.iter("{http://www.w3.org/2000/svg}g")}
    assert {"front", "series-0", "series-2"} <= groups.keys()
    path = groups["series-0"].find("{http://www.w3.org/2000/svg}path")
    assert path is not None
    assert path.get("d", "").count("L") == len(NZ) - 1
    texts = {"".join(t.itertext()).strip() for t in svg.iter("{http://www.w3.org/2000/svg}text")}
    assert {"P2 (nz)", "tolerance (tolerance)", "Pareto front", "0.001", "error of length / m"} <= texts
    assert any(
        text.startswith(
            "time / s (whole run without its certificate, and without making programs, 1 rank, median of 2)"
        )
        for text in texts
    )


@pytest.mark.release
def test_the_same_command_again_does_nothing_twice(results: Path, place: Path) -> None:
    before = committed(results / "store")
    done = hpcinv_here("study", "column-study.yaml", cwd=place)
    assert done.returncode == 0, done.stderr
    assert f"{len(before)} executions were done before" in done.stdout
    assert "[" not in done.stdout.partition("length (m)")[0]
    assert committed(results / "store") == before


def test_quantities_of_all_states_are_measured(tmp_path: Path) -> None:
    """A column that stands as given, and hangs: each length converges, as its estimate says."""
    weight = COLUMN["effects"][0]
    states = [
        {"name": "standing", "given": True, "effects": [weight]},
        {"name": "hanging", "effects": [weight | {"acceleration": [0, 0, 9.81]}]},
    ]
    column = {key: value for key, value in COLUMN.items() if key not in ("analysis", "effects", "quantities")}
    column |= {"states": states, "certificate": NO_CERTIFICATE | {"estimate": True}}
    column["mesh"] = COLUMN["mesh"] | {"geometry_degree": 2}  # carries all nodes of the displacement
    column["quantities"] = [
        {"name": "rest", "of": "Z", "at": [0.1, 0.1, 1.0]},
        {"name": "top", "of": "z", "at": [0.1, 0.1, 1.0], "state": "hanging"},
    ]
    (tmp_path / "column.yaml").write_text(yaml.safe_dump(column))
    study = STUDY | {
        "series": [{"name": "P2", "vary": {"mesh.parameters.nz": [1, 2, 4]}}],
        "measure": ["rest-standing", "rest-hanging", "top"],
        "reference": {"rest-standing": f"{CLOSED_FORM} m", "rest-hanging": f"{CLOSED_FORM} m", "top": "richardson"},
        "repeat": 1,
    }
    (tmp_path / "states.yaml").write_text(yaml.safe_dump(study, sort_keys=False))
    done = hpcinv_here("study", "states.yaml", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = list(csv.DictReader((tmp_path / "results" / "states" / "table.csv").open()))
    table = [{header.partition(" [")[0]: value for header, value in row.items()} for row in rows]
    assert len(table) == 3
    assert {row["certificate"] for row in table} <= {"pass", "warn"}
    for name in study["measure"]:
        errors = [float(row[f"{name} error"]) for row in table]
        assert errors[2] < errors[1] / 3 < errors[0] / 9, name
        assert 0.3 < float(table[1][f"{name} effectivity"]) < 3, name
    wrong = study | {"measure": ["rest"]}
    (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(wrong | {"reference": "finest"}))
    refused = hpcinv_here("study", "wrong.yaml", cwd=tmp_path)
    assert refused.returncode == 2
    assert "no quantity of interest 'rest'" in refused.stderr
    assert "rest-hanging, rest-standing, " in refused.stderr


def kept(directory: Path) -> dict[tuple[str, int, int], bytes]:
    return committed(directory / "store")


def test_a_study_stopped_or_killed_goes_on_and_repeats_nothing(place: Path) -> None:
    with Started(1, "study", "long.yaml", "--output", "long", cwd=place) as started:
        started.wait_for("\n[3/")
        started.send(signal.SIGTERM, started.ranks())
        assert started.exit_code() == 75, started.text
    assert "The same command continues." in started.text
    assert "Traceback" not in started.text
    stopped = kept(place / "long")
    assert 3 <= len(stopped) < 8
    assert re.search(rf"\b{len(stopped)} of \d", started.text)
    assert not (place / "long" / "table.csv").exists()

    with Started(1, "study", "long.yaml", "--output", "long", cwd=place) as started:
        started.wait_for(f"[{len(stopped) + 2}/")
        started.kill()
    killed = kept(place / "long")
    assert len(stopped) + 2 <= len(killed) < 8
    assert f"{len(stopped)} executions were done before" in started.text

    done = hpcinv_here("study", "long.yaml", "--output", "long", cwd=place)
    assert done.returncode == 0, done.stderr
    assert f"{len(killed)} executions were done before" in done.stdout
    assert done.stdout.count("\n[") == len(kept(place / "long")) - len(killed)
    assert {p: entry for p, entry in kept(place / "long").items() if p in killed} == killed
    assert killed.items() >= stopped.items()
    assert re.search(r"^[^\d]*: errors against ", done.stdout, re.MULTILINE)  # one case, which is not counted
    assert all(json.loads(line)["case"]["brief"]["status"] == "converged" for line in kept(place / "long").values())
    with h5py.File(place / "long" / "table.h5") as file:
        assert file["times"].shape == (2, 4)


@pytest.mark.release
def test_a_study_killed_at_random_moments_repeats_no_committed_run(place: Path) -> None:
    """Kills fall into the start, a run, or a commit; each time all that was committed stays as it is."""
    random, before = Random(7), dict[tuple[str, int, int], bytes]()
    for _ in range(3):
        with Started(1, "study", "long.yaml", "--output", "killed", cwd=place) as started:
            started.wait_for("results in killed" if before else "\n[1/")  # all kernels are compiled then
            time.sleep(random.uniform(0.0, 3.0))
            started.kill()
        after = kept(place / "killed")
        assert after.items() >= before.items()
        before = after
    done = hpcinv(1, "study", "long.yaml", "--output", "killed", cwd=place)
    assert done.returncode == 0, done.stderr
    after = kept(place / "killed")
    assert after.items() >= before.items()
    assert done.stdout.count("\n[") == len(after) - len(before)
    assert all(json.loads(line)["case"]["brief"]["status"] == "converged" for line in after.values())
    assert (place / "killed" / "table.csv").exists()


def test_two_allocations_share_a_study_and_both_show_the_same_table(place: Path) -> None:
    command = ("study", "long.yaml", "--output", "shared")
    with Started(1, *command, cwd=place) as first:
        while not list(place.glob("shared/store/ledger/log/[!.]*")):  # it has claimed a case
            assert first.mpirun.poll() is None, first.text
            time.sleep(0.01)
        first.send(signal.SIGSTOP, first.ranks())  # so that it is not done before the other begins
        with Started(1, *command, cwd=place) as other:
            other.wait_for("\n[")
            first.send(signal.SIGCONT, first.ranks())
            assert first.exit_code() == 0, first.text
            assert other.exit_code() == 0, other.text
    texts = first.text, other.text
    executed = [re.findall(r"^\[\d+/\d+\] (.*): .* s", text, re.MULTILINE) for text in texts]
    assert all(executed), "each of them has had a share"
    assert sum(map(len, executed)) == len(kept(place / "shared"))
    assert "meanwhile" not in texts[0] + texts[1]
    tables = [text[text.index("\nlength (m)") :] for text in texts]
    assert tables[0] == tables[1]
    assert "P2" in tables[0]
    with h5py.File(place / "shared" / "table.h5") as file:
        assert np.isfinite(file["times"][:]).all()
        assert file["times"].shape == (2, 4)


def test_a_wrong_study_is_reported_once_and_leaves_nothing(place: Path) -> None:
    wrong = STUDY | {"series": [{"name": "P2", "vary": {"mesh.parameters.nz": [1, "x"]}}]}
    (place / "wrong.yaml").write_text(yaml.safe_dump(wrong))
    done = hpcinv_here("study", "wrong.yaml", cwd=place)
    assert done.returncode == 2
    assert done.stderr.count("wrong.yaml: P2, x: mesh.parameters.nz: 'x' is not a number") == 1
    assert not (place / "results" / "wrong").exists()
