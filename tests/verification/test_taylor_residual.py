"""Coefficients of the residual along a line of states and loads, under every effect of the registry.

The truncated series is compared with the assembled residual: each order more must gain one power of the distance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.verification import box, deform, job
from helpers.without_compiler import without_compiler
from mpmath import mp

from hpcinv.base.parallel import code_cache
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.assembly import taylor_residual
from hpcinv.model.assembly.system import System
from hpcinv.model.assembly.taylor_residual import TaylorResidual
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.effects import effects
from hpcinv.physics.points.scalar_graph import NotAnalytic, ScalarGraph
from hpcinv.solver.equations import Equations

ORDER = 10
SWITCHES = ("contact", "hydrostatic-pressure")
ANALYTIC = [name for name, kind in sorted(effects().items()) if name not in SWITCHES and not kind.only_of_kind]
FIBRES = {"fibre": {"direction": ["1 + y/(3 m)", "0.5", "Z/(2 m)"], "given_on": "current"}}
KINDS = [(direction, form) for direction in ("forward", "inverse") for form in ("displacement", "mixed")]


def model_of(direction: str, formulation: str, names: list[str], comm: MPI.Intracomm) -> Equations:
    listed: list[dict[str, Any]] = []
    for name in names:
        key = next((key for key in ("density_in", "area_in") if key in effects()[name].model_fields), None)
        listed.append(effects()[name].example | ({key: "current"} if key else {}))
    data = job(
        analysis=direction,
        mesh=box((2, 1, 1)),
        material={"law": "mooney-rivlin", "c1": "10 kPa*(1 + X/(10 m) + y/(5 m))", "c2": "5 kPa", "d1": "100 kPa"},
        effects=listed,
        fibres=FIBRES if "active-stress" in names else {},
        discretisation={"formulation": formulation, "quadrature": 2},
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
    )
    return Equations(data, build_body(data.mesh, data.regions, comm, resolve=data.resolve), Timings())


def larger(value: Any) -> Any:
    return [*map(larger, value)] if isinstance(value, tuple) else 1.1 * value


@pytest.mark.everyday("inverse-mixed")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize(("direction", "formulation"), KINDS)
def test_series_of_the_residual_converges_with_its_order(direction: str, formulation: str, comm: MPI.Intracomm) -> None:
    """With the load of all effects; forward, in one form, with the first quantity of each and the moduli."""
    model = model_of(direction, formulation, ANALYTIC, comm)
    if (direction, formulation) == KINDS[0]:
        changes: dict[str, Any] = {"material.c1": "13 kPa*(1 + X/(8 m) + y/(5 m))", "material.d1": "80 kPa"}
        for number, effect in enumerate(model.job.effects):
            name, (value, _) = next(iter(effect.quantities().items()))
            changes[f"effects[{number}].{name}"] = larger(value)
        model.weak_form(model.job.directions[0]).begin_line(model.job.with_(changes))
    deform(model.unknowns)
    weak_form, state = model.weak_form(model.job.directions[0]), model.unknowns.state
    system, load = System(weak_form, model.supports, Timings()), 0.7
    along, start = fem.Function(model.unknowns.space), state.x.array.copy()
    along.x.petsc_vec.array[:] = 0.02 * np.random.default_rng(comm.rank).normal(size=len(system.rhs.array))
    along.x.scatter_forward()

    def coefficients_of(taylor: TaylorResidual, *, puts_late: bool = False) -> list[np.ndarray]:
        system.set_load(load)
        taylor.begin(ORDER, load)
        found = []
        for order in range(ORDER + 1):
            if order == 1 + puts_late:
                taylor.put(1, along.x.array, 0.3)
            taylor.assemble(order, system.rhs)
            found.append(system.rhs.array.copy())
        return found

    coefficients = coefficients_of(TaylorResidual(weak_form))
    with without_compiler():
        arrays = coefficients_of(TaylorResidual(weak_form), puts_late=True)
    for order, (ours, theirs) in enumerate(zip(arrays, coefficients, strict=True)):
        if order != 1:  # that one without its unknowns
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13 * float(np.abs(coefficients[0]).max()))

    def norm(values: np.ndarray) -> float:
        return math.sqrt(comm.allreduce(float(values @ values)))

    def errors(a: float) -> list[float]:
        state.x.array[:] = start + a * along.x.array
        exact = system.forces(load + 0.3 * a)
        sums = np.cumsum([a**k * values for k, values in enumerate(coefficients)], axis=0)
        return [norm(sums[order] - exact) / norm(coefficients[0]) for order in (1, 2, 5, ORDER)]

    far, near = errors(0.4), errors(0.2)
    rates = [math.log2(a / b) for a, b in zip(far, near, strict=True)]
    if comm.rank == 0:
        print(f"errors {near}, rates {rates}")
    for rate, order in zip(rates, (1, 2, 5, ORDER), strict=True):
        assert rate == pytest.approx(order + 1, abs=0.3)
    assert errors(0.02)[-1] < 1e-13


@pytest.mark.release
def test_coefficients_at_a_point_agree_with_mpmath(comm: MPI.Intracomm) -> None:
    """Of the stress, the volume equation and all loads, at the first point of each integral."""
    model = model_of("inverse", "mixed", ANALYTIC, comm)
    deform(model.unknowns)
    weak_form, state = model.weak_form("inverse"), model.unknowns.state
    taylor, load = TaylorResidual(weak_form), 0.7
    along = 0.1 * np.random.default_rng(0).normal(size=len(state.x.array))
    model.put_load(load)
    taylor.begin(ORDER, load)
    taylor.put(1, along, 0.3)
    graphs = graphs_of(weak_form)
    errors, parts = [], {part._kernel.plan.text: part for part in taylor._parts if part._count}
    assert parts.keys() == graphs.keys()
    for text, part in parts.items():
        graph, outputs = graphs[text]
        coefficients = []
        for order in range(ORDER + 1):
            coefficients.append(part._series.sweep(order, part._leaves, part._inputs)[0, :, 0].copy())
        expected = exact_coefficients(graph, outputs, part._leaves[0, :, :2, 0].T, part._inputs[0, :, 0])
        for order, values in enumerate(coefficients):
            size = max(np.abs(expected[order]).max(), 1e-30 * np.abs(expected).max())  # zeros have rounding errors
            errors.append(np.abs(values - expected[order]).max() / size)
    print(f"{len(parts)} integrands: {max(errors):.1e}")
    assert max(errors) < 1e-10


def graphs_of(weak_form: WeakForm) -> dict[str, tuple[ScalarGraph, list[int]]]:
    """Graphs and outputs of the integrals of a weak form, by their C code; nothing is compiled."""
    integrals = (*taylor_residual._volume(weak_form), *taylor_residual._surface(weak_form))
    duals = [taylor_residual._derived(integral.integrand, weak_form) for integral in integrals]
    return {own.plan().text: (own.reduced, own.nodes) for own in duals}


def exact_coefficients(
    graph: ScalarGraph, outputs: list[int], leaves: np.ndarray, inputs: np.ndarray
) -> list[np.ndarray]:
    """Coefficients of nodes for leaves (orders, n), by Cauchy's integral with 80 digits."""
    points, radius = 24, mp.mpf(2) ** -10
    with mp.workdps(80):
        roots = mp.unitroots(points)
        paths = [[mp.mpf(c) for c in path] for path in leaves.T.tolist()]
        at = ([sum(c * (radius * root) ** k for k, c in enumerate(path)) for path in paths] for root in roots)
        values = [evaluated(graph, outputs, moved, inputs) for moved in at]
        return [
            np.array(
                [
                    float(
                        mp.re(sum(v[node] * roots[-j * k % points] for j, v in enumerate(values))) / points / radius**k
                    )
                    for node in outputs
                ]
            )
            for k in range(ORDER + 1)
        ]


def evaluated(graph: ScalarGraph, outputs: list[int], leaves: list[Any], inputs: np.ndarray) -> dict[int, Any]:
    """Values of the needed nodes in the arithmetic of the leaves, functions in their closed forms."""
    values = dict[int, Any]()
    for node in graph.needed(outputs):
        match operation := graph.operations[node]:
            case ("leaf", number):
                values[node] = leaves[number]
            case ("input", number):
                values[node] = mp.mpf(inputs[number])
            case ("number", value):
                values[node] = mp.mpf(value)
            case ("add", a, b):
                values[node] = values[a] + values[b]
            case ("multiply", a, b):
                values[node] = values[a] * values[b]
            case ("divide", a, b):
                values[node] = values[a] / values[b]
            case ("power", a, n):
                values[node] = values[a] ** values[n]
            case ("function" | "integral", name, x, *_):
                values[node] = getattr(mp, name)(values[x])
            case ("choose", _, _, _, closed, _):
                values[node] = values[closed]
            case _:
                raise AssertionError(operation)
    return values


@pytest.mark.parametrize("name", SWITCHES)
def test_effects_with_switches_have_no_series(name: str, comm: MPI.Intracomm) -> None:
    model = model_of("forward", "displacement", [name], comm)
    with pytest.raises(NotAnalytic, match="switch"):
        TaylorResidual(model.weak_form("forward"))


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_taylor_arithmetic_is_derived_once(
    comm: MPI.Intracomm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And again, where the record or the program of its inputs is not there any more, or is damaged."""
    directory = Path(comm.bcast(str(tmp_path)))
    monkeypatch.setattr(code_cache, "_places", (directory,))
    derivations = 0

    def derive(*arguments: Any) -> Any:
        nonlocal derivations
        derivations += 1
        return derived(*arguments)

    derived = taylor_residual._derived
    monkeypatch.setattr(taylor_residual, "_derived", derive)

    def coefficients(names: list[str]) -> tuple[bool, list[np.ndarray]]:
        """Whether Taylor arithmetic is derived in a new model, and its coefficients."""
        model, before = model_of("inverse", "displacement", names, comm), derivations
        deform(model.unknowns)
        weak_form, values = model.weak_form("inverse"), []
        system, taylor = System(weak_form, model.supports, Timings()), TaylorResidual(weak_form)
        system.set_load(0.7)
        taylor.begin(2, 0.7)
        for order in range(3):
            taylor.put(order, model.unknowns.state.x.array / (order + 1), 0.3)
            taylor.assemble(order, system.rhs)
            values.append(system.rhs.array.copy())
        return comm.allreduce(derivations > before, MPI.LOR), values

    def damage() -> None:
        for path in directory.glob("taylor_*.json"):
            path.write_bytes(path.read_bytes()[:-60] + bytes(60))

    def forget(pattern: str) -> None:
        for path in directory.glob(pattern):
            path.unlink()

    is_new, first = coefficients(["pressure"])
    assert is_new
    changes: list[tuple[bool, Callable[[], object]]] = [
        (False, lambda: None),
        (True, lambda: forget("points_*.npz")),
        (True, lambda: forget("taylor_*.json")),
        (True, damage),
        (False, lambda: None),
    ]
    for expected, change in changes:
        comm.barrier()
        if comm.rank == 0:
            change()
        comm.barrier()
        is_new, again = coefficients(["pressure"])
        assert is_new == expected
        for a, b in zip(first, again, strict=True):
            np.testing.assert_array_equal(a, b)
    assert coefficients(["gravity"])[0]


def test_reason_without_a_series_is_recorded(
    comm: MPI.Intracomm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(code_cache, "_places", (tmp_path,))
    for _ in range(2):
        with pytest.raises(NotAnalytic, match="switch"):
            TaylorResidual(model_of("forward", "displacement", ["contact"], comm).weak_form("forward"))
        monkeypatch.setattr(taylor_residual, "_derived", None)  # the second time, nothing is derived
