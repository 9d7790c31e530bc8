"""Stress, energy, volume ratio, volume and area as quantities of interest, against closed forms, on 1 and 2 ranks.

Of a neo-Hookean body ``σ = μ (F Fᵀ - I)`` and ``ψ = μ/2 (tr FᵀF - 3)`` where ``det F = 1``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, neo_hookean_stress, root
from helpers.mesh_cases import TETRAHEDRON, spec, write_msh22
from helpers.thick_sphere import INNER, OUTER, PRESSURE, carried, outer_radius
from helpers.verification import Solved, box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError, MeshError
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.mesh import build_body
from hpcinv.results.quantities_of_interest import check_points, evaluate
from hpcinv.results.solution import solution_of
from hpcinv.solver.equations import Equations

GOOD = {"mesh": box(), "material": NEO_HOOKEAN, "supports": [{"region": "x0", "fix": ["x", "y", "z"]}]}
STRESSES = ("sxx", "syy", "szz", "sxy", "syz", "sxz")


def quantity(name: str, of: Any, **settings: Any) -> QuantityOfInterest:
    return QuantityOfInterest.model_validate({"name": name, "of": of, **settings})


def named(of: Any, **settings: Any) -> QuantityOfInterest:
    """With a name made of all that it asks for."""
    message = "-".join(str(v) for v in (of, *settings.values()))
    return quantity("q" + re.sub(r"\W", "_", message), of, **settings)


def values(
    comm: MPI.Intracomm,
    direction: str,
    displacement: Callable[[np.ndarray], np.ndarray],
    quantities: list[QuantityOfInterest],
    **settings: Any,
) -> list[Any]:
    """Values where a displacement (3, n) of position in the mesh (3, n) is prescribed everywhere, not solved for."""
    its = job(analysis=direction, **(GOOD | settings))
    body = build_body(its.mesh, its.regions, comm, resolve=its.resolve)
    model = Equations(its, body, Timings())
    u, length = model.unknowns.displacement(), body.length_scale
    u.interpolate(lambda x: displacement(x * length) / length)
    model.unknowns.set_displacement(u.x.array)
    solution = solution_of(model, its.directions[0], model.weak_form(its.directions[0]), ())
    model.unload()
    body.mesh.geometry.x[:] *= 1.1  # moved on, to another solution
    evaluated = evaluate(quantities, body, solution, model)
    assert str(comm.allgather(evaluated)) == str([evaluated] * comm.size)  # NaN is not equal to itself
    return [evaluated[q.name] for q in quantities]


@pytest.mark.parallel([1, 2])
def test_a_homogeneous_state_has_its_stress_everywhere(comm: MPI.Intracomm) -> None:
    F = np.array([[1.1, 0.3, 0.0], [0.0, 0.9, 0.1], [0.05, 0.0, 1.2]])
    J, P = np.linalg.det(F), neo_hookean_stress(F)
    sigma = P @ F.T / J
    deviator = sigma - np.trace(sigma) / 3 * np.eye(3)
    energy = MU / 2 * (np.trace(F.T @ F) - 3) - MU * np.log(J) + LAM / 2 * np.log(J) ** 2
    exact = {name: sigma["xyz".index(name[1]), "xyz".index(name[2])] for name in STRESSES}
    exact |= {"p": -np.trace(sigma) / 3, "von_mises": np.sqrt(1.5 * (deviator**2).sum()), "energy": energy, "J": J}
    places: list[dict[str, Any]] = [{"at": [0.3, 0.4, 0.9]}, {"at": [1, 1, 1]}]
    for reduce in ("mean", "max", "min"):
        places += [{"on": "block", "reduce": reduce}, {"on": "z1", "reduce": reduce}]
    places.append({"on": "block", "reduce": "mean", "over": "current"})
    for direction, H in (("forward", F - np.eye(3)), ("inverse", np.eye(3) - np.linalg.inv(F))):
        asked = [(named(name, **place), value) for name, value in exact.items() for place in places]
        asked += [(named(name, on="y0", reduce="rms", over="current"), abs(value)) for name, value in exact.items()]
        # The cube is the mesh: the other body is a parallelepiped, with its volume and areas.
        over, map_to_it = ("current", F) if direction == "forward" else ("reference", np.linalg.inv(F))
        ratio = np.linalg.det(map_to_it)
        areas = np.linalg.norm(ratio * np.linalg.inv(map_to_it).T, axis=0)
        asked += [
            (named("1", on="block", reduce="integral", over=over), ratio),
            (named("1", on="x1", reduce="integral", over=over), areas[0]),
            (named("1", on="z0", reduce="integral", over=over), areas[2]),
            (named("p*J", on="block", reduce="integral", over=over), exact["p"] * J * ratio),
        ]
        # The divergence theorem: the volume of the current body by its boundary.
        normal = np.linalg.inv(F).T[:, 0] if direction == "forward" else np.eye(3)[0]
        volume = np.linalg.det(F) if direction == "forward" else 1.0
        enclosed = "(x*nx + y*ny + z*nz)/3"
        asked += [(named(enclosed, on="boundary", reduce="integral", over="current"), volume)]
        asked += [
            (named(name, on="x1", reduce="mean"), component)
            for name, component in zip(("nx", "ny", "nz"), normal / np.linalg.norm(normal), strict=True)
        ]
        evaluated = values(comm, direction, lambda x: H @ x, [q for q, _ in asked])  # noqa: B023
        for (q, value), got in zip(asked, evaluated, strict=True):
            assert got == pytest.approx(value, rel=1e-11, abs=1e-13 * MU * ("J" not in q.of.names)), q


def test_normals_are_refused_where_there_are_none(comm: MPI.Intracomm) -> None:
    with pytest.raises(JobError, match=r"has the normal of a surface: name a region of the boundary with 'on'"):
        job(**GOOD, quantities=[{"name": "q", "of": "nx", "at": [0, 0, 0]}])
    its = job(**GOOD, quantities=[{"name": "q", "of": "nx", "on": "block", "reduce": "mean"}])
    body = build_body(its.mesh, its.regions, comm, resolve=its.resolve)
    with pytest.raises(MeshError, match=r"quantities: q: 'nx' has the normal of a surface, and 'block' has cells"):
        check_points(its.quantities, body)


@pytest.mark.parallel([2, 1])
def test_a_varying_state_is_averaged_over_volume_and_area_law_by_law(comm: MPI.Intracomm) -> None:
    """u = (k y², 0, 0), so that F has ``2 k y`` next to its diagonal, and two laws, one for each half."""
    k, soft, stiff = 0.2, MU, 7 * MU
    material = {"low": NEO_HOOKEAN, "high": NEO_HOOKEAN | {"mu": stiff}}
    regions = {"low": "y < 0.51", "high": "y > 0.49"}
    sxx = 4 * k**2  # times μ y²
    asked = [
        (named("sxx", at=[0.4, 0.3, 0.6]), soft * sxx * 0.09),
        (named("sxx", at=[0.4, 0.8, 0.6]), stiff * sxx * 0.64),
        (named("sxy", at=[0.9, 0.8, 0.1]), stiff * 2 * k * 0.8),
        (named("sxx", on="low", reduce="mean"), soft * sxx * 0.25 / 3),  # mean of y² from 0 to 1/2
        (named("sxx", on="high", reduce="mean"), stiff * sxx * 1.75 / 3),
        (named("sxy", on="block", reduce="mean"), 2 * k * (soft * 0.125 + stiff * 0.375)),
        (named("sxy", on="block", reduce="rms"), 2 * k * np.sqrt((soft**2 + 7 * stiff**2) / 24)),
        (named("energy", on="block", reduce="integral", over="reference"), 2 * k**2 * (soft + 7 * stiff) / 24),
        (named("sxx", on="z1", reduce="mean"), sxx * (soft + 7 * stiff) / 24),
        (named("sxx", on="y1", reduce="mean"), stiff * sxx),
        (named("sxx", on="y1", reduce="max"), stiff * sxx),
        (named("sxx*y/(1 m)", on="z0", reduce="integral", over="reference"), sxx * (soft + 15 * stiff) / 64),
        (named("y", on="block", reduce="mean", over="current"), 0.5),
        (named("y**2", on="block", reduce="integral", over="reference"), 1 / 3),
        (named("J", on="block", reduce="max_abs"), 1.0),
    ]
    asked += [(named("y", on="high", reduce="mean"), 0.75), (named("uy", on="high", reduce="max"), 0.0)]  # at nodes
    for direction in ("forward", "inverse"):
        evaluated = values(
            comm,
            direction,
            lambda x: k * np.stack([x[1] ** 2, 0 * x[1], 0 * x[1]]),
            [q for q, _ in asked],
            material=material,
            regions=regions,
        )
        for (q, value), got in zip(asked, evaluated, strict=True):
            assert got == pytest.approx(value, rel=1e-11, abs=1e-12 * (stiff if q.fields else 1)), q


@pytest.mark.everyday("False")
@pytest.mark.parametrize("hexahedra", [False, True])
def test_volumes_and_areas_of_curved_bodies_before_and_after(hexahedra: bool, comm: MPI.Intracomm) -> None:
    """A quarter of a tube and an octant of a hollow sphere, swollen by a radial displacement of degree 2 or 1."""
    sides = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]

    def errors(divisions: int) -> np.ndarray:
        tube = {"inner": 0.5, "outer": 1.0, "length": 2.0, "radial": 1, "around": divisions, "along": 1}
        sphere = {"inner": 0.5, "outer": 1.0, "radial": 1, "along": divisions}
        bodies = (
            ("cylinder", tube, 2 * np.pi / 4 * 0.75, 2 * np.pi / 2, 1.2 * 1.2 * 1.5, 1.2 * 1.5),
            ("sphere", sphere, np.pi / 6 * 0.875, np.pi / 2, 1.2 * 1.2 * 1.5, None),
        )
        off = []
        for name, parameters, volume, area, grown, wider in bodies:
            evaluated = values(
                comm,
                "forward",
                lambda x: np.array([[0.2], [0.2], [0.5]]) * x,
                [
                    quantity(f"{size}-{over}", "1", on=region, reduce="integral", over=over)
                    for size, region in (("volume", "wall"), ("area", "outer"))
                    for over in ("reference", "current")
                ],
                mesh={
                    "file": f"../meshes/thick_{name}.py",
                    "parameters": parameters | {"hexahedra": hexahedra},
                    "geometry_degree": 2,
                },
                supports=sides,
            )
            assert evaluated[1] / evaluated[0] == pytest.approx(grown, rel=1e-12)
            off += [evaluated[0] / volume - 1, evaluated[2] / area - 1]
            if wider is not None:  # only the side of the tube, which is upright, is still one
                off.append(evaluated[3] / (area * wider) - 1)
        return np.abs(off)

    coarse, fine = errors(2), errors(4)
    print("errors", coarse, fine, "orders", np.log2(coarse / fine).round(2))
    assert fine.max() < 3e-4
    assert np.log2(coarse / fine).min() > 3.5


def test_stresses_in_a_thick_sphere_at_a_point_and_on_its_boundary(comm: MPI.Intracomm) -> None:
    """``σ_rr`` is what the wall outside carries, ``σ_θθ - σ_rr = μ (λ² - λ⁻⁴)`` (incompressible, neo-Hookean)."""
    A = root(lambda A: carried(A, 0.5, 0.0) - PRESSURE, 0.5, 1.0)
    radius = 1.2
    stretch = radius / (radius**3 - INNER**3 + A**3) ** (1 / 3)
    radial = sum(sign * 0.5 * (4 / s + s**-4) for sign, s in ((1, stretch), (-1, OUTER / outer_radius(A))))
    around = radial + stretch**2 - stretch**-4
    inside = {"at": [float(c) for c in radius * np.array([2, 1, 1.5]) / np.sqrt(7.25)]}
    normal = "(sxx*x**2 + syy*y**2 + szz*z**2 + 2*(sxy*x*y + syz*y*z + sxz*x*z))/(x**2 + y**2 + z**2)"
    asked = [
        (quantity("radial", normal, **inside), radial),
        (quantity("von_mises", "von_mises", **inside), around - radial),
        (quantity("p", "p", **inside), -(radial + 2 * around) / 3),
        (quantity("carried", normal, on="inner", reduce="mean"), -PRESSURE),
        (quantity("volume", "1", on="wall", reduce="integral", over="current"), np.pi / 6 * (OUTER**3 - INNER**3)),
        (quantity("as-before", "1", on="wall", reduce="integral", over="reference"), np.pi / 6 * (OUTER**3 - INNER**3)),
        (quantity("area", "1", on="inner", reduce="integral", over="reference"), np.pi / 2 * A**2),
    ]

    def errors(radial: int) -> np.ndarray:
        mesh = {"inner": INNER, "outer": OUTER, "radial": radial, "along": 3, "hexahedra": True, "shells": False}
        solved = Solved(
            job(
                mesh={"file": "../meshes/thick_sphere.py", "parameters": mesh, "geometry_degree": 2},
                material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
                effects=[{"effect": "pressure", "region": "inner", "pressure": PRESSURE}],
                supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
            ),
            comm,
        )
        solution = solution_of(solved.model, "inverse", solved.weak_form, tuple(solved.solves))
        evaluated = evaluate([q for q, _ in asked], solved.body, solution, solved.model)
        return np.abs([evaluated[q.name] / value - 1 for q, value in asked])

    coarse, fine = errors(3), errors(6)
    print("relative errors", dict(zip([q.name for q, _ in asked], zip(coarse, fine, strict=True), strict=True)))
    assert (fine[:3] < 1e-2).all()
    assert fine[3] < 0.3 * coarse[3] < 1e-2  # of second order, as the pressure is where the wall ends
    assert (fine[4:] < 1e-4).all()


WRONG = [
    ({"of": "sxx", "on": "side"}, "reduce: is needed on a region: max, min, mean, max_abs, rms or integral"),
    ({"of": "1", "on": "side", "reduce": "integral"}, "over: is needed for an integral"),
    ({"of": "sxx", "on": "side", "reduce": "max", "over": "current"}, "over: is valid only with an integral"),
    ({"of": "sxx", "at": [0, 0, 0], "over": "current"}, "over: is valid only with an integral"),
    ({"of": "sxx + X", "at": [0, 0, 0]}, "of: 'sxx + X' adds or compares a stress and a length"),
    ({"of": "energy + J", "at": [0, 0, 0]}, "of: 'energy + J' adds or compares"),
    ({"of": "sxx > 1 kPa", "at": [0, 0, 0]}, "of: must be a number"),
    ({"of": "syx", "at": [0, 0, 0]}, "of: unknown name 'syx' in 'syx'. "),
]


@pytest.mark.parametrize(("given", "message"), WRONG, ids=[message[:40] for _, message in WRONG])
def test_invalid_stress_quantities_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError) as caught:
        job(**GOOD, quantities=[{"name": "a", **given}])
    assert f"quantities[0].{message}" in str(caught.value)


def test_only_formulas_of_quantities_know_names_of_stresses() -> None:
    job(**GOOD)
    for bad in (
        {"regions": {"loaded": "sxx > 1 kPa"}},
        {"supports": [{"region": "x0", "displacement": ["J*x", 0, 0]}]},
        {"material": NEO_HOOKEAN | {"mu": "1 kPa + p"}},
    ):
        with pytest.raises(JobError, match=r"unknown name '(sxx|J|p)' in"):
            job(**(GOOD | bad))


@pytest.mark.parallel([2])
def test_stress_on_facets_inside_is_refused_on_all_ranks(comm: MPI.Intracomm, run_directory: Path) -> None:
    path = run_directory / "two.msh"
    if comm.rank == 0:
        cells = [(4, 1, 1, (1, 2, 3, 4)), (4, 1, 1, (2, 3, 4, 5)), (2, 2, 1, (2, 3, 4))]
        write_msh22(path, (*TETRAHEDRON, (1.0, 1.0, 1.0)), cells, [(3, 1, "body"), (2, 2, "between")])
    comm.barrier()
    body = build_body(spec(path), {}, comm)
    check_points([quantity("nodes", "X", on="between", reduce="mean")], body)
    for bad in ({"of": "sxx", "reduce": "mean"}, {"of": "1", "reduce": "integral", "over": "current"}):
        with pytest.raises(MeshError, match=r"quantities: stress: .*'between' has 1 facets inside the body") as caught:
            check_points([quantity("stress", on="between", **bad)], body)
        assert "load" not in caught.value.advice
        assert "name a region that has such" in caught.value.advice


@pytest.mark.release
@pytest.mark.parallel([2])
def test_a_formula_without_a_finite_value_is_not_a_number_on_all_ranks(comm: MPI.Intracomm) -> None:
    for reduce in ("max", "min", "mean", "integral"):
        over = {"over": "reference"} if reduce == "integral" else {}
        bad = quantity("root", "sqrt(x - 0.5) + 0*energy", on="block", reduce=reduce, **over)
        (evaluated,) = values(comm, "forward", lambda x: 0.1 * x, [bad])
        assert np.isnan(evaluated)
