"""A body of OpenUSD in the simulator Newton, which uv installs: with its rest shape it stands still, else it sags."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import NO_CERTIFICATE, ROOT, hpcinv_here, write_job
from helpers.other_packages import run_alone

NEWTON = ("newton[importers]==1.8.0", "warp-lang==1.19.0")
STABLE_NEO_HOOKEAN = "mu/2*(I1 - 3) - mu*(J - 1) + (lam + mu)/2*(J - 1)^2"
"""energy of Newton's tetrahedra: Smith, de Goes and Kim (2018), DOI 10.1145/3180491"""

SIMULATE = """
import json
import newton
import numpy as np
from pxr import Usd, UsdGeom


def farthest(keeps_rest, steps=60, duration=1 / 600):
    stage = Usd.Stage.Open("beam.usda")
    body = stage.GetPrimAtPath("/beam/Body")
    if not keeps_rest:
        body.RemoveProperty("physics:restShapePoints")
    builder = newton.ModelBuilder()
    builder.add_usd(stage)
    sides = np.array(UsdGeom.TetMesh(body).GetSurfaceFaceVertexIndicesAttr().Get())
    for node in np.unique(sides[np.array(UsdGeom.Subset(body.GetChild("x0")).GetIndicesAttr().Get())]):
        builder.particle_mass[node] = 0.0  # held
    builder.color()
    model = builder.finalize()
    options = {"particle_enable_self_contact": False, "particle_enable_tile_solve": False}
    solver = newton.solvers.SolverVBD(model=model, iterations=200, **options)
    state, after, control = model.state(), model.state(), model.control()
    start, moved = state.particle_q.numpy().copy(), 0.0
    for _ in range(steps):
        state.clear_forces()
        solver.step(state, after, control, None, duration)
        state, after = after, state
        moved = max(moved, float(np.linalg.norm(state.particle_q.numpy() - start, axis=1).max()))
    return moved


json.dump({"with": farthest(True), "without": farthest(False)}, open("found.json", "w"))
"""


@pytest.mark.release
def test_a_beam_stands_still_with_its_rest_shape(tmp_path: Path) -> None:
    """Over a tenth of a second, with the law and the linear tetrahedra of Newton."""
    sizes = {"lx": 0.2, "ly": 0.05, "lz": 0.05, "nx": 12, "ny": 3, "nz": 3}
    job: dict[str, Any] = {
        "analysis": "inverse",
        "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": sizes},
        "material": {"law": "formula", "energy": STABLE_NEO_HOOKEAN, "parameters": {"mu": "30 kPa", "lam": "90 kPa"}},
        "discretisation": {"displacement": 1, "formulation": "displacement"},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "certificate": NO_CERTIFICATE,
        "output": {"fields": False},
    }
    write_job(tmp_path / "beam.yaml", job)
    ran = hpcinv_here("run", "beam.yaml", "--output", "run", "--quiet", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    done = hpcinv_here("export", "run", "--to", "beam.usda", "--unit", "m", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (tmp_path / "simulate.py").write_text(SIMULATE)
    run_alone(NEWTON, tmp_path / "simulate.py")
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["without"] > 0.02  # m: its end falls by 64 mm in a tenth of a second
    assert found["with"] < 1e-5  # m: single precision, and what 200 sweeps of its solver leave
