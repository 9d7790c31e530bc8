"""The sweep file: all faults are reported at once; samples have their distributions; what its cases are."""

from __future__ import annotations

import itertools
import json
import math
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from statistics import NormalDist, fmean, stdev
from typing import Any

import pytest
import yaml
from helpers.command_line import COLUMN, ROOT, environment

from hpcinv.errors import JobError
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.outcomes import outcomes_of
from hpcinv.studies.batch.sampling import SamplingMethod, read_distribution, unit_points
from hpcinv.studies.batch.time_forecast import duration_text, remaining_seconds
from hpcinv.studies.sweep.sweep_plan import SweepPlan, load_sweep

YEOH = {"law": "yeoh", "c1": "5 kPa", "c2": 0, "c3": 0, "kappa": "50 kPa"}
MU = "material.mu"
DENSITY = "effects[0].density"


def plan(directory: Path, *axes: dict[str, Any], **changes: Any) -> SweepPlan:
    (directory / "column.yaml").write_text(yaml.safe_dump(COLUMN))
    path = directory / "columns.yaml"
    path.write_text(yaml.safe_dump({"job": "column.yaml", "axes": list(axes)} | changes, sort_keys=False))
    return load_sweep(path)


def problems(directory: Path, *axes: dict[str, Any], **changes: Any) -> list[str]:
    with pytest.raises(JobError) as caught:
        plan(directory, *axes, **changes)
    return [problem.removeprefix(f"{directory / 'columns.yaml'}: ") for problem in caught.value.problems]


def sample(kind: str, distribution: Any, count: int, seed: int = 1) -> dict[str, Any]:
    return {kind: {MU: distribution}, "count": count, "seed": seed}


# Samples


@pytest.mark.parametrize("method", ["random", "latin_hypercube", "sobol"])
def test_the_same_seed_draws_the_same_points_and_another_seed_others(method: SamplingMethod) -> None:
    points = unit_points(method, 3, 16, 7)
    assert len(points) == 16
    assert all(len(point) == 3 and all(0 <= x < 1 for x in point) for point in points)
    assert points == unit_points(method, 3, 16, 7)
    assert points != unit_points(method, 3, 16, 8)
    if method != "latin_hypercube":  # a larger sample begins with the smaller one
        assert [*unit_points(method, 3, 37, 7)[:16]] == [*points]


@pytest.mark.parametrize("count", [1, 7, 50])
def test_a_latin_hypercube_has_one_point_in_each_stratum_of_each_parameter(count: int) -> None:
    points = unit_points("latin_hypercube", 4, count, 3)
    for axis in zip(*points, strict=True):
        assert sorted(int(x * count) for x in axis) == list(range(count))


@pytest.mark.parametrize("m", [1, 3, 6])
def test_sobol_points_in_two_dimensions_are_a_net(m: int) -> None:
    """Of the first 2^m there is one in each dyadic box of area 2^-m, however long it is (Niederreiter 1987, t = 0)."""
    points = unit_points("sobol", 2, 2**m, 5)
    for k in range(m + 1):
        boxes = {(int(x * 2**k), int(y * 2 ** (m - k))) for x, y in points}
        assert boxes == set(itertools.product(range(2**k), range(2 ** (m - k))))


@pytest.mark.release
def test_sobol_points_fill_the_square_more_evenly_than_random_ones() -> None:
    """Warnock's closed form (1972) of the mean square of empty area in boxes at the origin; its expectation at random
    points is (2^-d - 3^-d) / n."""

    def discrepancy(points: Any) -> float:
        n = len(points)
        single = sum(math.prod(1 - x * x for x in p) for p in points)
        pairs = sum(math.prod(1 - max(x, y) for x, y in zip(p, q, strict=True)) for p in points for q in points)
        return 3.0**-2 - 2.0**-1 / n * single + pairs / n**2

    n, expected = 128, (2.0**-2 - 3.0**-2) / 128
    assert discrepancy(unit_points("sobol", 2, n, 1)) < 0.1 * expected
    averaged = fmean(discrepancy(unit_points("random", 2, n, seed)) for seed in range(20))
    assert averaged == pytest.approx(expected, rel=0.5)


@pytest.mark.parametrize(
    ("given", "quantiles"),
    [
        (["2 kPa", "200 kPa"], {0.0: 2e3, 0.5: 101e3, 0.75: 150.5e3}),
        ({"uniform": [-1, 3]}, {0.0: -1.0, 0.25: 0.0, 0.5: 1.0}),
        ({"log-uniform": ["1 Pa", "10 kPa"]}, {0.0: 1.0, 0.25: 10.0, 0.5: 100.0, 0.75: 1000.0}),
        # of the normal distribution: Φ(0) = 1/2, Φ(1) and Φ(-1.96) as in every table
        ({"normal": ["963 kg/m^3", "0.01 g/cm^3"]}, {0.5: 963.0, 0.8413447460685429: 973.0, 0.0249978951482204: 943.4}),
    ],
)
def test_quantiles_of_the_distributions(given: Any, quantiles: dict[float, float]) -> None:
    distribution = read_distribution(given)
    for share, value in quantiles.items():
        assert distribution.quantile(share) == pytest.approx(value, rel=1e-11, abs=1e-11)


@pytest.mark.release
def test_samples_follow_their_distributions(tmp_path: Path) -> None:
    """Errors of means and spreads of a Latin hypercube are far smaller than with independent draws."""
    axis = {
        "latin_hypercube": {
            MU: {"log-uniform": ["1 kPa", "100 kPa"]},
            "material.lam": ["40 kPa", "80 kPa"],
            DENSITY: {"normal": ["963 kg/m^3", "10 kg/m^3"]},
        },
        "count": 400,
        "seed": 2,
    }
    cases = plan(tmp_path, axis).cases
    mu, lam, density = ([case.parameters[key] for case in cases] for key in axis["latin_hypercube"])
    assert fmean(math.log10(x) for x in mu) == pytest.approx(4, abs=0.01)
    assert Counter(int(math.log10(x)) for x in mu) == {3: 200, 4: 200}
    assert fmean(lam) == pytest.approx(60e3, rel=1e-3)
    assert stdev(lam) == pytest.approx(40e3 / math.sqrt(12), rel=1e-2)
    assert fmean(density) == pytest.approx(963, abs=0.1)
    assert stdev(density) == pytest.approx(10, rel=0.02)
    assert NormalDist.from_samples(density).overlap(NormalDist(963, 10)) > 0.98


def test_sampled_values_have_twelve_digits(tmp_path: Path) -> None:
    """So that the last bit of a platform's logarithm does not make another case of them."""
    for case in plan(tmp_path, sample("random", {"log-uniform": [1e3, 1e5]}, 20)).cases:
        assert case.parameters[MU] == float(f"{case.parameters[MU]:.12g}")


# What is wrong


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ([], "axes: must hold at least one axis"),
        ([{}], "axes[0]: must be one of grid, zip, random, latin_hypercube, sobol, branches, table, not none of them"),
        ([{"grid": {MU: [1]}, "zip": {MU: [1]}}], "axes[0]: must be one of grid, zip, random, latin_hypercube, sobol"),
        ([{"gird": {MU: [1]}, "grid": {MU: [1]}}], "axes[0].gird: unknown key. Did you mean 'grid'?"),
        ([{"grid": {}}], "axes[0].grid: must have at least one entry"),
        ([{"grid": {MU: []}}], "axes[0].grid.material.mu: must have at least one value"),
        ([{"grid": {"effects[].density": [1]}}], "put a number between the brackets"),
        (
            [{"zip": {MU: [1, 2], "material.lam": [1]}}],
            "axes[0].zip: needs the same number of values of each key, not [1, 2]",
        ),
        ([{"sobol": {MU: [1, 2]}}], "axes[0].count: is needed: the number of points of 'sobol'"),
        ([{"grid": {MU: [1]}, "count": 3}], "axes[0].count: is valid only with a sample"),
        ([{"grid": {MU: [1]}, "name": "x"}], "axes[0].name: is valid only with branches"),
        ([sample("random", [1, 2], 0)], "axes[0].count: must be at least 1, not 0"),
        ([sample("random", ["1 kPa", "2 m"], 2)], "must have two values of the same dimension, not 1 kPa and 2 m"),
        ([sample("random", ["1 kPa", 2000], 2)], "must have two values of the same dimension, not 1 kPa and 2000"),
        ([sample("random", [2, 1], 2)], "axes[0].random.material.mu: must begin below its end, not 2 and 1"),
        ([sample("sobol", {"log-uniform": [0, 1]}, 2)], "must begin above 0 to be log-uniform, not with 0"),
        ([sample("sobol", {"normal": [1, 0]}, 2)], "must have a standard deviation above 0, not 0"),
        ([sample("sobol", {"gauss": [1, 2]}, 2)], "there is no distribution 'gauss'. Known: log-uniform, normal"),
        ([sample("sobol", 3, 2)], "must be the two ends of a range, such as [2 kPa, 200 kPa], not 3"),
        ([sample("sobol", [1, math.inf], 2)], "must contain finite numbers, not 1 and inf"),
        ([{"grid": {MU: [1]}}, sample("sobol", [1, 2], 2)], "axes[1]: material.mu is also on an earlier axis"),
        (
            [{"branches": {"a": {"axes": [{"grid": {MU: [1]}}]}, "b": {}}}, {"grid": {MU: [1]}}],
            "axes[1]: material.mu is also on an earlier axis",
        ),
        (
            [{"branches": {"a": {"set": {MU: 2}, "axes": [{"grid": {MU: [1]}}]}}}],
            "axes[0].branches.a.axes[0]: material.mu is also in 'set'",
        ),
        (
            [{"branches": {"a": {"axes": [{"branches": {"b": {}}}]}}}],
            "axes[0].branches.a: 'branch' is also the name of these branches",
        ),
        ([{"grid": {MU: [1] * 2000, DENSITY: [1] * 2000}}], "axes: make 4,000,000 cases, but a sweep can have no more"),
    ],
)
def test_faults_of_the_sweep_file_are_reported(axes: list[dict[str, Any]], expected: str, tmp_path: Path) -> None:
    [problem] = problems(tmp_path, *axes)
    assert expected in problem


def test_everything_wrong_is_reported_at_once_with_the_number_of_cases(tmp_path: Path) -> None:
    assert problems(tmp_path, {"grid": {"effects[1].density": [1, 2]}}) == [
        "case 0, density 1 (and 1 more case): cannot set effects[1].density: [1] is not an entry of a list of 1"
    ]
    faults = problems(
        tmp_path,
        {"grid": {"mesh.parameters.nz": [1, "2 m"]}},
        {"zip": {MU: [1e4, 2e4, -3, -4]}},
        set={"solver.tolerance": 2, "certificate.estimate": 0},
    )
    assert [problem.partition(": ")[::2] for problem in faults] == [
        ("case 0, nz 1, mu 10000 (and 7 more cases)", "solver.tolerance: must be less than 1, not 2"),
        ("case 0, nz 1, mu 10000 (and 7 more cases)", "certificate.estimate: must be true or false, not 0"),
        (
            "case 2, nz 1, mu -3 (and 3 more cases)",
            "material: the shear modulus that follows from these parameters must be positive, but is -3 Pa",
        ),
        ("case 4, nz 2 m, mu 10000 (and 3 more cases)", "mesh.parameters.nz: must be a whole number, not '2 m'"),
    ]
    assert problems(tmp_path, {"grid": {MU: [1]}}, job="colum.yaml") == [
        f"job: {tmp_path / 'colum.yaml'}: no such file. Did you mean 'column.yaml'?"
    ]


# Cases


def test_cases_are_all_combinations_the_last_axis_changing_fastest(tmp_path: Path) -> None:
    sweep_plan = plan(
        tmp_path,
        {
            "name": "law",
            "branches": {
                "Yeoh": {"set": {"material": YEOH}, "axes": [{"grid": {"material.c1": ["4 kPa", 6e3]}}]},
                "neo-Hookean": {"axes": [{"zip": {MU: [1e4, 2e4, 3e4], "material.lam": [4e4, 5e4, 6e4]}}]},
            },
        },
        {"grid": {DENSITY: [900, "1 g/cm^3"], "mesh.parameters.nz": [1, 2]}},
        set={"certificate.estimate": False, MU: "7 kPa", DENSITY: 1},
    )
    assert len(sweep_plan.cases) == (2 + 3) * 4
    assert [case.number for case in sweep_plan.cases] == list(range(20))
    assert dict(sweep_plan.cases[0].parameters) == {
        "law": "Yeoh",
        "material.c1": "4 kPa",
        DENSITY: 900,
        "mesh.parameters.nz": 1,
    }
    assert dict(sweep_plan.cases[19].parameters) == {
        "law": "neo-Hookean",
        MU: 3e4,
        "material.lam": 6e4,
        DENSITY: "1 g/cm^3",
        "mesh.parameters.nz": 2,
    }
    jobs = [sweep_plan.job(case) for case in sweep_plan.cases]
    laws: list[Any] = [job.laws["material"] for job in jobs]
    assert [law.c1 for law in laws[:8]] == [4e3] * 4 + [6e3] * 4
    assert [(law.mu, law.lam) for law in laws[8:]] == [(1e4, 4e4)] * 4 + [(2e4, 5e4)] * 4 + [(3e4, 6e4)] * 4
    gravities: list[Any] = [job.effects[0] for job in jobs]
    assert [gravity.density for gravity in gravities] == [900.0, 900.0, 1000.0, 1000.0] * 5
    assert [job.mesh.parameters["nz"] for job in jobs] == [1, 2] * 10
    assert not any(job.certificate.estimate for job in jobs)
    assert len({case.key for case in sweep_plan.cases}) == 20
    assert len({case.reuse_group for case in sweep_plan.cases}) == 4  # laws and meshes; numbers make no reuse group


def test_branches_in_branches(tmp_path: Path) -> None:
    inner = {"name": "mesh", "branches": {"coarse": {"set": {"mesh.parameters.nz": 1}}, "fine": {}}}
    cases = plan(
        tmp_path, {"branches": {"light": {"set": {DENSITY: 1}, "axes": [inner]}, "heavy": {"set": {DENSITY: 9}}}}
    ).cases
    assert [dict(case.parameters) for case in cases] == [
        {"branch": "light", "mesh": "coarse"},
        {"branch": "light", "mesh": "fine"},
        {"branch": "heavy"},
    ]
    assert [dict(case.settings) for case in cases] == [
        {DENSITY: 1, "mesh.parameters.nz": 1},
        {DENSITY: 1},
        {DENSITY: 9},
    ]


def test_only_summaries_are_written_unless_more_is_asked_for(tmp_path: Path) -> None:
    def output(**changes: Any) -> tuple[bool, tuple[str, ...]]:
        sweep_plan = plan(tmp_path, {"grid": {MU: [1e4]}}, **changes)
        asked = sweep_plan.job(sweep_plan.cases[0]).output
        return asked.fields, asked.mesh

    assert output() == (False, ())
    assert output(set={"output.fields": True}) == (True, ())
    assert output(set={"output": {"mesh": ["vtu"]}}) == (False, ("vtu",))


def test_the_store_is_next_to_the_sweep_or_in_the_working_directory(tmp_path: Path) -> None:
    assert plan(tmp_path, {"grid": {MU: [1e4]}}).store == Path("results/store")
    assert plan(tmp_path, {"grid": {MU: [1e4]}}, store="../all").store == tmp_path / "../all"


# Identities


def key(directory: Path, axis: dict[str, Any], **changes: Any) -> str:
    [case] = plan(directory, axis, **changes).cases
    return case.key


def test_the_same_case_has_the_same_key_in_every_sweep(tmp_path: Path) -> None:
    expected = key(tmp_path, {"grid": {MU: ["20 kPa"]}})
    first, other = tmp_path / "one", tmp_path / "other"
    for directory in (first, other):
        directory.mkdir()
    mesh = first / "any.py"
    mesh.write_bytes((ROOT / "meshes" / "box.py").read_bytes())
    law = {"law": "neo-hookean", "mu": "2e-2 MPa", "lam": "40000 Pa"}
    assert {
        key(tmp_path, {"grid": {MU: [2e4]}}, sweep="other-name", store="elsewhere", warm_start=False),
        key(first, {"zip": {MU: ["0.02 N/mm^2"], DENSITY: ["1 g/cm^3"]}}),
        key(first, {"branches": {"soft": {"set": {"material": law}}}, "name": "law"}),
        key(first, {"grid": {"mesh.file": [str(mesh)], MU: [2e4]}}),
        key(first, {"grid": {"job": ["renamed"], MU: [2e4], "output.fields": [True], "checkpoint.every": [5]}}),
        key(first, {"grid": {"mesh.partition": ["scotch"], MU: [2e4]}}),
        key(other, {"grid": {MU: [2e4]}}, set={MU: 1, "solver.tolerance": 1e-12}),  # its default
    } == {expected}
    number = {"normal": [2e4, 1]}
    [drawn] = plan(other, sample("random", number, 1)).cases
    assert key(other, {"grid": {MU: [drawn.parameters[MU]]}}) == drawn.key


def test_changes_of_the_result_change_the_key(tmp_path: Path) -> None:
    mesh = tmp_path / "box.py"
    mesh.write_bytes((ROOT / "meshes" / "box.py").read_bytes())
    length = COLUMN["quantities"][0]
    base = {"mesh.file": ["box.py"]}
    changes: list[dict[str, Any]] = [
        {},
        {MU: [10001]},
        {"mesh.parameters.nz": [5]},
        {"mesh.geometry_degree": [2]},
        {"analysis": ["round_trip"]},
        {"discretisation.displacement": [1]},
        {"discretisation.quadrature": [4]},
        {"effects[0].density_in": ["reference"]},
        {"supports[1].fix": [["z", "x"]]},
        {"solver.tolerance": [1e-9]},
        {"solver.petsc": [{"mat_mumps_icntl_7": 5}]},
        {"method": ["aitken"]},
        {"method": ["aitken"], "fixed_point.memory": [3]},
        {"certificate.estimate": [False]},
        {"quantities": [[length, length | {"name": "more"}]]},
        {"accuracy": [{"length": "1 mm"}]},
        {"accuracy": [{"length": "2 mm"}]},
        {"sensitivities": [["material.mu"]]},
        {"sensitivities": [{"material.mu": "1 kPa"}]},
        {"expected_shape": [{"file": "box.py"}]},
    ]
    keys = [key(tmp_path, {"grid": base | change}) for change in changes]
    mesh.write_text(mesh.read_text() + "\n# changed\n")
    keys.append(key(tmp_path, {"grid": base}))
    assert len(set(keys)) == len(keys)


def test_cases_that_are_the_same_are_rows_of_their_own(tmp_path: Path) -> None:
    cases = plan(tmp_path, {"grid": {MU: ["10 kPa", 1e4, 2e4]}}).cases
    assert [case.number for case in cases] == [0, 1, 2]
    assert cases[0].key == cases[1].key != cases[2].key


# Forecast


def test_the_forecast_goes_by_reuse_group_and_else_by_size() -> None:
    seconds = {"small": [1.0, 2.0, 90.0], "large": [40.0]}
    sizes = {"small": 100, "large": 1000}
    finished = {f"{group}-{s}": (group, s) for group, every in seconds.items() for s in every}
    records = {
        key: CaseRecord("converged", "", {"mesh": {"unknowns": sizes[group]}}, s, 1)
        for key, (group, s) in finished.items()
    }

    def left(*groups: str) -> float | None:
        open_cases = {f"open-{i}": group for i, group in enumerate(groups)}
        reuse_groups = {key: group for key, (group, _) in finished.items()} | open_cases
        return remaining_seconds(reuse_groups, outcomes_of(records.items()), {"larger": 1500, "smaller": 50})

    assert remaining_seconds({"a": "small"}, {}) is None
    assert left("small", "small", "small") == 6.0  # medians
    assert left("larger", "smaller") == pytest.approx(40 * 1.5 + 2 / 2)
    assert left("unknown") == pytest.approx((2 + 40) / 2)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.25, "0.2 s"), (45, "45 s"), (120, "2.0 min"), (3000, "50 min"), (9000, "2.5 h"), (4 * 86400, "4.0 days")],
)
def test_durations_in_words(seconds: float, words: str) -> None:
    assert duration_text(seconds) == words


# Commands


def test_the_example_of_the_documentation_is_right(tmp_path: Path) -> None:
    example, *_ = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "how-to" / "sweep.md").read_text(), re.DOTALL)
    path = tmp_path / "example.yaml"
    path.write_text(example.replace("job: ", f"job: {ROOT / 'jobs'}/"))
    sweep_plan = load_sweep(path)
    assert sweep_plan.sweep.sweep == "beam-laws"
    assert len({case.key for case in sweep_plan.cases}) == (3 + 64) * 2


def test_validate_takes_sweeps_and_loads_neither_mpi_nor_the_solver(tmp_path: Path) -> None:
    plan(tmp_path, {"grid": {MU: [1e4, 2e4]}})
    files = [str(tmp_path / "columns.yaml"), str(tmp_path / "column.yaml")]
    code = (
        "import sys, json; from hpcinv.__main__ import main; "
        f"c = main(['validate', *{files}]); print(json.dumps([*sys.modules])); exit(c)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    *lines, modules = done.stdout.splitlines()
    assert lines == [f"{file}: valid" for file in files]
    assert not {"mpi4py", "petsc4py", "dolfinx", "gmsh", "ufl", "numpy", "scipy", "h5py", "matplotlib"} & set(
        json.loads(modules)
    )


# Axes from tables

TABLE = "batch, material.mu [kPa], effects[0].density\n2026-03, 10.5, 900 kg/m^3\n2026-04, 12, 1.1 g/cm^3\n"


def test_a_table_is_an_axis_of_its_rows(tmp_path: Path) -> None:
    (tmp_path / "batches.csv").write_text(TABLE)
    cases = plan(tmp_path, {"table": "batches.csv", "name": "batch"}, {"grid": {"material.lam": [4e4, 5e4]}}).cases
    assert [dict(case.parameters) for case in cases[::2]] == [
        {"batch": "2026-03", MU: "10.5 kPa", DENSITY: "900 kg/m^3", "material.lam": 4e4},
        {"batch": "2026-04", MU: "12 kPa", DENSITY: "1.1 g/cm^3", "material.lam": 4e4},
    ]
    assert len({case.key for case in cases}) == 4


def test_tables_of_others_need_the_titles_by_key(tmp_path: Path) -> None:
    text = "Chargen 2026\nCharge;µ;Dichte;Prüfer\n;kPa;kg/m³;\nA;10,5;900;Müller\nB;12;1100;Müller\n"
    (tmp_path / "batches.csv").write_text(text, encoding="latin-1")
    (fault,) = problems(tmp_path, {"table": "batches.csv"})
    assert "no line names columns by keys of the job, such as material.c1 [kPa]" in fault
    columns = {MU: "µ", DENSITY: "Dichte"}
    cases = plan(tmp_path, {"table": "batches.csv", "name": "Charge", "columns": columns}).cases
    assert [dict(case.parameters) for case in cases] == [
        {"Charge": "A", MU: "10.5 kPa", DENSITY: "900 kg/m³"},
        {"Charge": "B", MU: "12 kPa", DENSITY: "1100 kg/m³"},
    ]
    unnamed = plan(tmp_path, {"table": "batches.csv", "columns": {MU: "µ"}}).cases
    assert [dict(case.parameters) for case in unnamed] == [{MU: "10.5 kPa"}, {MU: "12 kPa"}]


@pytest.mark.parametrize(
    ("text", "axis", "expected"),
    [
        (None, {}, "axes[0].table: batches.csv: cannot be read: No such file"),
        (TABLE, {}, "line 1: the column 'batch' is not a key of the job; give 'columns' by key, or 'name: batch'"),
        (TABLE, {"name": "lot"}, "the column 'batch' is not a key of the job"),
        (TABLE.partition("\n")[0], {"name": "batch"}, "has no rows below"),
        (TABLE.replace("2026-04", "2026-03"), {"name": "batch"}, "line 3: the label '2026-03' is a duplicate"),
        (TABLE.replace("10.5", ""), {"name": "batch"}, "line 2: a value is missing in column 2"),
        (TABLE.replace(", 900 kg/m^3", ""), {"name": "batch"}, "line 2: has 2 entries, but there are 3 columns"),
        (TABLE, {"columns": {MU: "mu"}}, "no line names columns by mu"),
        (TABLE, {"grid": {MU: [1]}}, "axes[0].grid: is not valid with a table"),
        ("material.mu\n1\n", {"name": "batch"}, "axes[0].name: batches.csv has no column 'batch'"),
        ("material.mu [mm]\n1\n", {}, "must be a stress"),
    ],
)
def test_tables_with_faults_are_refused(text: str | None, axis: dict[str, Any], expected: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "batches.csv").write_text(text)
    (fault,) = problems(tmp_path, {"table": "batches.csv", **axis})
    assert expected in fault


def test_untrusted_sweeps_read_no_tables_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "batches.csv").write_text(TABLE)
    (tmp_path / "sweep").mkdir()
    with pytest.raises(JobError, match=r"axes\[0\]\.table: '\.\./batches\.csv' leads out of the directory"):
        load_sweep_untrusted(tmp_path / "sweep")


def load_sweep_untrusted(directory: Path) -> SweepPlan:
    (directory / "column.yaml").write_text(yaml.safe_dump(COLUMN))
    path = directory / "columns.yaml"
    path.write_text(yaml.safe_dump({"job": "column.yaml", "axes": [{"table": "../batches.csv", "name": "batch"}]}))
    return load_sweep(path, untrusted=True)
