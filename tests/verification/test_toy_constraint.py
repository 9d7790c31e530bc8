"""A constraint from one file outside the package: both directions, certificate, sensitivities and a resumed run."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.quantity.keys import assigned
from hpcinv.base.quantity.written_units import as_shown
from hpcinv.errors import JobError
from hpcinv.mesh import build_body
from hpcinv.output.text_report import report
from hpcinv.physics.effects import effects
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED, Start
from hpcinv.solver.observer import SILENT
from hpcinv.solver.workspace import Workspace

PLUGIN = '''
"""A given mean displacement of a face, whose reaction is an unknown uniform traction."""

from typing import Annotated, Any, ClassVar, Literal

from hpcinv.base.quantity import Length, Quantity, Stress, Surface
from hpcinv.physics.effects.effect import Effect, Kinematics


class MeanDisplacement(Effect):
    """Mean displacement of a face along an axis, less what a spring gives way to the reaction."""

    example: ClassVar = {"effect": "mean-displacement", "region": "x1", "axis": 0, "displacement": "1 mm"}
    finds: ClassVar = "reaction"

    effect: Literal["mean-displacement"] = "mean-displacement"
    region: Surface
    """region of the boundary"""
    axis: int
    """0, 1 or 2"""
    displacement: Length
    """mean over the undeformed area"""
    compliance: Annotated[float, Quantity("m/Pa")] = 0.0
    """of the spring"""
    reaction: Stress | None = None
    """force per undeformed area; left out, the solve finds it"""

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        return k.dA(load * par.reaction * v[self.axis], self.region)

    def constraint(self, k: Kinematics, u: Any, load: Any, par: Any) -> Any:
        given = load * (par.displacement - par.compliance * par.reaction)
        return k.dA(u[self.axis] - given, self.region)
'''
DISPLACEMENT, COMPLIANCE = 0.2, 2e-6
HELD = {
    "effect": "mean-displacement",
    "region": "x1",
    "axis": 0,
    "displacement": DISPLACEMENT,
    "compliance": f"{COMPLIANCE} m/Pa",
}
WEIGHT = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 200}


@pytest.fixture(scope="module", autouse=True)
def plugin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    file = tmp_path_factory.mktemp("plugin") / "mean_displacement.py"
    file.write_text(PLUGIN)
    yield file
    if kind := effects().get("mean-displacement"):
        kind.model_fields.pop("effect")  # other tests of this process do not see it


def given(plugin: Path, **changes: Any) -> dict[str, Any]:
    """A block that is clamped at one end, sags, and is pulled at the other."""
    return {
        "plugins": [str(plugin)],
        "mesh": box((1, 1, 1), hexahedra=True),
        "material": {"law": "neo-hookean", "mu": 1e4, "lam": 4e4},
        "effects": [HELD, WEIGHT],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "quantities": [
            {"name": "corner", "of": "displacement", "at": [0.9, 0.9, 0.9]},
            {"name": "stress", "of": "von_mises", "on": "x1", "reduce": "mean"},
        ],
        "solver": {"tolerance": 1e-13},
    } | changes


def mean_displacement(solution: Any) -> float:
    """Mean over the undeformed end face, one bi-quadratic square, by Simpson's rule."""
    nodes = solution.reference_nodes
    end = nodes[:, 0] > 1 - 1e-9
    weights = np.where(np.isclose(nodes[end][:, 1:], 0.5), 4, 1).prod(axis=1) / 36
    assert len(weights) == 9
    return float(weights @ solution.u[end][:, 0])


def test_both_directions_find_the_same_reaction_and_shape(plugin: Path) -> None:
    run = hpcinv.run(job(**given(plugin, analysis="round_trip", first="forward", certificate="standard")))
    there, back = run.solutions
    (found,), (again,) = there.constraints, back.constraints
    assert mean_displacement(there) == pytest.approx(DISPLACEMENT - COMPLIANCE * found.value, rel=1e-12)
    assert again.value == pytest.approx(found.value, rel=1e-10)
    text = f"reaction {as_shown(found.value, 'Pa', run.statistics['units'])}"
    assert f"  effects[0]: {text}" in report(run.statistics)
    assert back.u == pytest.approx(there.u, abs=1e-11)
    lines = {line.topic.name: line for line in run.certificate.lines}
    assert run.certificate.verdict.value == "pass"
    assert lines["constraint of 'effects[0]', relative to its terms"].value < 1e-12
    assert lines["stability: unstable directions"].value == 0

    traction = {"effect": "traction", "region": "x1", "traction": [found.value, 0, 0], "area_in": "reference"}
    for effect in (traction, HELD | {"reaction": found.value}):
        pulled = hpcinv.run(job(**given(plugin, analysis="forward", effects=[effect, WEIGHT])))
        assert not pulled.solutions[0].constraints
        assert pulled.solutions[0].u == pytest.approx(there.u, abs=1e-11)


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
def test_sensitivities_agree_with_differences_of_runs(analysis: str, plugin: Path) -> None:
    values = {
        "effects[0].displacement": DISPLACEMENT,
        "effects[0].compliance": COMPLIANCE,
        "effects[1].density": 200,
        "material.mu": 1e4,
    }
    posed = given(plugin, analysis=analysis, certificate=NO_CERTIFICATE)
    with Workspace(MPI.COMM_SELF) as workspace:

        def found(**changes: Any) -> Any:
            return hpcinv.run(job(**posed | changes), workspace=workspace)

        slopes = found(sensitivities=list(values)).sensitivities.slopes
        # All numbers change together, each by another share of its value.
        rates = {key: (1 + 0.7 * i) * (-1) ** i * value for i, (key, value) in enumerate(values.items())}
        ahead, behind = (
            found(**assigned(posed, {key: values[key] + h * rate for key, rate in rates.items()})).quantities
            for h in (1e-4, -1e-4)
        )
    for name in ahead:
        difference = (np.array(ahead[name]) - behind[name]) / 2e-4
        parts = [rate * np.array(slopes[name][key]) for key, rate in rates.items()]
        scale = max(np.abs(part).max() for part in parts)
        assert sum(parts) == pytest.approx(difference, rel=0, abs=3e-6 * scale)


def test_the_spring_gives_way_at_parts_of_the_load(plugin: Path) -> None:
    """The number that the solve finds is per load factor, and so is the derivative of the spring's equation."""
    soft = HELD | {"compliance": "2e-5 m/Pa"}
    steps = {"tolerance": 1e-13, "strategy": "fixed", "steps": 4}
    posed = job(**given(plugin, analysis="forward", effects=[soft], solver=steps, certificate=NO_CERTIFICATE))
    (there,) = hpcinv.run(posed).solutions
    assert [solve.load for solve in there.solves] == [0.25, 0.5, 0.75, 1.0]
    (found,) = there.constraints
    assert mean_displacement(there) == pytest.approx(DISPLACEMENT - 2e-5 * found.value, rel=1e-12)


@pytest.mark.release
def test_a_path_goes_on_from_a_checkpoint(plugin: Path) -> None:
    posed = job(**given(plugin, analysis="forward"))

    def model() -> Equations:
        body = build_body(posed.mesh, posed.regions, MPI.COMM_SELF, resolve=posed.resolve, degree=2)
        return Equations(posed, body, Timings())

    whole = model()
    (found,) = solve_direction(whole, "forward", UNLOADED, SILENT).constraints
    half = job(**given(plugin, analysis="forward", effects=[HELD | {"displacement": 0.1}, WEIGHT | {"density": 100}]))
    run = hpcinv.run(half)
    (reached,) = run.solutions[0].constraints
    again = model()
    u = again.unknowns.displacement()
    u.x.array[:] = run.solutions[0].displacement.x.array
    again.put_fields((u, None))
    start = Start(solution=(u, None), load=0.5)
    assert reached.value == pytest.approx(found.value / 2, rel=0.2)
    (resumed,) = solve_direction(again, "forward", start, SILENT).constraints
    assert resumed.value == pytest.approx(found.value, rel=1e-10)
    at_end = Start(solution=whole.state().fields, load=1.0)
    (known,) = solve_direction(model(), "forward", at_end, SILENT).constraints
    assert known.value == pytest.approx(found.value, rel=1e-9)


def test_a_finished_run_is_resumed_with_its_reaction(
    plugin: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    posed = job(**given(plugin, analysis="inverse"))
    first = hpcinv.run(posed, directory=tmp_path / "out")
    (tmp_path / "out" / "summary.json").unlink()
    monkeypatch.setattr(Equilibrium, "solve", None)
    again = hpcinv.run(posed, directory=tmp_path / "out", resume=True)
    assert again.solutions[0].constraints[0].value == pytest.approx(first.solutions[0].constraints[0].value, rel=1e-9)


def test_what_cannot_be_solved_is_refused(plugin: Path, tmp_path: Path) -> None:
    for changes in ({"method": "sellier", "analysis": "inverse"}, {"accuracy": {"corner": "1 mm"}}):
        with pytest.raises(JobError, match=r"is not possible with .* that the solve finds"):
            job(**given(plugin, **changes))
    with pytest.raises(JobError, match=r"effects\[0\]\.case: must be the first load case, or give 'reaction'"):
        job(**given(plugin, load_cases=["pull", "sag"], effects=[HELD | {"case": "sag"}, WEIGHT]))
    wrong = tmp_path / "wrong.py"
    text = inspect.cleandoc(PLUGIN).replace("mean-displacement", "no-integral")
    wrong.write_text(text.replace("return k.dA(u[self.axis] - given, self.region)", "return u[self.axis]"))
    with pytest.raises(JobError, match="constraint returns no integral"):
        hpcinv.run(job(**given(wrong, effects=[HELD | {"effect": "no-integral"}])))
    effects()["no-integral"].model_fields.pop("effect")
