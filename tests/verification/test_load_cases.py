"""Load cases that follow each other: where the path stops, what the body is there, and that its end is always the same.

The material is hyperelastic, so that the state at the end of each case depends on the loads that are there alone.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import ROOT, hpcinv_here, write_job
from helpers.mesh_cases import spec
from helpers.verification import box, job

import hpcinv as package
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import CheckpointError, Interrupted, JobError
from hpcinv.mesh import build_body, read_source
from hpcinv.output.progress import Progress
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium_path import EquilibriumPath
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SolveEvent

WEIGHT = {"effect": "gravity", "acceleration": [0, -2, -1], "density": "1 g/cm^3"}
PUSH = {"effect": "pressure", "region": "z1", "pressure": "1 kPa"}
HELD = {"region": "x0", "fix": ["x", "y", "z"]}
MOVED = {"region": "x1", "displacement": ["0.3*x", "-0.2*z", None]}
STILL = {"region": "x1", "displacement": [0, 0, None]}
BODY: dict[str, Any] = {
    "mesh": box((2, 2, 2), hexahedra=True),
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "30 kPa"},
    "discretisation": {"displacement": 1},
}


@dataclass
class LoadPath:
    """Every accepted state (m) of a job's first solution by its load factor, and all solves."""

    states: dict[float, np.ndarray]
    solves: list[Solve]

    @classmethod
    def of(cls, comm: MPI.Intracomm, **data: Any) -> LoadPath:
        given = job(**BODY | {"analysis": "forward"} | data)
        body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
        model = Equations(given, body, Timings())
        equilibrium = model.equilibrium(model.weak_form(given.directions[0]))
        path = cls({}, [])
        for solve in EquilibriumPath(equilibrium, given.solver.tolerance, given.case_count).follow(model.steps):
            path.solves.append(solve)
            if solve.outcome.accepted:
                path.states[solve.load] = model.unknowns.displacement().x.array * body.length_scale
        equilibrium.destroy()
        return path

    @property
    def end(self) -> np.ndarray:
        return self.states[1.0]


def gap(comm: MPI.Intracomm, result: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference, as a share of the largest displacement."""
    error, size = (comm.allreduce(float(np.abs(a).max(initial=0.0)), op=MPI.MAX) for a in (result - expected, expected))
    return float(error / size)


def sequence(*cases: str, **data: Any) -> dict[str, Any]:
    """Weight in one case, pressure and the motion of a support in the other."""
    return {
        "load_cases": cases,
        "effects": [WEIGHT | {"case": "weight"}, PUSH | {"case": "push"}],
        "supports": [HELD, MOVED | {"case": "push"}],
        **data,
    }


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_the_path_meets_the_end_of_each_case_and_ends_where_all_loads_at_once_end(comm: MPI.Intracomm) -> None:
    fixed = {"solver": {"strategy": "fixed", "steps": 2}}
    together = LoadPath.of(comm, effects=[WEIGHT, PUSH], supports=[HELD, MOVED])
    weight = LoadPath.of(comm, effects=[WEIGHT, PUSH | {"pressure": 0}], supports=[HELD, STILL])
    push = LoadPath.of(comm, effects=[WEIGHT | {"density": 0}, PUSH], supports=[HELD, MOVED])
    assert gap(comm, weight.end, together.end) > 0.1
    assert gap(comm, push.end, together.end) > 0.1

    for cases, alone in ((("weight", "push"), weight), (("push", "weight"), push)):
        adaptive = LoadPath.of(comm, **sequence(*cases))
        steps = LoadPath.of(comm, **sequence(*cases), **fixed)
        assert 0.5 in adaptive.states
        assert list(steps.states) == [0.25, 0.5, 0.75, 1.0]
        ends = [gap(comm, path.end, together.end) for path in (adaptive, steps)]
        # Steps of the adaptive path that only lead the way are solved to 1e-4.
        middles = [gap(comm, path.states[0.5], alone.end) for path in (adaptive, steps)]
        print(f"{' then '.join(cases)}, {comm.size} ranks, adaptive and fixed: ends {ends}, between cases {middles}")
        assert max(ends) < 1e-11
        assert middles[0] < 1e-4
        assert middles[1] < 1e-11


@pytest.mark.release
def test_inverse_paths_follow_load_cases_and_the_first_takes_loads_without_case(comm: MPI.Intracomm) -> None:
    inverse = {"analysis": "inverse"}
    together = LoadPath.of(comm, effects=[WEIGHT, PUSH], supports=[HELD, MOVED], **inverse)
    push = LoadPath.of(comm, effects=[WEIGHT | {"density": 0}, PUSH], supports=[HELD, MOVED], **inverse)
    path = LoadPath.of(
        comm,
        load_cases=["first", "weight", "nothing"],
        effects=[WEIGHT | {"case": "weight"}, PUSH],
        supports=[HELD, MOVED],
        solver={"strategy": "fixed", "steps": 1},
        **inverse,
    )
    assert list(path.states) == [1 / 3, 2 / 3, 1.0]
    errors = [gap(comm, path.states[load], p.end) for load, p in ((1 / 3, push), (2 / 3, together), (1.0, together))]
    print(f"inverse: {errors}")
    assert max(errors) < 1e-11


def test_steps_are_shares_of_a_case(comm: MPI.Intracomm) -> None:
    path = LoadPath.of(comm, **sequence("weight", "push"), solver={"initial_step": 0.25})
    assert path.solves[0].load == 0.125
    assert {0.5, 1.0} <= path.states.keys()
    too_far = MOVED | {"displacement": ["-2*x", 0, 0], "case": "push"}
    failed = LoadPath.of(comm, **sequence("weight", "push", supports=[HELD, too_far]), solver={"minimum_step": 0.5})
    loads = [s.load for s in failed.solves]
    assert loads[0] == 0.5
    assert len(loads) > 1
    assert all(0.75 <= load <= 1.0 for load in loads[1:])
    assert list(failed.states) == [0.5]


# restart


class StopsAt(Progress):
    """Asks the run to stop once a load factor is reached, as a signal would."""

    def __init__(self, load: float) -> None:
        super().__init__(MPI.COMM_SELF, None)
        self.load, self.reached = load, False

    def solved(self, event: SolveEvent) -> None:
        self.reached |= event.solve.load == self.load


@pytest.mark.release
def test_a_run_stopped_between_cases_goes_on_with_the_next(tmp_path: Path) -> None:
    base = BODY | sequence("weight", "push") | {"analysis": "round_trip", "output": {"fields": False, "mesh": ["msh"]}}
    base |= {"mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": BODY["mesh"]["parameters"]}}
    base |= {"load_cases": ["weight", "push"]}
    given = package.load(write_job(tmp_path / "cases.yaml", base))
    whole = package.run(given, MPI.COMM_SELF, directory=tmp_path / "whole")
    assert whole.errors["round_trip"]["relative"] < 1e-11

    stopping = StopsAt(0.5)
    with pytest.raises(Interrupted):
        package.run(
            given,
            MPI.COMM_SELF,
            directory=tmp_path / "run",
            progress=stopping,
            stop_asked=lambda: stopping.reached,
        )
    newest = max((tmp_path / "run" / "checkpoints").iterdir())
    position = json.loads((newest / "state.json").read_text())["position"]
    assert (position["direction"], position["load"]) == (0, 0.5)

    other = package.load(write_job(tmp_path / "other.yaml", base, load_cases=["push", "weight"]))
    with pytest.raises(CheckpointError, match=r"load_cases\[0\]: weight -> push"):
        package.run(other, MPI.COMM_SELF, directory=tmp_path / "run", resume=True)

    done = hpcinv_here("resume", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "load 0.5:" not in done.stdout.partition("forward:")[0]
    summaries = [json.loads((tmp_path / name / "summary.json").read_text()) for name in ("whole", "run")]
    loads = [[[s["load"] for s in solution["solves"]] for solution in content["solutions"]] for content in summaries]
    assert loads[0] == loads[1]
    shapes = [
        read_source(spec(file), file).points for file in (tmp_path / name / "shape.msh" for name in ("whole", "run"))
    ]
    assert np.abs(shapes[1] - shapes[0]).max() < 1e-11


# what is refused


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"load_cases": ["weight"]}, "effects[1].case: 'push' is not among 'load_cases'"),
        (
            {"load_cases": ["weight", "pushing"]},
            "effects[1].case: 'push' is not among 'load_cases'. Did you mean 'pushing'?",
        ),
        ({"load_cases": []}, "effects[0].case: 'weight' is not among 'load_cases'"),
        ({"load_cases": ["weight", "push", "weight"]}, "load_cases[2]: 'weight' is duplicated"),
        ({"load_cases": ["my weight"]}, "load_cases[0]: 'my weight' is not a name"),
        ({"load_cases": "weight"}, "load_cases: must be a list, not 'weight'"),
        (
            {"supports": [HELD | {"case": "push"}]},
            "supports[0].case: is not valid without 'displacement': what is fixed is fixed in every load case",
        ),
        ({"supports": [HELD, MOVED | {"case": "pull"}]}, "supports[1].case: 'pull' is not among 'load_cases'"),
        ({"supports": [HELD, MOVED | {"case": 1}]}, "supports[1].case: must be text, not 1"),
    ],
)
def test_a_case_that_is_none_is_refused_with_its_field(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(JobError) as caught:
        job(**BODY | sequence("weight", "push") | changes)
    assert any(p.split(": ", 1)[1].startswith(text) for p in caught.value.problems), caught.value.problems
