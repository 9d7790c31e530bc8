"""Cavities: volumes of both bodies, given volumes, gas, and connected cavities, in both directions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE, ROOT
from helpers.hollow_block import hollow_block
from helpers.thick_sphere import INNER, OUTER, PRESSURE, sphere
from helpers.verification import box, deform, job

import hpcinv
from hpcinv.base.parallel import code_cache
from hpcinv.base.parallel.petsc_vectors import dot
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError, MeshError
from hpcinv.mesh import build_body
from hpcinv.mesh.enclosed_volume import EnclosedVolume
from hpcinv.model.cavities import cavity_equations, check_cavities
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED, Start
from hpcinv.solver.newton import Floor
from hpcinv.solver.observer import SILENT
from hpcinv.trust.certificate import Line, Verdict

HOLE = {"surface": "inner", "lid": {"apex": [0, 0, 0]}}
VOLUMES = [{"name": over, "of": "volume", "cavity": "hole", "over": over} for over in ("reference", "current")]
OCTANT = math.pi * INNER**3 / 6


def data(divisions: int = 1, **changes: Any) -> dict[str, Any]:
    """The octant of an incompressible sphere, without its pressure."""
    octant = dict(sphere(divisions, hexahedra=True).data)
    del octant["effects"]
    return octant | {"certificate": NO_CERTIFICATE, "quantities": [*octant["quantities"], *VOLUMES]} | changes


PRESSURE_FOUND = {"name": "p", "of": "pressure", "cavity": "hole"}


def controlled(hole: dict[str, Any], comm: MPI.Intracomm, **changes: Any) -> hpcinv.Result:
    return hpcinv.run(job(**data(cavities={"hole": HOLE | hole}, **changes)), comm)


def pressure_of(stretch: float) -> float:
    """Pressure of the neo-Hookean sphere whose inner radius has grown by a factor."""
    outer = (OUTER**3 - INNER**3 + (stretch * INNER) ** 3) ** (1 / 3)
    g = [0.5 * (4 / s + s**-4) for s in (outer / OUTER, stretch)]
    return g[0] - g[1]


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_inverse_with_a_given_unloaded_volume(comm: MPI.Intracomm) -> None:
    pressure = {"effect": "pressure", "region": "inner", "pressure": PRESSURE}
    pressed = hpcinv.run(job(**data(cavities={"hole": HOLE}, effects=[pressure])), comm)
    values = pressed.quantities
    assert values["current"] == pytest.approx(OCTANT, rel=3e-3)  # three curved facets are not a sphere
    assert values["reference"] == pytest.approx(OCTANT * values["inner"] ** 3, rel=1e-2)
    result = controlled({"unloaded_volume": values["reference"]}, comm, analysis="round_trip")
    for solution in result.solutions:
        (cavity,) = solution.cavities
        assert cavity.pressure == pytest.approx(PRESSURE, rel=1e-10)
        assert cavity.volume == pytest.approx(values["current"], rel=1e-10)
        assert cavity.unloaded_volume == pytest.approx(values["reference"], rel=1e-10)
        assert cavity.residual < 1e-12
        assert solution.u == pytest.approx(pressed.solutions[0].u, abs=1e-10)
    assert solution.factorizations < 12


@pytest.mark.release
def test_cavities_need_no_programs_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """A job without cavities has the programs of one with a volume as a quantity, and of one with unknown pressure."""
    names, read = list[str](), code_cache.read

    def recorded(name: str) -> bytes | None:
        names.append(name)
        return read(name)

    monkeypatch.setattr(code_cache, "read", recorded)
    monkeypatch.setattr(Floor, "exceeds", lambda self, size, share: size <= share * self._value)  # always evaluated
    pressed = {"effects": [{"effect": "pressure", "region": "inner", "pressure": PRESSURE}]}
    programs = []
    for changes in (
        pressed | {"quantities": []},
        pressed | {"quantities": VOLUMES, "cavities": {"hole": HOLE}},
        {"quantities": VOLUMES, "cavities": {"hole": HOLE | {"unloaded_volume": 0.9 * OCTANT}}},
    ):
        names.clear()
        hpcinv.run(job(**data(**changes)), MPI.COMM_SELF)
        programs.append(set(names))
    assert programs[0] == programs[1] == programs[2] != set()


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_pressure_falls_while_a_balloon_is_filled(comm: MPI.Intracomm) -> None:
    pressures = []
    for stretch in (2.0, 2.2):
        given = {"volume": OCTANT * stretch**3}
        result = controlled(given, comm, analysis="forward", quantities=[PRESSURE_FOUND, *VOLUMES])
        pressures.append(result.quantities["p"])
        assert pressures[-1] == pytest.approx(pressure_of(stretch), rel=3e-4)
        assert result.quantities["current"] == pytest.approx(OCTANT * stretch**3, rel=1e-10)
    assert pressures[1] < pressures[0]


CHECKED = NO_CERTIFICATE | {"stability": True}
THIN = 1.05  # m: outer radius of a loaded balloon with the inner radius `INNER`


def stability_line(result: hpcinv.Result) -> Line:
    lines: list[Line] = [line for line in result.certificate.lines if line.name.startswith("stability")]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parallel([2, 1])
@pytest.mark.everyday("gas")
@pytest.mark.parametrize("held", ["volume", "gas"])
def test_balloons_beyond_their_largest_pressure_are_stable_with_given_volume_or_gas(
    held: str, comm: MPI.Intracomm
) -> None:
    ambient, stretch = 1.0, 2.2
    pressure = pressure_of(stretch)
    gas = {"ambient": ambient, "amount": (pressure + ambient) / ambient * stretch**3}
    hole = {"gas": gas} if held == "gas" else {"volume": OCTANT * stretch**3}
    result = controlled(hole, comm, analysis="forward", certificate=CHECKED)
    (cavity,) = result.solutions[0].cavities
    assert cavity.volume == pytest.approx(OCTANT * stretch**3, rel=1e-2)
    line = stability_line(result)
    assert line.verdict is Verdict.PASS
    assert "unstable at given pressures, but the volume, gas or windkessel of 'hole' holds the body" in line.note
    assert "motions that are not symmetric about 'x0', 'y0', 'z0' are left out" in line.note


@pytest.mark.everyday("1.1")
@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_windkessel_holds_a_balloon_up_to_a_compliance(share: float, comm: MPI.Intracomm) -> None:
    """``-dV/dp`` of the loaded balloon by its closed form; a softer chamber lets it snap."""
    rest, step = INNER / 1.8, 1e-5

    def pressure(inner: float) -> float:
        wall = THIN**3 - INNER**3
        stretches = ((wall + inner**3) / (wall + rest**3)) ** (1 / 3), inner / rest
        g = [0.5 * (4 / s + s**-4) for s in stretches]
        return g[0] - g[1]

    slope = (pressure(INNER + step) - pressure(INNER - step)) / (2 * step)
    critical = -math.pi / 2 * INNER**2 / slope
    windkessel = {"compliance": share * critical, "volume": OCTANT, "pressure": pressure(INNER)}
    wall = {"inner": INNER, "outer": THIN, "radial": 1, "along": 1, "hexahedra": True}
    mesh = {"file": "../meshes/thick_sphere.py", "parameters": wall, "geometry_degree": 2}
    result = controlled({"windkessel": windkessel}, comm, mesh=mesh, certificate=CHECKED)
    line = stability_line(result)
    print(line)
    assert line.verdict is (Verdict.PASS if share < 1 else Verdict.FAIL)
    assert line.value == (0 if share < 1 else 1)
    (cavity,) = result.solutions[0].cavities
    assert cavity.compliance == pytest.approx(share * critical)


@pytest.mark.everyday("3.0-30")
@pytest.mark.parametrize(("stretch", "most"), [(1.6, 10), (3.0, 30)])
def test_large_volumes_take_few_factorizations(stretch: float, most: int) -> None:
    """Steps are shortened before they fail: volumes 4 and 27 times as large."""
    volume = {"hole": HOLE | {"volume": OCTANT * stretch**3}}
    whole = data(2, cavities=volume, analysis="forward", quantities=[PRESSURE_FOUND])
    result = hpcinv.run(job(**whole), MPI.COMM_SELF)
    assert result.quantities["p"] == pytest.approx(pressure_of(stretch), rel=2e-5)
    assert result.solutions[0].factorizations <= most


@pytest.mark.release
def test_lands_ventricle_by_its_volume() -> None:
    """Land et al. (2015), problem 2, on a coarse mesh: the volume at 10 kPa gives this pressure and the same shape."""
    land = ROOT / "benchmarks" / "published" / "land" / "problem-2.yaml"
    by_pressure = hpcinv.load(land).with_(
        {
            "mesh.parameters": {"across": 1, "around": 8, "along": 4},
            "discretisation.displacement": 2,
            "cavities": {"hole": {"surface": "endo", "lid": {"apex": [0, 0, "5 mm"]}}},
            "quantities": VOLUMES,
            "certificate": NO_CERTIFICATE,
        }
    )
    pressed = hpcinv.run(by_pressure, MPI.COMM_SELF)
    quarter = {"cavities.hole.volume": pressed.quantities["current"], "effects": [], "solver": {}}
    (filled,) = hpcinv.run(by_pressure.with_(quarter), MPI.COMM_SELF).solutions
    assert filled.cavities[0].pressure == pytest.approx(10e3, rel=1e-8)
    assert filled.u == pytest.approx(pressed.solutions[0].u, abs=1e-8 * np.abs(filled.u).max())


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_heated_gas(comm: MPI.Intracomm) -> None:
    ambient, amount = 0.5, 1.5
    gas = {"gas": {"ambient": ambient, "amount": amount}}
    loaded = controlled(gas, comm, analysis="forward").solutions[0].cavities[0]
    assert (loaded.pressure + ambient) * loaded.volume == pytest.approx(amount * ambient * loaded.unloaded_volume)
    low, high = 1.0, 1.5  # stretches
    for _ in range(50):
        stretch = (low + high) / 2
        excess = (pressure_of(stretch) + ambient) * stretch**3 - amount * ambient
        low, high = (low, stretch) if excess > 0 else (stretch, high)
    assert loaded.pressure == pytest.approx(pressure_of(stretch), rel=1e-3)
    found = controlled(gas, comm, analysis="inverse").solutions[0].cavities[0]
    assert found.volume == pytest.approx(loaded.unloaded_volume)  # the same mesh
    assert (found.pressure + ambient) * found.volume == pytest.approx(amount * ambient * found.unloaded_volume)


@pytest.mark.parallel([2, 1])
def test_windkessel(comm: MPI.Intracomm) -> None:
    """At rest the pressure is p + (volume - V)/C: forward where the sphere's curve meets it, backward at once."""
    stretch, pressure, compliance = 1.3, 0.9, 0.5
    filled = pressure_of(stretch)
    volume = OCTANT * stretch**3 + compliance * (filled - pressure)
    chamber = {"windkessel": {"compliance": compliance, "volume": volume, "pressure": pressure}}
    there, back = (
        solution.cavities[0] for solution in controlled(chamber, comm, analysis="round_trip", first="forward").solutions
    )
    assert there.pressure == pytest.approx(filled, rel=1e-3)
    assert there.volume == pytest.approx(OCTANT * stretch**3, rel=1e-3)
    for cavity in (there, back):
        assert cavity.pressure == pytest.approx(pressure + (volume - cavity.volume) / compliance, rel=1e-10)
    assert (back.pressure, back.unloaded_volume) == pytest.approx((there.pressure, there.unloaded_volume), rel=1e-9)


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_states_with_given_volumes(comm: MPI.Intracomm) -> None:
    volume = hpcinv.run(job(**data(cavities={"hole": HOLE}, analysis="forward", quantities=VOLUMES)), comm).quantities
    states = [
        {"name": "filled", "given": True, "unloaded_volumes": {"hole": 0.4}},
        {"name": "half", "volumes": {"hole": 0.45}},
        {"name": "full", "volumes": {"hole": volume["reference"]}},
    ]
    quantities = [PRESSURE_FOUND, *VOLUMES]
    values = hpcinv.run(job(**data(cavities={"hole": HOLE}, states=states, quantities=quantities)), comm).quantities
    assert values["reference-half"] == pytest.approx(0.4, rel=1e-10)
    assert values["current-half"] == pytest.approx(0.45, rel=1e-10)
    assert values["p-full"] == pytest.approx(values["p-filled"], rel=1e-9)
    assert 0 < values["p-half"] < values["p-full"]


HOLES = ((1, 1, 1), (1, 2, 1), (3, 1, 1))


def with_two_holes(comm: MPI.Intracomm, analysis: str, **changes: Any) -> Equations:
    """Equations of a block with a hole of two cells and a hole of one, held on one side."""
    block = job(
        analysis=analysis,
        mesh=box((1, 1, 1)),
        regions={"side": "x < 0.1 m", "large": "cavity > 0 and cavity < 2", "small": "cavity > 1"},
        material={"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
        supports=[{"region": "side", "fix": ["x", "y", "z"]}],
        discretisation={"displacement": 1, "formulation": "displacement"},
        **changes,
    )
    body = build_body(block.mesh, block.regions, comm, replacement=hollow_block(HOLES, divisions=(5, 4, 3)))
    return Equations(block, body, Timings())


def volumes(equations: Equations) -> list[float]:
    """Volumes of both holes in the present state of a forward problem."""
    u = equations.unknowns.geometry_values(equations.state().displacement)
    return [EnclosedVolume(equations.body, [n], None).volume(equations.body.nodes + u) for n in ("large", "small")]


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_connected_cavities(comm: MPI.Intracomm) -> None:
    both = {"both": {"surface": ["large", "small"], "volume": 3.3}}
    for linear in ("direct", "iterative"):
        connected = with_two_holes(comm, "forward", cavities=both, solver={"linear": linear})
        (cavity,) = solve_direction(connected, "forward", UNLOADED, SILENT).constraints
        assert sum(volumes(connected)) == pytest.approx(3.3, rel=1e-10)
    checkpoint = Start(solution=connected.state().fields, load=1.0)
    other_process = with_two_holes(comm, "forward", cavities=both)
    (resumed,) = solve_direction(other_process, "forward", checkpoint, SILENT).constraints
    assert resumed.pressure == pytest.approx(cavity.pressure, rel=1e-10)
    pressures = [{"effect": "pressure", "region": n, "pressure": cavity.pressure} for n in ("large", "small")]
    pressed = with_two_holes(comm, "forward", effects=pressures)
    assert solve_direction(pressed, "forward", UNLOADED, SILENT).load == 1.0
    assert volumes(pressed) == pytest.approx(volumes(connected), rel=1e-9)


@pytest.mark.parallel([1, 2])
def test_cavities_that_share_a_surface_and_lids_elsewhere_are_refused(comm: MPI.Intracomm) -> None:
    twice = {"a": {"surface": "large", "volume": 2.1}, "b": {"surface": ["small", "large"], "volume": 3.3}}
    block = with_two_holes(comm, "forward", cavities=twice)
    with pytest.raises(MeshError, match="cavities: the unknown pressures of 'a' and 'b' act on one surface"):
        check_cavities(block.job, block.body)
    apart = job(**dict(block.job.data) | {"cavities": {"a": {"surface": "large", "lid": {"region": "small"}}}})
    with pytest.raises(MeshError, match=r"cavities\.a\.lid: 'small' does not touch the cavity's surface"):
        check_cavities(apart, block.body)


@pytest.mark.parametrize(("amount", "expected"), [("120 %", 1.2), ("6/5", 1.2), ("2*(1 - 0.4)", 1.2), (1.2, 1.2)])
def test_the_amount_of_a_gas_is_any_number(amount: Any, expected: float) -> None:
    gas = {"ambient": "1 atm", "amount": amount}
    known = job(**data(cavities={"hole": HOLE | {"gas": gas}})).cavities["hole"].gas
    assert known is not None
    assert known.amount == pytest.approx(expected)


@pytest.mark.parallel([1, 2])
def test_derivatives_of_the_equations(comm: MPI.Intracomm) -> None:
    gas = {"gas": {"ambient": 2.0, "amount": 1.3}}
    for direction in ("forward", "inverse"):
        volume = {"volume" if direction == "forward" else "unloaded_volume": 1.1}
        windkessel = {"windkessel": {"compliance": 0.7, "volume": 3.0, "pressure": 0.2}}
        holes = {
            "first": {"surface": "large"} | gas,
            "second": {"surface": "small"} | volume,
            "both": {"surface": ["large", "small"]} | windkessel,
        }
        model = with_two_holes(comm, direction, cavities=holes)
        weak_form = model.weak_form(direction)
        state, load, h = model.unknowns.state, 0.7, 1e-3
        deform(model.unknowns)
        x, step = state.x.array.copy(), np.cos(np.arange(len(state.x.array)))
        step_function = state.copy()
        step_function.x.array[:] = step
        step_function.x.scatter_forward()
        row = state.x.petsc_vec.duplicate()
        for cavity in cavity_equations(model.job, model.body, weak_form, model.scales):
            cavity.number = 0.3
            _, by_volume, by_pressure = cavity.evaluate(load)
            cavity.slope(row)
            slope = by_volume * dot(row, step_function.x.petsc_vec) + by_pressure
            values = []
            for k in (-2, -1, 1, 2):
                state.x.array[:] = x + k * h * step_function.x.array
                cavity.number = 0.3 + k * h
                values.append(cavity.evaluate(load)[0])
            state.x.array[:] = x
            difference = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)
            assert slope == pytest.approx(difference, rel=1e-8)


@pytest.mark.parametrize(
    ("hole", "changes", "text"),
    [
        ({"lid": {}}, {}, "exactly one of 'region' and 'apex'"),
        ({"volume": 1.0}, {}, "cavities.hole.volume: is known: the mesh is the loaded body. Give 'unloaded_volume'"),
        ({"unloaded_volume": 1.0}, {"analysis": "forward"}, "is known: the mesh is the undeformed body. Give 'volume'"),
        ({"unloaded_volume": 1.0, "gas": {"ambient": 1.0}}, {}, "gas: is given in addition to 'unloaded_volume'"),
        (
            {"unloaded_volume": 1.0},
            {"accuracy": {"inner": 1e-3}},
            "needs an estimate of the discretisation error, which",
        ),
        (
            {"unloaded_volume": 1.0},
            {"effects": [{"effect": "pressure", "region": "inner", "pressure": 1.0}]},
            r"effects\[0\].region: 'inner' belongs to a cavity of unknown pressure",
        ),
        ({}, {"quantities": [VOLUMES[0] | {"cavity": "hol"}]}, r"there is no cavity 'hol'.*Did you mean 'hole'"),
        ({}, {"quantities": [{"name": "v", "of": "volume"}]}, "cavity: is needed for a volume"),
        (
            {},
            {"quantities": [{"name": "p", "of": "pressure", "cavity": "hole"}]},
            "the pressure of cavity 'hole' is not",
        ),
    ],
)
def test_contradictions_are_refused(hole: dict[str, Any], changes: dict[str, Any], text: str) -> None:
    with pytest.raises(JobError, match=text):
        job(**data(cavities={"hole": HOLE | hole}) | changes)


@pytest.mark.parametrize(
    ("given", "other", "text"),
    [
        ({"volumes": {"hole": 1.0}}, {}, "are known: the mesh is the body in this state. Give 'unloaded_volumes'"),
        ({"unloaded_volumes": {"hole": 1.0}}, {"unloaded_volumes": {"hole": 1.0}}, "for the given state only. Give 'v"),
        ({"unloaded_volumes": {"hol": 1.0}}, {}, "hol: is not in 'cavities'. Did you mean 'hole'"),
    ],
)
def test_contradicting_states_are_refused(given: dict[str, Any], other: dict[str, Any], text: str) -> None:
    states = [{"name": "filled", "given": True, **given}, {"name": "other", "volumes": {"hole": 1.0}, **other}]
    with pytest.raises(JobError, match=text):
        job(**data(cavities={"hole": HOLE}, states=states))
