"""Remote loads: force and moment on a region that moves as a rigid body, against closed forms and given motions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import MU, root
from helpers.verification import box, deform, job

from hpcinv import run
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError, MeshError
from hpcinv.mesh import build_body
from hpcinv.solver.constraints.remote_motions import RemoteMotion
from hpcinv.solver.equations import Equations

WIDTH = 0.2
AREA, INERTIA = WIDTH**2, WIDTH**4 / 12
BAR = {"analysis": "forward", "mesh": box((4, 1, 1), ly=WIDTH, lz=WIDTH, hexahedra=True)}
CLAMP = {"region": "x0", "fix": ["x", "y", "z"]}
MIDDLE = [1.0, WIDTH / 2, WIDTH / 2]
STRAIGHT = {"law": "neo-hookean", "mu": MU, "lam": 0.0}  # a bar in tension gets no thinner
LAW = {"law": "neo-hookean", "mu": MU, "lam": 4 * MU}
REACTIONS = [{"name": "force", "of": "reaction", "on": "x1"}, {"name": "moment", "of": "reaction_moment", "on": "x1"}]


def bar(remote: dict[str, Any], **changes: Any) -> Any:
    supports = [CLAMP, {"region": "x1", "remote": {"about": MIDDLE} | remote}]
    settings = BAR | {"material": LAW, "supports": supports, "solver": {"tolerance": 1e-12}}
    return job(**(settings | changes))


def test_tension_and_bending_of_a_straight_bar() -> None:
    comm = MPI.COMM_SELF
    force, moment = 0.3 * MU * AREA, 1e-6 * MU * INERTIA
    pulled = run(bar({"force": [force, 0, 0]}, material=STRAIGHT, analysis="round_trip", first="forward"), comm)
    stretch = root(lambda s: MU * AREA * (s - 1 / s) - force, 1.0, 2.0)
    (load,) = pulled.solutions[0].remote_loads
    assert load.motion.move == pytest.approx([stretch - 1, 0, 0], abs=1e-10)
    assert load.motion.rotate == pytest.approx(0.0, abs=1e-10)
    assert pulled.solutions[1].u == pytest.approx(pulled.solutions[0].u, abs=1e-10)
    (load,) = run(bar({"moment": [0, 0, moment]}, material=STRAIGHT), comm).solutions[0].remote_loads
    angle = moment / (2 * MU * INERTIA)  # of unit length, by Euler and Bernoulli
    assert load.motion.rotate == pytest.approx(angle, rel=1e-5)
    assert load.motion.move == pytest.approx([0, angle / 2, 0], abs=1e-5 * angle)


@pytest.mark.release
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("linear", ["direct", "iterative"])
def test_inverse_with_a_large_motion(comm: MPI.Intracomm, linear: str) -> None:
    remote = {"force": [0.4, -0.2, 0.3], "moment": [0.3, 0.2, 1.5], "about": [1.1, 0.2, 0.1]}
    solver = {"tolerance": 1e-12, "linear": linear}
    found = run(bar(remote, analysis="round_trip", first="inverse", solver=solver), comm)
    back, again = found.solutions
    assert again.u == pytest.approx(back.u, abs=1e-10)
    (load,), (again_load,) = back.remote_loads, again.remote_loads
    assert load.motion.rotate > 0.3
    assert again_load.motion.rotate == pytest.approx(load.motion.rotate, abs=1e-10)
    # The same motion as a support, whose reaction is the load.
    motion = {"region": "x1", "motion": load.motion.model_dump()}
    moment = [REACTIONS[0], REACTIONS[1] | {"about": remote["about"]}]
    held = run(job(**BAR | {"analysis": "inverse", "supports": [CLAMP, motion]}, material=LAW, quantities=moment), comm)
    assert held.solutions[0].u == pytest.approx(back.u, abs=1e-10)
    assert held.quantities["force"] == pytest.approx(remote["force"], abs=1e-8)
    assert held.quantities["moment"] == pytest.approx(remote["moment"], abs=1e-8)


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_derivatives_of_the_balance(comm: MPI.Intracomm) -> None:
    for direction in ("forward", "inverse"):
        spec = bar({"force": [0.4, 0, 0.1]}, analysis=direction)
        model = Equations(spec, build_body(spec.mesh, spec.regions, comm, resolve=spec.resolve, degree=2), Timings())
        system = model.equilibrium(model.weak_form(direction)).system
        border = RemoteMotion(system, 1, spec.remote_loads[1], model.scales)
        state, load, h = model.unknowns.state, 0.7, 2e-4
        deform(model.unknowns)
        border.change(np.array([0.1, 0.2, -0.1, 0.3, -0.5, 0.2]))
        border.put(load)
        x, kept = state.x.array.copy(), border.kept_numbers()
        step = state.copy()
        step.x.array[:] = np.cos(np.arange(len(x)))
        step.x.scatter_forward()
        system.set_load(load)
        by_numbers = border.linearise(load)
        for change in np.eye(6):
            slopes = border.slopes(step.x.petsc_vec) + by_numbers @ change
            values = []
            for k in (-2, -1, 1, 2):
                state.x.array[:] = x + k * h * step.x.array
                border.restore(kept)
                border.change(k * h * change)
                values.append(border.equations(load))
            state.x.array[:] = x
            border.restore(kept)
            difference = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)
            assert slopes == pytest.approx(difference, rel=1e-7, abs=1e-7 * np.abs(difference).max())
        model.supports.impose(state.x.array)  # as in a checkpoint
        border.restore((np.eye(3), np.zeros(3)))
        border.recover(load)
        for found, expected in zip(border.kept_numbers(), kept, strict=True):
            assert found == pytest.approx(expected, abs=1e-12)


def test_column_buckles_beyond_eulers_load() -> None:
    euler = np.pi**2 * 2.8 * MU * INERTIA / 4  # Young's modulus 2.8 μ
    verdicts = {}
    for share in (0.8, 1.3):
        checked = {"level": "full", "estimate": False, "overlap": False}
        column = run(bar({"force": [-share * euler, 0, 0]}, certificate=checked), MPI.COMM_SELF)
        verdicts[share] = {line.name.split(":")[0]: line for line in column.certificate.lines}
    assert verdicts[0.8]["stability of remote loads"].verdict.value == "pass"
    unstable = verdicts[1.3]["stability of remote loads"]
    assert (unstable.verdict.value, unstable.value) == ("fail", 2.0)
    assert verdicts[1.3]["stability"].verdict.value == "pass"


@pytest.mark.parametrize(
    ("remote", "changes", "text"),
    [
        ({"about": None}, {}, r"supports\[1\].remote.about"),
        ({"force": ["1 N", 0, "2 m"]}, {}, r"supports\[1\].remote.force"),
        ({}, {"method": "aitken", "analysis": "inverse"}, "method: is not possible with a remote load"),
        (
            {},
            {"mesh": BAR["mesh"] | {"surface_error": {"sd": "1 mm"}}},
            "mesh.surface_error: is not possible with a remote load",
        ),
        ({}, {"supports": [{"region": "x1", "remote": {"about": MIDDLE}}]}, "leave the body free to move along x and"),
    ],
)
def test_contradictions_are_refused(remote: dict[str, Any], changes: dict[str, Any], text: str) -> None:
    with pytest.raises(JobError, match=text):
        bar(remote, **changes)


def test_a_component_of_a_load_that_is_left_out_is_not_set() -> None:
    message = r"cannot set supports\[1\]\.remote\.force\[0\]: there is no list with an entry \[0\] yet; write the whole"
    with pytest.raises(JobError, match=message):
        bar({"moment": [0, 0, 1]}).with_({"supports[1].remote.force[0]": "1 N"})


@pytest.mark.parametrize("other", [{"region": "y0", "fix": ["y"]}, {"region": "y0", "fix": ["normal"]}])
def test_shared_nodes_are_refused(other: dict[str, Any]) -> None:
    spec = bar({}, supports=[CLAMP, {"region": "x1", "remote": {"about": MIDDLE}}, other])
    with pytest.raises(MeshError, match=r"supports\[1\].remote: other supports hold nodes of 'x1'"):
        run(spec, MPI.COMM_SELF)
