"""Contact with rigid obstacles against closed forms, and back to the undeformed body."""

from __future__ import annotations

import json
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import Interrupted, MeshError, SolveError
from hpcinv.job.job import load
from hpcinv.output.result import Result
from hpcinv.solver.methods.direct_method import DirectMethod
from hpcinv.solver.methods.method import Guess

ROOT = Path(__file__).parents[2]
MATERIAL = {"law": "neo-hookean", "young": "100 kPa", "poisson": 0.3}
FLOOR = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1]}
SIDES = [{"region": f"{axis}{end}", "fix": [axis]} for axis in "xy" for end in "01"]
WEIGHT = {"effect": "gravity", "acceleration": [0, 0, -10], "density": 1000, "density_in": "reference"}


def closing(result: Result) -> float:
    """Largest distance at which a round trip misses the given body."""
    return float(result.errors["round_trip"]["max"])


@pytest.mark.parallel([3, 2, 1])
def test_pressed_ball_is_as_hertz_found(comm: MPI.Intracomm) -> None:
    """Radius and largest pressure of the contact area, from the force; cells there are a third of its radius."""
    given = load(ROOT / "jobs" / "pressed-ball.yaml")
    coarse = {"mesh.parameters.at_pole": "0.25 mm", "mesh.parameters.size": "4 mm"}
    result = hpcinv.run(given.with_({"certificate": NO_CERTIFICATE, **coarse}), comm)
    contact = result.solutions[0].contacts[0]
    force, modulus, radius = -4 * contact.force[2], 100e3 / (1 - 0.3**2), 10e-3
    hertz = (3 * force * radius / (4 * modulus)) ** (1 / 3)
    contact_radius = sqrt(4 * contact.area / pi)
    assert contact_radius == pytest.approx(hertz, rel=0.04)
    assert contact.largest_pressure == pytest.approx(3 * force / (2 * pi * hertz**2), rel=0.03)
    assert 0 < contact.penetration < 4 * contact.tolerance
    missed = closing(result)
    assert missed < 1e-9 * 50e-6
    assert result.quantities["force"] == list(contact.force)
    assert result.quantities["area"] == contact.area
    assert result.quantities["penetration"] == contact.penetration
    back = result.solutions[1].contacts[0]
    assert back.force == pytest.approx(contact.force, rel=1e-9, abs=1e-9 * force)


def standing(comm: MPI.Intracomm, directory: Path | None = None, **changes: Any) -> Result:
    """A block of 1 m that stands on a floor under its weight, without lateral strain."""
    contact = {"effect": "contact", "region": "z0", "obstacle": FLOOR, **changes.pop("contact", {})}
    given = {
        "analysis": "forward",
        "mesh": box((1, 1, 1)) | {"geometry_degree": 2},
        "material": MATERIAL,
        "effects": [contact, WEIGHT],
        "supports": SIDES,
        "discretisation": {"displacement": 2},
    }
    conduct = {key: changes.pop(key) for key in ("stop_asked", "resume") if key in changes}
    return hpcinv.run(job(**given | changes), comm, directory=directory, **conduct)


LAYER = {"stiffness": "1 MPa/m"}


@pytest.mark.parallel([1, 3, 2])
def test_block_stands_on_its_weight_there_and_back(comm: MPI.Intracomm, run_directory: Path) -> None:
    forward = standing(comm, run_directory / "there")
    contact = forward.solutions[0].contacts[0]
    weight = 1000 * 10.0
    assert contact.force == pytest.approx((0, 0, weight), rel=1e-9, abs=1e-9 * weight)
    assert contact.area == pytest.approx(1)
    assert contact.largest_pressure == pytest.approx(weight, rel=0.02)  # uniform but for the discretisation
    assert contact.penetration < 2**-14  # the tolerated one is half of that

    # The inverse solve knows the floor only by the pressure: where the block stands cannot be found, and is held.
    closed = {"pressure": {"data": "contact_multiplier", "unit": "Pa"}, "penalty": contact.penalty}
    back = standing(
        comm,
        analysis="inverse",
        mesh={"file": str(run_directory / "there" / "shape.msh")},
        contact=closed,
        supports=[*SIDES, {"region": "z0", "fix": ["z"]}],
        quantities=[{"name": "floor", "of": "reaction", "on": "z0"}],
        expected_shape=box((1, 1, 1)),
    )
    missed = back.errors["expected_shape"]["max"]
    assert missed < 2**-13
    _, _, reaction = back.quantities["floor"]
    assert abs(reaction) < 1e-8 * weight
    returned = back.solutions[0].contacts[0].force
    assert returned == pytest.approx((0, 0, weight), rel=1e-9, abs=1e-9 * weight)


@pytest.mark.release
def test_estimated_error_of_a_block_on_a_floor_is_that_against_a_higher_degree(comm: MPI.Intracomm) -> None:
    """The sides are free, so that the block bulges: its pressure is not uniform.

    On 2 cells an edge, the vertices are 1.3 mm too far apart for the floor: the certificate warns of a penetration.
    """
    top = {"quantities": [{"name": "top", "of": "uz", "at": [0.5, 0.5, 1]}], "supports": [SIDES[0], SIDES[2]]}
    top |= {"mesh": box((4, 4, 4)) | {"geometry_degree": 2}}
    coarse, better = (
        standing(comm, discretisation={"displacement": degree}, certificate=NO_CERTIFICATE | {"estimate": has}, **top)
        for degree, has in ((2, True), (3, False))
    )
    assert coarse.estimate is not None
    effectivity = coarse.estimate.quantities["top"] / (better.quantities["top"] - coarse.quantities["top"])
    print(f"effectivity {effectivity:.2f}")
    assert 0.3 < effectivity < 3


def test_obstacle_that_is_away_in_the_first_of_fixed_steps(comm: MPI.Intracomm) -> None:
    """Nothing happens before half of the way; then it presses the top down by the other half."""
    plate = {"effect": "contact", "region": "z1", "obstacle": FLOOR | {"point": [0, 0, 1.1], "normal": [0, 0, -1]}}
    pressed = standing(
        comm,
        effects=[plate | {"travel": [0, 0, -0.2]}],
        supports=[SIDES[0], SIDES[2], {"region": "z0", "fix": ["z"]}],
        solver={"strategy": "fixed", "steps": 4},
        certificate=NO_CERTIFICATE,
    )
    assert pressed.solutions[0].u[:, 2].min() == pytest.approx(-0.1, abs=2**-15)


@pytest.mark.everyday("while loading")
@pytest.mark.parametrize("iterations", [5, 8], ids=["while loading", "while the pressure is found"])
def test_stopped_run_resumes_to_the_same_body(iterations: int, comm: MPI.Intracomm, run_directory: Path) -> None:
    def stop_asked() -> bool:
        nonlocal iterations
        iterations -= 1
        return iterations < 0

    changes: dict[str, Any] = {"solver": {"strategy": "fixed", "steps": 2}}
    whole = standing(comm, **changes).solutions[0].u
    with pytest.raises(Interrupted):
        standing(comm, run_directory / "run", stop_asked=stop_asked, **changes)
    resumed = standing(comm, run_directory / "run", resume=True, **changes).solutions[0].u
    assert abs(resumed - whole).max() < 1e-10


@pytest.mark.release
@pytest.mark.parallel(2)
def test_mixed_form_and_iterative_solver(comm: MPI.Intracomm) -> None:
    nearly_incompressible = {"law": "neo-hookean", "young": "100 kPa", "poisson": 0.49}
    result = standing(comm, material=nearly_incompressible, solver={"linear": "iterative"})
    is_mixed = result.job.is_mixed
    assert is_mixed
    force = result.solutions[0].contacts[0].force[2]
    assert force == pytest.approx(1e4, rel=1e-8)


@pytest.mark.release
def test_beam_that_comes_to_rest_on_a_peg(comm: MPI.Intracomm) -> None:
    """Euler–Bernoulli: the peg's force closes the gap that is left of the deflection under the beam's weight.

    The beam is 20 times as long as high, so that shear changes its deflections by about 1/400.
    """
    length, height, modulus, at, gap, free_tip = 1.0, 0.05, 1e6, 0.8, 0.01, 0.02
    bending = modulus * height**4 / 12
    load = 8 * bending * free_tip / length**4

    def sag(x: float) -> float:
        return load * x**2 * (6 * length**2 - 4 * length * x + x**2) / (24 * bending)

    force = (sag(at) - gap) * 3 * bending / at**3
    tip = sag(length) - force * at**2 * (3 * length - at) / (6 * bending)
    peg = {"shape": "cylinder", "point": [at, 0, -gap - 0.1], "axis": [0, 1, 0], "radius": 0.1}
    result = hpcinv.run(
        job(
            analysis="round_trip",
            first="forward",
            mesh=box((20, 1, 1), lx=length, ly=height, lz=height, hexahedra=True) | {"geometry_degree": 2},
            material={"law": "neo-hookean", "young": modulus, "poisson": 0.0},
            effects=[
                {"effect": "contact", "region": "z0", "obstacle": peg},
                WEIGHT | {"density": load / height**2 / 10},
            ],
            supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
            discretisation={"displacement": 2},
        ),
        comm,
    )
    contact = result.solutions[0].contacts[0]
    assert contact.force[2] == pytest.approx(force, rel=0.02)
    sag_of_tip = -result.solutions[0].u[:, 2].min()
    assert sag_of_tip == pytest.approx(tip, rel=0.01)
    missed = closing(result)
    assert missed < 1e-8 * tip


def sagging(comm: MPI.Intracomm, obstacle: dict[str, Any], **changes: Any) -> Result:
    """A soft beam of straight cells that would sag by 0.09 m, onto a peg 26 mm below it and 20 mm from its tip."""
    weight = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 200}
    given: dict[str, Any] = {
        "analysis": "forward",
        "mesh": box((12, 1, 1), lx=0.4, ly=0.02, lz=0.02, hexahedra=True),
        "material": {"law": "neo-hookean", "young": "2 MPa", "poisson": 0},
        "effects": [weight, {"effect": "contact", "region": "z0", "obstacle": obstacle}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "certificate": "off",
    }
    conduct = {key: changes.pop(key) for key in ("guesses",) if key in changes}
    return hpcinv.run(job(**given | changes), comm, **conduct)


PEG = {"shape": "cylinder", "point": [0.38, 0, -0.036], "axis": [0, 1, 0], "radius": 0.01}


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_beam_does_not_pass_through_a_peg_in_one_step(comm: MPI.Intracomm) -> None:
    """Euler–Bernoulli; its error at this sag equals the error of the other beam on a peg."""
    length, at, bending, load = 0.4, 0.38, 2e6 * 0.02**4 / 12, 200 * 9.81 * 0.02**2
    sag = load * at**2 * (6 * length**2 - 4 * length * at + at**2) / (24 * bending)
    force = (sag - 0.026) * 3 * bending / at**3
    tip = load * length**4 / (8 * bending) - force * at**2 * (3 * length - at) / (6 * bending)
    beam = box((20, 1, 1), lx=0.4, ly=0.02, lz=0.02, hexahedra=True)
    solution = sagging(comm, PEG, mesh=beam).solutions[0]
    assert solution.contacts[0].force[2] == pytest.approx(force, rel=0.02)
    assert solution.largest_displacement == pytest.approx(tip, rel=0.02)


def test_guess_beyond_a_peg_is_not_taken(comm: MPI.Intracomm) -> None:
    """A beam without the peg gives the guess, which is an equilibrium of the beam with an elastic peg, too."""
    free = sagging(comm, PEG | {"point": [0.38, 0, -9]}).solutions[0]
    guess = Guess(free.displacement.x.array, None)
    layer = {"effect": "contact", "region": "z0", "obstacle": PEG, "stiffness": "10 MPa/m"}
    weight = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 200}
    contact = sagging(comm, PEG, guesses=[guess], effects=[weight, layer]).solutions[0].contacts[0]
    force = contact.force[2]
    assert force > 0.05


def test_wire_between_the_nodes_is_not_passed_unnoticed(comm: MPI.Intracomm) -> None:
    """The surface feels an obstacle at points that are some 8 mm apart; none of them comes near."""
    wire = PEG | {"point": [0.371, 0, -0.0265], "radius": 0.0005}
    with pytest.raises(SolveError, match="would pass through an obstacle") as stopped:
        sagging(comm, wire, solver={"strategy": "fixed", "steps": 2})
    assert "refine the mesh near a thin obstacle" in stopped.value.advice


@pytest.mark.parallel([2, 1])
def test_rod_that_sweeps_through_a_block_in_one_step_is_refused(comm: MPI.Intracomm) -> None:
    """The rod is above the block before the only step, and below it afterwards."""
    rod = {"shape": "cylinder", "point": [0.5, 0, 1.2], "axis": [0, 1, 0], "radius": 0.05}
    sweeping = {"effect": "contact", "region": "z1", "obstacle": rod, "travel": [0, 0, -3]}
    with pytest.raises(SolveError, match="would pass through an obstacle"):
        standing(
            comm,
            effects=[sweeping],
            supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
            solver={"strategy": "fixed", "steps": 1},
        )


def indented(comm: MPI.Intracomm, obstacle: dict[str, Any]) -> Result:
    """A clamped block into which an obstacle is pressed from above, there and back."""
    return hpcinv.run(
        job(
            analysis="round_trip",
            first="forward",
            mesh=box((2, 2, 2)),
            material=MATERIAL,
            effects=[{"effect": "contact", "region": "z1", "obstacle": obstacle, "travel": [0, 0, "-5 cm"]}],
            supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
            discretisation={"displacement": 1},
            certificate=NO_CERTIFICATE,
        ),
        comm,
    )


def pressed_by_a_ball(
    comm: MPI.Intracomm, directory: Path | None = None, penalty: float | None = None, **changes: Any
) -> Result:
    """A clamped block of straight cells, under a displacement of degree 2."""
    ball = {"shape": "sphere", "centre": [0.4, 0.5, 2.0], "radius": 1}
    given: dict[str, Any] = {
        "analysis": "round_trip",
        "first": "forward",
        "mesh": box((1, 1, 1), hexahedra=True),
        "material": MATERIAL,
        "effects": [
            {"effect": "contact", "region": "z1", "obstacle": ball, "travel": [0, 0, "-10 cm"], "penalty": penalty}
        ],
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        "discretisation": {"displacement": 2},
    }
    return hpcinv.run(job(**given | changes), comm, directory=directory)


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_return_solve_on_straight_cells_has_the_force_of_the_solve(comm: MPI.Intracomm) -> None:
    """The recovered body has all nodes of the displacement; their gaps are the same in both directions."""
    result = pressed_by_a_ball(comm)
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert there.force[2] < -100
    assert back.force == pytest.approx(there.force, rel=1e-8, abs=-1e-8 * there.force[2])


def test_solution_before_an_error_has_its_summary(
    comm: MPI.Intracomm, run_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second direction is refused after the first one has been solved."""
    solve = DirectMethod.solves

    def refused(method: DirectMethod, *start: Any) -> Any:
        if method.direction == "inverse":
            raise MeshError("refused here")
        yield from solve(method, *start)

    monkeypatch.setattr(DirectMethod, "solves", refused)
    force = {"name": "force", "of": "contact_force", "on": "z1"}
    with pytest.raises(MeshError, match="refused here"):
        pressed_by_a_ball(comm, run_directory / "run", quantities=[force])
    summary = json.loads((run_directory / "run" / "summary.json").read_text())
    assert [solution["direction"] for solution in summary["solutions"]] == ["forward"]
    assert summary["certificate"]["lines"][0]["note"] == "refused here"
    force_of_summary = summary["quantities"]["force"]
    assert force_of_summary[2] < -100


@pytest.mark.release
def test_certificate_shows_what_the_penalty_leaves(comm: MPI.Intracomm) -> None:
    """The line is of first order, and a penalty twice as large is a second solution."""
    cheap = NO_CERTIFICATE | {"stability": True}
    one_way: dict[str, Any] = {"analysis": "forward", "first": None, "certificate": cheap}
    result = pressed_by_a_ball(comm, **one_way)
    penalty = result.solutions[0].contacts[0].penalty
    assert penalty is not None
    doubled = pressed_by_a_ball(comm, penalty=2 * penalty, **one_way)
    name = "contact on 'z1': change of the shape if the penalty is doubled"
    (line,) = (line for line in result.certificate.lines if line.name == name)
    size = result.solutions[0].largest_displacement
    moved = doubled.solutions[0].displacement.x.array - result.solutions[0].displacement.x.array
    change = np.linalg.norm(moved.reshape(-1, 3), axis=1).max() / size
    print(f"line {line.value:.3g}, second solution {change:.3g}")
    assert line.value == pytest.approx(change, rel=0.5)


@pytest.fixture(scope="module")
def smooth() -> dict[str, Any]:
    return {"shape": "sphere", "centre": [0.5, 0.5, 2], "radius": 1}


@pytest.mark.release
def test_a_formula_is_the_sphere_that_it_describes(smooth: dict[str, Any], comm: MPI.Intracomm) -> None:
    formula = {"shape": "level-set", "formula": "(x - 0.5 m)^2 + (y - 0.5 m)^2 + (z - 2 m)^2 - (1 m)^2"}
    exact, sphere_result = (indented(comm, obstacle) for obstacle in (smooth, formula))
    for result in (exact, sphere_result):
        missed = closing(result)
        assert missed < 1e-10
    # The formula's gap is exact to first order: it differs by its square over twice the radius.
    force = exact.solutions[0].contacts[0].force[2]
    pressed = sphere_result.solutions[0].contacts[0].force[2]
    assert pressed == pytest.approx(force, rel=0.01)


@pytest.mark.release
@pytest.mark.parallel(2)
def test_triangles_of_a_sphere_press_as_the_sphere(
    smooth: dict[str, Any], comm: MPI.Intracomm, run_directory: Path
) -> None:
    import pyvista

    file = run_directory / "sphere.stl"
    if comm.rank == 0:
        pyvista.Sphere(radius=1000, center=(500, 500, 2000), theta_resolution=90, phi_resolution=90).save(file)
    comm.Barrier()
    result = indented(comm, {"shape": "surface", "file": str(file), "unit": "1 mm"})
    missed = closing(result)
    assert missed < 1e-6  # distances settle to 2**-32 lengths, and a penalty is up to 4096 moduli per length
    exact = indented(comm, smooth).solutions[0].contacts[0]
    pressed = result.solutions[0].contacts[0].force[2]
    assert pressed == pytest.approx(exact.force[2], rel=0.03)


@pytest.mark.everyday("down")
@pytest.mark.parametrize("normals", ["up", "down"])
def test_flat_triangle_presses_as_the_plane(normals: str, comm: MPI.Intracomm, run_directory: Path) -> None:
    """Uniaxial compression by 10 %; the force is the plane's, -1087.2 N for 10 kPa and 1 m²."""
    import pyvista

    corners, file = np.array([[-5.0, -5, 1], [8, -5, 1], [-5, 8, 1]]), run_directory / "sheet.stl"
    pyvista.PolyData.from_regular_faces(corners, [[0, 1, 2] if normals == "up" else [0, 2, 1]]).save(file)
    sheet = {"shape": "surface", "file": str(file), "unit": "m", "flip": normals == "up"}
    plane = {"shape": "plane", "point": [0, 0, 1], "normal": [0, 0, -1]}

    def pressed(obstacle: dict[str, Any], region: str = "z1") -> float:
        contact = {"region": region, "obstacle": obstacle, "travel": [0, 0, -0.1]}
        holds = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
        soft: dict[str, Any] = {"material": MATERIAL | {"young": "10 kPa"}}
        return (
            standing(
                comm, **soft, effects=[{"effect": "contact"} | contact], supports=holds, certificate=NO_CERTIFICATE
            )
            .solutions[0]
            .contacts[0]
            .force[2]
        )

    force = pressed(sheet)
    assert force == pytest.approx(-1087.2, rel=1e-4)
    assert force == pytest.approx(pressed(plane), rel=1e-9)
    with pytest.raises(MeshError, match="turn its normals with 'flip'"):
        pressed(sheet | {"flip": normals != "up"}, "z0")


def test_obstacle_in_the_body_is_refused(comm: MPI.Intracomm) -> None:
    wrong_side = {"obstacle": FLOOR | {"point": [0, 0, 0.2]}}
    with pytest.raises(MeshError, match=r"effects\[0\]: the obstacle overlaps 'z0' of the unloaded body by 0.2 m"):
        standing(comm, contact=wrong_side)


def test_body_that_nothing_holds_before_it_touches_is_refused(comm: MPI.Intracomm) -> None:
    with pytest.raises(MeshError, match="leave the body free to move along z"):
        standing(comm, contact={"obstacle": FLOOR | {"point": [0, 0, -0.2]}})


def test_layer_that_a_given_body_does_not_touch_is_refused(comm: MPI.Intracomm) -> None:
    away = {"obstacle": FLOOR | {"point": [0, 0, -0.2]}, **LAYER}
    with pytest.raises(MeshError, match=r"'z0' of the given body touches nothing: the gap is at least 0.2 m"):
        standing(comm, contact=away, analysis="inverse", supports=[*SIDES, {"region": "z1", "fix": ["z"]}])
    pulled = {"region": "z1", "remote": {"force": [1, 0, 0], "about": [0, 0, 1]}}
    held = {"region": "low", "fix": ["x", "y", "z"]}
    low = {"mesh": box((2, 2, 2)), "regions": {"low": "x < 0.1 m and z < 0.6 m"}, "supports": [held, pulled]}
    with pytest.raises(MeshError, match=r"'z0' of the given body touches nothing"):
        standing(comm, contact=away, analysis="inverse", **low)
