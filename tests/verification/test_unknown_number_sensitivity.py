"""Derivatives where pressures of cavities or motions under remote loads are unknown, by their numbers and others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.sheets import save_sheet
from helpers.thick_sphere import INNER, OUTER, sphere
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.keys import assigned
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.identification.identification_run import identify

HOLE = {"surface": "inner", "lid": {"apex": [0, 0, 0]}}
OCTANT = np.pi * INNER**3 / 6
FOUND = {"name": "p", "of": "pressure", "cavity": "hole"}
STEP = 1e-4


def filled(**changes: Any) -> dict[str, Any]:
    """An octant of an incompressible sphere that is filled to some volume."""
    octant = {key: value for key, value in sphere(1, hexahedra=True).data.items() if key != "effects"}
    quantities = [
        FOUND,
        {"name": "rest", "of": "volume", "cavity": "hole", "over": "reference"},
        {"name": "full", "of": "volume", "cavity": "hole"},
        {"name": "pole", "of": "displacement", "at": [0, 0, 1.2]},
        {"name": "stress", "of": "von_mises", "on": "inner", "reduce": "mean"},
    ]
    return octant | {"certificate": NO_CERTIFICATE, "quantities": quantities, "solver": {"tolerance": 1e-13}} | changes


def pulled(**changes: Any) -> dict[str, Any]:
    """A block that is clamped below, and turned above by a force and a moment."""
    remote = {"force": [300, -200, 400], "moment": [50, 200, 300], "about": [0.6, 0.4, 2.3]}
    return {
        "mesh": box((1, 1, 2)),
        "material": {"law": "neo-hookean", "mu": 1e4, "lam": 4e4},
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "remote": remote}],
        "quantities": [
            {"name": "middle", "of": "displacement", "at": [0.5, 0.5, 0.5]},
            {"name": "stress", "of": "von_mises", "on": "z1", "reduce": "mean"},
        ],
        "solver": {"tolerance": 1e-13},
    } | changes


def check_slopes(given: dict[str, Any], values: dict[str, float], comm: MPI.Intracomm) -> None:
    """Compare sums of slopes with differences of whole runs; each parameter changes by another share of its value."""
    with Workspace(comm) as workspace:

        def found(**changes: Any) -> Any:
            return hpcinv.run(job(**given | changes), comm, workspace=workspace)

        sensitivities = found(sensitivities=list(values)).sensitivities
        rates = {key: value * (1 + 0.7 * place) * (-1) ** place for place, (key, value) in enumerate(values.items())}
        ahead, behind = (
            found(**assigned(given, {key: values[key] + step * rate for key, rate in rates.items()}))
            for step in (STEP, -STEP)
        )
    for name, value in ahead.quantities.items():
        expected = (np.array(value) - behind.quantities[name]) / (2 * STEP)
        slopes = sum(rate * np.array(sensitivities.slopes[name][key]) for key, rate in rates.items())
        error = np.abs(slopes - expected).max() / max(np.abs(expected).max(), 1e-6)
        print(name, f"{error:.1e}")
        assert error < 1e-5  # differences to second order


VOLUMES = {"volume": OCTANT * 1.5}, {"unloaded_volume": OCTANT * 0.8}
GAS = {"gas": {"ambient": 0.5, "amount": 1.5}}
CHAMBER = {"windkessel": {"compliance": 0.5, "volume": 0.9, "pressure": -0.5}}


@pytest.mark.parallel([2, 1])
@pytest.mark.everyday("inverse-hole1", "forward-hole2")
@pytest.mark.parametrize(
    ("analysis", "hole"),
    [
        ("forward", VOLUMES[0]),
        ("inverse", VOLUMES[1]),
        *((analysis, control) for control in (GAS, CHAMBER) for analysis in ("forward", "inverse")),
    ],
)
def test_slopes_by_what_holds_a_cavity(analysis: str, hole: dict[str, Any], comm: MPI.Intracomm) -> None:
    ((key, control),) = hole.items()
    numbers = (
        {f"{key}.{name}": value for name, value in control.items()} if isinstance(control, dict) else {key: control}
    )
    values = {"material.c1": 2.0} | {f"cavities.hole.{name}": value for name, value in numbers.items()}
    given = filled(analysis=analysis, cavities={"hole": HOLE | hole})
    check_slopes(given | {"material": given["material"] | {"c1": 2.0}}, values, comm)  # its stress scale is not 1


@pytest.mark.parallel([2, 1])
def test_slopes_by_volumes_of_states(comm: MPI.Intracomm) -> None:
    states = [
        {"name": "filled", "given": True, "unloaded_volumes": {"hole": 0.45}},
        {"name": "half", "volumes": {"hole": 0.5}},
    ]
    values = {"material.c1": 0.5, "states[0].unloaded_volumes.hole": 0.45, "states[1].volumes.hole": 0.5}
    check_slopes(filled(states=states, cavities={"hole": HOLE}), values, comm)


def test_a_sphere_of_given_volume_has_the_slopes_of_its_closed_form(comm: MPI.Intracomm) -> None:
    """``p = 2 c1 [g(λ_b) - g(λ_a)]`` with the stretches of the faces, so that ``dp/dc1 = p/c1``; by the volume too."""

    def pressure(volume: float) -> float:
        grown = volume / OCTANT - 1
        outer = (1 + grown * (INNER / OUTER) ** 3) ** (1 / 3)
        g = [0.5 * (4 / s + s**-4) for s in (outer, (1 + grown) ** (1 / 3))]
        return float(g[0] - g[1])

    volume, step = 1.5 * OCTANT, 1e-4
    keys = ["material.c1", "cavities.hole.volume"]
    mesh = sphere(2, hexahedra=True).data["mesh"]
    sphere_job = filled(analysis="forward", mesh=mesh, cavities={"hole": HOLE | {"volume": volume}}, sensitivities=keys)
    result = hpcinv.run(job(**sphere_job), comm)
    slopes: Any = result.sensitivities.slopes  # type: ignore[union-attr]
    assert slopes["p"]["material.c1"] == pytest.approx(2 * result.quantities["p"], rel=1e-9)
    by_volume = (pressure(volume + step) - pressure(volume - step)) / (2 * step)
    print(slopes["p"], 2 * pressure(volume), by_volume)
    assert slopes["p"]["material.c1"] == pytest.approx(2 * pressure(volume), rel=5e-4)
    assert slopes["p"]["cavities.hole.volume"] == pytest.approx(by_volume, rel=5e-4)
    assert slopes["full"]["cavities.hole.volume"] == pytest.approx(1, rel=1e-10)
    assert abs(slopes["full"]["material.c1"]) < 1e-10


@pytest.mark.release
def test_slopes_at_the_largest_pressure_of_a_balloon(comm: MPI.Intracomm) -> None:
    """There the tangent at given pressure is singular. At given volume, all stresses are in proportion to ``c1``."""
    with Workspace(comm) as workspace:

        def found(volume: float) -> Any:
            holes = {"hole": HOLE | {"volume": volume}}
            given = filled(analysis="forward", cavities=holes, sensitivities=["cavities.hole.volume", "material.c1"])
            return hpcinv.run(job(**given), comm, workspace=workspace)

        volume, other = 4.121 * OCTANT, 4.1212 * OCTANT
        by_volume = [found(v).sensitivities.slopes["p"]["cavities.hole.volume"] for v in (volume, other)]
        while abs(by_volume[0]) > 1e-9:  # a secant leads to the next volume
            following = volume - by_volume[0] * (volume - other) / (by_volume[0] - by_volume[1])
            volume, other, result = following, volume, found(following)
            by_volume = [result.sensitivities.slopes["p"]["cavities.hole.volume"], by_volume[0]]
    slopes = {name: np.array(by_key["material.c1"]) for name, by_key in result.sensitivities.slopes.items()}
    assert slopes["stress"] == pytest.approx(2 * result.quantities["stress"], rel=1e-9)
    assert slopes["p"] == pytest.approx(2 * result.quantities["p"], rel=1e-9)
    assert np.abs([slopes["full"], *slopes["pole"]]).max() < 1e-10


@pytest.mark.parallel([2, 1])
@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
def test_slopes_under_a_remote_load(analysis: str, comm: MPI.Intracomm) -> None:
    """By a material parameter, and by force, moment and reference point."""
    remote = "supports[1].remote"
    values = {"material.mu": 1e4, f"{remote}.force[0]": 300, f"{remote}.force[1]": -200}
    values |= {f"{remote}.moment[2]": 300, f"{remote}.about[0]": 0.6, f"{remote}.about[2]": 2.3}
    check_slopes(pulled(analysis=analysis), values, comm)


@pytest.mark.everyday("forward")
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
def test_slopes_of_a_shell_with_a_gas(analysis: str, comm: MPI.Intracomm, tmp_path: Path) -> None:
    """By its thickness, which changes the mesh and with it the unloaded volume."""
    path = save_sheet(tmp_path / "arch.msh", 2, 1, arch)
    given = {
        "analysis": analysis,
        "mesh": {"file": str(path), "shell": {"thickness": 0.1}},
        "material": {"law": "neo-hookean", "mu": 3e4, "lam": 1.2e5},
        "supports": [{"region": name, "fix": ["x", "y", "z"]} for name in ("x0", "x1")],
        "cavities": {"hole": {"surface": "inner", "gas": {"ambient": 1e3, "amount": 1.1}}},
        "quantities": [
            FOUND,
            {"name": "full", "of": "volume", "cavity": "hole"},
            {"name": "rest", "of": "volume", "cavity": "hole", "over": "reference"},
            {"name": "top", "of": "displacement", "at": [0.5, 0.2, 0.3]},
        ],
        "certificate": "off",
        "solver": {"tolerance": 1e-13},
    }
    values = {"mesh.shell.thickness": 0.1, "material.mu": 3e4, "cavities.hole.gas.amount": 1.1}
    check_slopes(given, values, comm)


def arch(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Places of a sheet over a width of 1 m and a depth of 0.4 m, 0.3 m high."""
    return np.column_stack([s, 0.4 * t, 1.2 * s * (1 - s)])


@pytest.mark.everyday("force")
@pytest.mark.parametrize(
    ("given", "key", "true"),
    [
        (filled(analysis="forward", cavities={"hole": HOLE | VOLUMES[0]}), "cavities.hole.volume", 1.1 * OCTANT),
        (filled(analysis="forward", cavities={"hole": HOLE | VOLUMES[0]}), "material.c1", 0.6),
        (pulled(analysis="forward"), "supports[1].remote.force[0]", 350.0),
    ],
    ids=["volume", "material", "force"],
)
def test_numbers_are_identified(given: dict[str, Any], key: str, true: float, comm: MPI.Intracomm) -> None:
    given = given | {"solver": {}}
    name = given["quantities"][0]["name"]
    with Workspace(comm) as workspace:
        seen = hpcinv.run(job(**given | assigned(given, {key: true})), comm, workspace=workspace).quantities[name]
        observed = {"name": name, "quantity": name, "value": seen, "sd": 1e-3}
        section = {"parameters": {key: None}, "observations": [observed]}
        estimate = identify(job(**given, identify=section), comm, workspace=workspace).estimate
    assert estimate.values[0] == pytest.approx(true, rel=1e-6)
