"""The study file: all its faults are reported at once, and what its runs are."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import COLUMN, ROOT, environment
from helpers.studies import STUDY, plan
from pydantic import ValidationError

from hpcinv.base.quantity.keys import assigned, look_up, parse_key
from hpcinv.errors import JobError
from hpcinv.studies.study.study_spec import Study


def problems(directory: Path, **changes: Any) -> list[str]:
    with pytest.raises(JobError) as caught:
        plan(directory, **changes)
    return [problem.removeprefix(f"{directory / 'study.yaml'}: ") for problem in caught.value.problems]


def series(**changes: Any) -> list[dict[str, Any]]:
    return [STUDY["series"][0] | changes]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"mesure": ["length"]}, "mesure: unknown key. Did you mean 'measure'?"),
        ({"series": []}, "series: must hold at least one series"),
        ({"series": series(very={})}, "series[0].very: unknown key. Did you mean 'vary'?"),
        ({"series": series(set={"solver..x": 1})}, "series[0].set.solver..x: 'solver..x' is not a key"),
        ({"series": series(set={"effects[].density": 1})}, "put a number between the brackets"),
        (
            {"series": series(vary={"a.b": [1, 2], "c": [1]})},
            "needs the same number of values of each key, and at least one",
        ),
        ({"series": series(vary={"a.b": []})}, "needs the same number of values of each key, and at least one"),
        ({"series": series(labels=["x"])}, "series[0].labels: must be as many as there are runs, 3, not 1"),
        ({"series": series(set={"mesh.parameters.nz": 1})}, "series[0].vary.mesh.parameters.nz: is also in 'set'"),
        ({"series": series() * 2}, "series[1].name: 'P2' is the name of an earlier series"),
        ({"series": series(base="P4")}, "series[0].base: there is no series 'P4'. Known: P2"),
        (
            {"series": series(take={"solver.tolerance": {"series": "P2", "key": "errors.x", "at_least": 0.1}})},
            "series[0].take.solver.tolerance.series: there is no earlier series 'P2'",
        ),
        ({"measure": []}, "measure: must name at least one quantity"),
        ({"measure": ["length", "length"]}, "measure[1]: 'length' is duplicated"),
        ({"reference": "best"}, "reference.all: must be a value (closed form), finest, richardson"),
        ({"reference": {"lenght": 1, "all": "finest"}}, "reference.lenght: is not measured. Did you mean 'length'?"),
        ({"reference": {"richardson": "P4"}}, "reference.all: there is no series 'P4'. Known: P2"),
        ({"measure": ["length", "solutions[0].J.min"]}, "reference: is needed for 'solutions[0].J.min' too"),
        (
            {"cases": [{"random": {"material.mu": [1, 2]}}]},
            "cases[0].count: is needed: the number of points",
        ),
        (
            {"cases": [{"random": {"material.mu": ["1 kPa", "2 m"]}, "count": 2}]},
            "must have two values of the same dimension",
        ),
        ({"cases": [{"random": {"material.mu": [2, 1]}, "count": 2}]}, "must begin below its end, not 2 and 1"),
        (
            {"cases": [{"random": {"material.mu": {"log-uniform": [0, 1]}}, "count": 2}]},
            "cases[0].random.material.mu: must begin above 0 to be log-uniform",
        ),
        ({"cases": [{"grid": {"material.mu": []}}]}, "cases[0].grid.material.mu: must have at least one value"),
        (
            {"cases": [{"zip": {"material.mu": [1], "material.lam": [1, 2]}}]},
            "needs the same number of values of each key",
        ),
        ({"cases": [{"grid": {"material.mu": [1]}, "seed": 1}]}, "cases[0].seed: is valid only with a sample"),
        ({"costs": {"time": "mesh.cells"}}, "costs.time: is the name of another column"),
        ({"beside": {"source": "x", "values": {"tip": {}}}}, "beside.values.tip: is not measured"),
        (
            {"beside": {"source": "x", "statistics": {"length": {"P2": {"avrage": 1.0}}}}},
            "beside.statistics.length.P2.avrage: is not a statistic. Did you mean 'average'?",
        ),
        ({"repeat": 0}, "repeat: must be at least 1, not 0"),
        (
            {"cases": [{"random": {"material.mu": [1, 2]}, "count": 10**12}]},
            "cases: make 5,000,000,000,000 runs, but a study can have no more than 100,000",
        ),
        (
            {"cases": [{"grid": {f"material.{n}": [*range(100)] for n in "abcd"}}]},
            "cases: make 500,000,000 runs",
        ),
        ({"job": "colum.yaml"}, "no such file. Did you mean 'column.yaml'?"),
    ],
)
def test_faults_of_a_study_are_reported(changes: dict[str, Any], expected: str, tmp_path: Path) -> None:
    [problem] = problems(tmp_path, **changes)
    assert expected in problem


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"measure": ["lenght"], "reference": "finest"},
            "P2, 1 (and 4 more runs): measure[0]: the job has no",
        ),
        ({"measure": ["top"], "reference": "finest"}, "'top' is a vector: measure top[0], top[1] or top[2]"),
        ({"measure": ["length[0]"], "reference": "finest"}, "'length' is one number, without parts"),
        ({"measure": ["errors.round_trip.max"], "reference": 0}, "needs 'analysis: round_trip' in the job"),
        ({"measure": ["errors.expected_shape.max"], "reference": 0}, "needs an 'expected_shape' in the job"),
        (
            {"series": series(vary={"mesh.parameters.n": [4]})},
            "P2, 4: mesh.parameters.n: box.py has no such",
        ),
        (
            {"series": series(set={"effects[1].density": 1})},
            "cannot set effects[1].density: [1] is not an entry of a list of 1",
        ),
        (
            {"series": series(set={"analysis.x": 1})},
            "cannot set analysis.x: 'x' cannot be set in",
        ),
        (
            {"cases": [{"grid": {"mesh.parameters.nz": [1]}}]},
            "mesh.parameters.nz is set by both the series",
        ),
    ],
)
def test_faults_of_a_study_run_are_reported_once(changes: dict[str, Any], expected: str, tmp_path: Path) -> None:
    [problem] = problems(tmp_path, **changes)
    assert expected in problem


def test_everything_that_is_wrong_with_the_runs_is_reported_before_any_begins(tmp_path: Path) -> None:
    series = [
        {"name": "sizes", "vary": {"mesh.parameters.nz": [1, "2 m", 4]}},
        {"name": "degrees", "vary": {"discretisation.displacement": [2, 9]}},
    ]
    assert problems(tmp_path, series=series) == [
        "sizes, 2 m: mesh.parameters.nz: must be a whole number, not '2 m'",
        "degrees, 9: discretisation.displacement: must be at most 4, not 9",
    ]


def test_runs_are_case_by_case_series_by_series_step_by_step(tmp_path: Path) -> None:
    sweep_plan = plan(tmp_path, cases=[{"grid": {"material.mu": ["10 kPa", 2e4]}}])
    assert [run.place.title for run in sweep_plan.runs] == [
        f"{name}, mu {mu}" for mu in ("10 kPa", "20000") for name in ("P2, 1", "P2, 2", "P2, 4", "P3, 1", "P3, 2")
    ]
    assert [run.job.mesh.parameters["nz"] for run in sweep_plan.runs] == [1, 2, 4, 1, 2] * 2
    assert [run.job.discretisation.displacement for run in sweep_plan.runs] == [2, 2, 2, 3, 3] * 2
    assert [law.mu for run in sweep_plan.runs for law in run.job.laws.values()] == [1e4] * 5 + [2e4] * 5  # type: ignore[attr-defined]
    assert {run.job.mesh.parameters["lx"] for run in sweep_plan.runs} == {0.2}  # what nothing changes stays


def test_every_kind_of_series_that_is_asked_for_can_be_written(tmp_path: Path) -> None:
    series = [
        {"name": "geometry degree", "vary": {"mesh.geometry_degree": [1, 2]}},
        {"name": "quadrature", "vary": {"discretisation.quadrature": [2, 4]}},
        {"name": "tolerance", "vary": {"solver.tolerance": [1e-4, 1e-8]}},
        {"name": "linear solver", "vary": {"solver.petsc": [{}, {"ksp_type": "gmres"}]}, "labels": ["LU", "GMRES"]},
        {"name": "method", "vary": {"method": ["direct", "sellier"]}},
        {"name": "mesh file", "vary": {"mesh": [COLUMN["mesh"], COLUMN["mesh"] | {"partition": "scotch"}]}},
    ]
    runs = plan(tmp_path, series=series).runs
    assert [run.job.mesh.geometry_degree for run in runs[:2]] == [1, 2]
    assert [run.job.discretisation.quadrature for run in runs[2:4]] == [2, 4]
    assert [run.job.solver.tolerance for run in runs[4:6]] == [1e-4, 1e-8]
    assert [(run.place.label, dict(run.job.solver.petsc)) for run in runs[6:8]] == [
        ("LU", {}),
        ("GMRES", {"ksp_type": "gmres"}),
    ]
    assert [run.job.method for run in runs[8:10]] == ["direct", "sellier"]
    assert [run.job.mesh.partition for run in runs[10:]] == ["metis", "scotch"]


@pytest.mark.release
def test_cases_are_combined_side_by_side_and_drawn_at_random(tmp_path: Path) -> None:
    law = {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.3}
    random = {"material.mu": ["2 kPa", "200 kPa"], "material.lam": [8e4, 8e6]}
    branches = {
        "grid": {"axes": [{"grid": {"material.mu": [1, 2], "material.lam": [10, 20, 30]}}]},
        "zip": {"axes": [{"zip": {"material.mu": [1, 2], "material.lam": [10, 20]}}]},
        "young": {"set": {"material": law}, "axes": [{"zip": {"material.poisson": [0.2, 0.4]}}]},
        "one": {"set": {"material.mu": 7}},
        "sample": {"axes": [{"random": random, "count": 60, "seed": 3}]},
    }
    cases = [{"branches": branches}]
    sweep_plan = plan(tmp_path, series=[{"name": "all"}], cases=cases)
    assert sweep_plan.cases == 6 + 2 + 2 + 1 + 60
    pairs = [tuple(run.place.parameters.values())[1:] for run in sweep_plan.runs]
    assert pairs[:8] == [(1, 10), (1, 20), (1, 30), (2, 10), (2, 20), (2, 30), (1, 10), (2, 20)]
    (first, second) = (next(iter(run.job.laws.values())) for run in sweep_plan.runs[8:10])
    for law_, nu in ((first, 0.2), (second, 0.4)):
        assert law_.lam == pytest.approx(1e6 * nu / ((1 + nu) * (1 - 2 * nu)))  # type: ignore[attr-defined]
    drawn = pairs[11:]
    assert all(2e3 < mu < 2e5 and 8e4 < lam < 8e6 for mu, lam in drawn)
    # Uniform: the mean is within three standard errors of the middle.
    mean = math.fsum(mu for mu, _ in drawn) / 60
    assert abs(mean - 101e3) < 3 * 198e3 / math.sqrt(12 * 60)
    assert drawn == [tuple(r.place.parameters.values())[1:] for r in plan(tmp_path, cases=cases).runs[11 * 5 :: 5]]


def test_log_uniform_cases_fall_equally_often_in_each_decade(tmp_path: Path) -> None:
    random = {"random": {"material.mu": {"log-uniform": [1, 1e4]}}, "count": 400}
    drawn = [
        run.place.parameters["material.mu"] for run in plan(tmp_path, series=[{"name": "all"}], cases=[random]).runs
    ]
    decades = [sum(10**k <= mu < 10 ** (k + 1) for mu in drawn) for k in range(4)]
    assert sum(decades) == 400
    assert all(abs(count - 100) < 3 * math.sqrt(75) for count in decades)  # binomial, 400 × 1/4


def test_keys_reach_into_jobs_and_summaries() -> None:
    assert parse_key("effects[0].density") == ("effects", 0, "density")
    data = {"mesh": {"file": "a"}, "effects": [{"effect": "gravity"}]}
    changed = assigned(data, {"mesh.parameters.size": 1, "effects[0].density": 2, "solver.petsc.ksp_type": "cg"})
    assert changed == {
        "mesh": {"file": "a", "parameters": {"size": 1}},
        "effects": [{"effect": "gravity", "density": 2}],
        "solver": {"petsc": {"ksp_type": "cg"}},
    }
    assert data == {"mesh": {"file": "a"}, "effects": [{"effect": "gravity"}]}, "the data are copied"
    summary = {"solutions": [{"n": 2, "J": {"min": 0.5}}, {"n": 3}, {"m": 1}], "quantities": {"tip": [1.0, None, 3.0]}}
    assert look_up(summary, "solutions[1].n") == 3.0
    assert look_up(summary, "solutions[].n") == 5.0
    assert look_up(summary, "solutions[0].J.min") == 0.5
    assert look_up(summary, "quantities.tip[2]") == 3.0
    for absent in ("solutions[7].n", "solutions[].k", "quantities.tip[1]", "quantities.top", "solutions"):
        assert look_up(summary, absent) is None


@pytest.mark.release
def test_validate_takes_studies_and_loads_neither_mpi_nor_the_solver(tmp_path: Path) -> None:
    plan(tmp_path)
    studies = [str(p) for p in sorted((ROOT / "jobs").glob("*.yaml")) if "series:" in p.read_text()]
    assert len(studies) >= 4
    files = [*studies, str(tmp_path / "study.yaml"), str(tmp_path / "column.yaml")]
    code = (
        f"import sys; from hpcinv.__main__ import main; c = main(['validate', *{files}]); print(*sys.modules); exit(c)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(": valid\n") == len(files)
    assert not {"mpi4py", "petsc4py", "dolfinx", "gmsh", "ufl", "numpy", "h5py", "matplotlib"} & set(
        done.stdout.split()
    )


def test_sizes_of_an_image_are_meshes_to_extrapolate_from() -> None:
    """What varies is the mesh; a study with two meshes, or with none, is refused before anything is run."""
    content = {
        "job": "scan.yaml",
        "series": [{"name": "size", "vary": {"mesh.size": ["20 mm", "15 mm", "10 mm"]}}],
        "measure": ["length"],
        "reference": "richardson",
    }
    assert Study.model_validate(content).reference_of("length").kind == "richardson"
    for vary, why in (({"mesh.size": [2, 1]}, "with 3 meshes"), ({"material.mu": [1, 2, 3]}, "nothing but the mesh")):
        with pytest.raises(ValidationError, match=why):
            Study.model_validate(content | {"series": [{"name": "size", "vary": vary}]})
