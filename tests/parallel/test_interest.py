"""Quantities of interest on any number of ranks, against the formulas that the displacement was made of."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mesh_cases import conditions, spec
from helpers.solutions import made_up

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import MeshError
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.mesh import MeshSource, build_body
from hpcinv.results.quantities_of_interest import check_points, evaluate, fault_of

RADIUS = 4.25e-3


def quantity(name: str, of: Any, **settings: Any) -> QuantityOfInterest:
    return QuantityOfInterest.model_validate({"name": name, "of": of, **settings})


def displacement(x: np.ndarray) -> np.ndarray:
    return np.stack([0.1 * x[:, 0] + 0.01 * x[:, 1], -0.5 * x[:, 0], 0.3 * x[:, 2]], axis=1)


def check(quantities: dict[str, Any], source: MeshSource, sign: int) -> None:
    """Compare reductions over regions with those over the nodes of the source, each taken once."""
    facets = {g.name: source.facets[g.members] for g in source.groups if g.dim == 2}
    clamp = facets["clamp"]
    corner = clamp[(source.points[clamp[:, :3], 1] < 1e-3).all(axis=1)]
    regions = {"side": facets["side"], "clamp": clamp, "silicone": source.cells, "corner": corner}
    for region, entities in regions.items():
        nodes = source.points[np.unique(entities)]
        u = displacement(nodes)
        X, x = (nodes, nodes + u) if sign == 1 else (nodes - u, nodes)
        v = X[:, 0] * X[:, 1] / 0.01 + u[:, 1] - 1e-3 * x[:, 2]
        exact = {
            "min": v.min(),
            "max": v.max(),
            "mean": v.mean(),
            "max_abs": abs(v).max(),
            "rms": np.sqrt(v @ v / v.size),
        }
        for name, value in exact.items():
            assert quantities[f"{name}-{region}"] == pytest.approx(value, rel=1e-11, abs=1e-16), name


@pytest.mark.release
@pytest.mark.parallel([1, 3])
def test_points_and_regions_have_the_values_of_the_formulas(comm: MPI.Intracomm, meshes: Path) -> None:
    # On the axis, at the ends, inside, and on the true surface of the cylinder, outside of its straight cells.
    on_surface = [(0.07, RADIUS * np.cos(a), RADIUS * np.sin(a)) for a in np.linspace(0.1, 6.2, 7)]
    points = [(0.0, 0.0, 0.0), (0.182, 0.0, 0.0), (0.05, 1e-3, -2e-3), *on_surface]
    formula = "x + 2*X + 3*ux*y/Y + 5*uz + Z"
    at_points = [quantity(f"u{i}", "displacement", at=list(p)) for i, p in enumerate(points)]
    in_formula = [quantity(f"f{i}", formula, at=list(p)) for i, p in enumerate(points) if p[1] != 0]
    on = {
        f"{reduce}-{region}": quantity(f"{reduce}-{region}", "X*Y/(10 mm) + uy - 1e-3*z", on=region, reduce=reduce)
        for reduce in ("min", "max", "mean", "max_abs", "rms")
        for region in ("side", "clamp", "silicone", "corner")
    }
    for degree in (1, 2):
        mesh = spec(meshes / "pdms_beam.py", parameters={"size": "4 mm"}, geometry_degree=degree)
        body = build_body(mesh, conditions(corner="x <= 0 and y < 1 mm"), comm)
        for direction, sign in (("forward", 1), ("inverse", -1)):
            solution = made_up(body, direction, displacement)
            with body.at(solution.other_nodes):  # moved on, to the next solution
                quantities = evaluate([*at_points, *in_formula, *on.values()], body, solution)
            assert comm.allgather(quantities) == [quantities] * comm.size
            for i, p in enumerate(points):
                point = np.array([p])
                u = displacement(point)
                # Quadratic cells do not hold a linear displacement exactly off their nodes.
                close = {"rtol": 1e-12 if degree == 1 else 1e-2, "atol": 1e-14 if degree == 1 else 2e-5}
                assert np.allclose(quantities[f"u{i}"], u[0], **close)
                X, x = (point, point + u) if sign == 1 else (point - u, point)
                if f"f{i}" in quantities:
                    value = x[0, 0] + 2 * X[0, 0] + 3 * u[0, 0] * x[0, 1] / X[0, 1] + 5 * u[0, 2] + X[0, 2]
                    assert np.allclose(quantities[f"f{i}"], value, **close)

            on_root(comm, lambda: check(quantities, body.source, sign))  # noqa: B023


@pytest.mark.parallel([2])
def test_quantities_that_the_body_does_not_have_are_reported_on_all_ranks_before_the_solve(
    comm: MPI.Intracomm, meshes: Path
) -> None:
    body = build_body(spec(meshes / "box.py", parameters={"lx": "8 mm", "nx": 3}), {}, comm)
    inside = quantity("inside", "displacement", at=["8 mm", 1.0, 0.5])
    check_points([inside], body)
    outside = [quantity(n, "displacement", at=[x, 0.5, 0.5]) for n, x in (("left", "-1 mm"), ("in-mm", 8.0))]
    with pytest.raises(MeshError) as error:
        check_points([outside[0], inside, outside[1]], body)
    message = str(error.value)
    assert "left: the point (-0.001, 0.5, 0.5) m" in message
    assert "in-mm: the point (8, 0.5, 0.5) m" in message
    assert "inside" not in message
    assert "from (0, 0, 0) to (0.008, 1, 1) m" in message
    with pytest.raises(MeshError, match="no region 'to'"):
        check_points([quantity("typo", "ux", on="to", reduce="max")], body)

    solution = made_up(body, "forward", displacement)
    for bad in (quantity("root", "sqrt(X - 4 mm)", on="x0", reduce="max"), quantity("pole", "X/X", at=[0, 0, 0])):
        (value,) = evaluate([bad], body, solution).values()
        assert math.isnan(value)
        assert f"{bad.name}: '{bad.of}' has no finite value" in fault_of(bad, value)


@pytest.mark.parallel([2])
def test_nodes_of_a_region_count_once_where_it_ends_between_ranks(comm: MPI.Intracomm, meshes: Path) -> None:
    # A bar of eight cubes: one of these regions ends where the ranks meet, at nodes that another rank may own.
    bar = spec(meshes / "box.py", parameters={"lx": 8.0, "nx": 8, "ny": 1, "nz": 1})
    regions = {f"b{k}": f"x < {k}.5" for k in range(8)} | {f"a{k}": f"x > {k}.5" for k in range(8)}
    body = build_body(bar, conditions(**regions), comm)
    solution = made_up(body, "forward", np.zeros_like)
    for k in range(8):
        means = [quantity(f"{side}{k}", "X", on=f"{side}{k}", reduce="mean") for side in "ba"]
        quantities = evaluate(means, body, solution)
        assert quantities[f"b{k}"] == pytest.approx(k / 2, rel=1e-12)  # four nodes at each of 0, 1, …, k
        assert quantities[f"a{k}"] == pytest.approx((k + 9) / 2, rel=1e-12)
