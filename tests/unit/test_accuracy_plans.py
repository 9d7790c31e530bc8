"""What a search for accuracy decides by: demands, forecasts, marks and judgements of errors, without any solve."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

from hpcinv.errors import JobError
from hpcinv.trust.accuracy.accuracy_record import AccuracyRecord, AccuracyStep, Ending
from hpcinv.trust.accuracy.assessment import Assessment, Finding, assess, hindsight
from hpcinv.trust.accuracy.marking import CLOSURE, plan
from hpcinv.trust.accuracy.refinement_forecast import (
    BOLD,
    CAREFUL,
    TARGET,
    RefinementForecast,
    RefinementPlaces,
    Step,
    Work,
    cautious,
    choose,
    nodes,
)
from hpcinv.trust.certificate import Verdict
from hpcinv.trust.certificate.check import Line, Topic
from hpcinv.trust.certificate.discretisation import DISCRETISATION
from hpcinv.trust.certificate.round_trip import ROUND_TRIP
from hpcinv.trust.certificate.volume import UNACCOUNTED

GOOD: dict[str, Any] = {
    "mesh": box(),
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 4.0},
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "quantities": [
        {"name": "tip", "of": "displacement", "at": [1, 1, 1]},
        {"name": "stretch", "of": "z/Z", "at": [1, 1, 1]},
        {"name": "stress", "of": "szz", "at": [0.5, 0.5, 0.5]},
        {"name": "volume", "of": 1, "on": "block", "reduce": "integral", "over": "reference"},
    ],
}


def test_demands_are_read_in_the_units_of_their_quantities() -> None:
    read = job(**GOOD, accuracy={"tip": "0.1 mm", "stretch": "0.1 %", "stress": "2 kPa", "volume": "1 cm^3"})
    assert read.accuracy == {"tip": 1e-4, "stretch": 1e-3, "stress": 2e3, "volume": pytest.approx(1e-6)}
    assert job(**GOOD).accuracy == {}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"accuracy": {"tp": 1}}, "accuracy.tp: there is no such quantity in 'quantities'. Did you mean 'tip'?"),
        ({"accuracy": {"tip": "1 kg"}}, "accuracy.tip: must be a length, as the quantity is, but '1 kg' is a mass"),
        ({"accuracy": {"stress": "1 mm"}}, "accuracy.stress: must be a stress, as the quantity is"),
        ({"accuracy": {"tip": 0}}, "accuracy.tip: must be above 0, not 0"),
        ({"accuracy": {"tip": [1]}}, "accuracy.tip: must be a number or a quantity"),
        ({"accuracy": 1e-3}, "accuracy: must be a mapping of names of quantities to their largest errors, not 0.001"),
        ({"accuracy": {"tip": 1}, "method": "sellier"}, "accuracy: needs 'method: direct'"),
        (
            {"accuracy": {"tip": 1}, "expected_shape": {"file": "../meshes/box.py"}},
            "cannot be combined with 'expected_shape'",
        ),
        ({"solver": {"maximum_unknowns": 10}}, "solver.maximum_unknowns: is not valid without 'accuracy'"),
    ],
)
def test_demands_that_cannot_be_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(JobError) as caught:
        job(**GOOD, **changes)
    assert text in str(caught.value)


def steps(
    sizes: Sequence[float | None], degrees: Sequence[int], *, power: float = 1.5, programs: float = 0.0
) -> list[Step]:
    """As a machine would make them that takes ``1e-6 N^power`` seconds for a factorization and hardly any else."""
    made = []
    for size, degree in zip(sizes, degrees, strict=True):
        cells = round(1000 / (size or 1.0) ** 3)
        n, finer = cells * degree**3, cells * (degree + 1) ** 3

        def work(degree: int, n: int, count: int, cells: int = cells) -> Work:
            assembly = 1e-9 * cells * nodes("tetrahedron", degree) ** 3
            return Work(degree, cells, n, count, count * assembly, count * 1e-6 * n**power)

        made.append(Step("tetrahedron", size, cells, work(degree, n, 2), work(degree + 1, finer, 1), programs))
    return made


def test_orders_and_costs_are_learnt() -> None:
    forecast = RefinementForecast(steps([1.0, 0.5, 0.25], [2, 2, 2]), [1.0, 2**-3.5, 2**-7.0], 10.0)
    assert forecast.order(2) == pytest.approx(3.5)
    assert forecast.power == pytest.approx(1.5)
    assert forecast.needed(2) == pytest.approx((10 / TARGET) ** (1 / 3.5))
    finer = forecast.everywhere(2.0, 2)
    assert finer.excess == pytest.approx(10 * 2**-3.5)
    assert finer.unknowns == 8 * forecast.last.unknowns
    n = finer.unknowns
    of_assembly = 1e-9 * 8 * forecast.last.cells * (1.5 * nodes("tetrahedron", 2) ** 3 + nodes("tetrahedron", 3) ** 3)
    assert finer.seconds == pytest.approx(1e-6 * (1.5 * n**1.5 + (n * 27 / 8) ** 1.5) + of_assembly)


def test_shells_get_four_cells_for_one() -> None:
    def step(size: float, cells: int) -> Step:
        solve, estimate = (Work(2, n, 30 * n, 2, 2e-6 * n, 2e-9 * (30 * n) ** 1.5) for n in (cells, 4 * cells))
        return Step("hexahedron", size, cells, solve, estimate, 0.0, dimension=2)

    forecast = RefinementForecast([step(1.0, 100), step(0.5, 400)], [1.0, 0.125], 10.0)
    finer = forecast.everywhere(2.0, 2)
    assert finer.unknowns == 4 * forecast.last.unknowns
    one = 1e-6 * 1600 + 1e-9 * (30 * 1600) ** 1.5
    four = 1e-6 * 6400 + 1e-9 * (30 * 6400) ** 1.5
    assert finer.seconds == pytest.approx(1.5 * one + four)
    # A limit of the unknowns that a solid would reach leaves a shell a finer mesh.
    choice = choose(forecast, [2.0, 4.0], None, limit=5 * forecast.last.unknowns, highest=2)
    assert choice is not None
    assert choice.factor == 2.0


def test_orders_are_presumed_with_care() -> None:
    single_step = RefinementForecast(steps([1.0], [2]), [1.0], 10.0)
    assert (single_step.order(2), single_step.order(3), single_step.is_known(2)) == (3.0, 4.0, False)
    two = RefinementForecast(steps([1.0, 0.5], [2, 2]), [1.0, 2**-2.5], 10.0)
    assert (two.order(2), two.order(3)) == (pytest.approx((2.5 + 3) / 2), 4.0)
    rough = RefinementForecast(steps([1.0, 0.5, 0.25], [2, 2, 2]), [1.0, 0.5, 0.25], 10.0)
    assert (rough.order(2), rough.order(3)) == (pytest.approx(1.0), pytest.approx(1.0))  # a corner limits both
    raised = RefinementForecast(steps([1.0, 1.0], [2, 3]), [1.0, 0.05], 10.0)
    assert raised.gain(2) == pytest.approx(0.05)
    factors = [1.5, 2.0, 3.0, 4.0, 6.0, 8.0]
    assert cautious(single_step, single_step.everywhere(8.0, 2), factors) == CAREFUL
    assert cautious(rough, rough.everywhere(8.0, 2), factors) == BOLD
    assert cautious(single_step, single_step.everywhere(1.5, 2), factors) == 1.5


def test_the_cheapest_that_is_enough_is_chosen() -> None:
    factors = [1.25, 1.5, 2.0, 4.0]
    smooth = RefinementForecast(steps([1.0, 0.5, 0.25], [2, 2, 2]), [1.0, 2**-3.0, 2**-6.0], 5.0)
    choice = choose(smooth, factors, None, limit=10**9, highest=2)
    assert choice is not None
    assert (choice.kind, choice.degree, choice.factor) == ("everywhere", 2, 2.0)
    # A far better mesh costs more than a degree more, unless its programs take long to make.
    demanding = RefinementForecast(steps([1.0, 0.5, 0.25], [2, 2, 2]), [1.0, 2**-3.0, 2**-6.0], 100.0)
    assert getattr(choose(demanding, factors, None, limit=10**9, highest=3), "degree", None) == 3
    slow = RefinementForecast(steps([1.0, 0.5, 0.25], [2, 2, 2], programs=1e9), [1.0, 2**-3.0, 2**-6.0], 50.0)
    assert getattr(choose(slow, factors, None, limit=10**9, highest=3), "degree", None) == 2
    # Refinement in places pays where it takes fewer cells.
    few, many = RefinementPlaces(3.0, 0.1), RefinementPlaces(60.0, 0.1)
    assert getattr(choose(smooth, factors, few, limit=10**9, highest=2), "kind", None) == "in places"
    assert getattr(choose(smooth, factors, many, limit=10**9, highest=2), "kind", None) == "everywhere"


def test_the_mesh_nearest_to_the_demand_within_the_limit_is_chosen() -> None:
    forecast = RefinementForecast(steps([1.0, 0.5, 0.25], [2, 2, 2]), [1.0, 2**-3.0, 2**-6.0], 100.0)
    n = forecast.last.unknowns
    choice = choose(forecast, [1.1, 1.5, 2.0], None, limit=4 * n, highest=2)
    assert choice is not None
    assert (choice.factor, choice.excess > 1) == (1.5, True)
    assert choose(forecast, [1.1, 1.5, 2.0], None, limit=n, highest=2) is None
    assert (
        choose(RefinementForecast(forecast.steps, [1.0, 0.95, 0.9], 100.0), [1.25], None, limit=4 * n, highest=2)
        is None
    )


def test_marks_take_the_fewest_cells() -> None:
    """Against all other ways to halve five cells up to twice."""
    shares, order = np.array([0.6, 0.25, 0.1, 0.04, 0.01]), 3.0
    best = {}
    for levels in itertools.product(range(4), repeat=5):
        error = float(np.sum(shares * 2.0 ** (-order * np.array(levels))))
        best[levels] = (error, sum(8.0**level for level in levels))
    for reduction in (2.0, 5.0, 20.0, 100.0):
        sweep_plan = plan(shares, reduction, order)
        error, cells = best[tuple(sweep_plan.levels.tolist())]
        assert error <= 1 / reduction
        assert error == pytest.approx(sweep_plan.places.error)
        assert sweep_plan.places.cells == pytest.approx(1 + CLOSURE * (cells / 5 - 1))
        fewest = min(c for e, c in best.values() if e <= 1 / reduction)
        print(f"error divided by {reduction}: {sweep_plan.levels.tolist()}, {cells:.0f} cells, fewest {fewest:.0f}")
        assert cells <= 4 * fewest  # cells are halved whole, and all with the same threshold


def findings(error: Any, sizes: Sequence[float], seen: float = 1.0, unseen: Any = lambda h: 0.0) -> list[Finding]:
    """Of the value 1, with errors that an estimate sees in part, and others that it does not see."""
    return [
        Finding(i, h, 2, {"q": 1 + error(h) + unseen(h)}, {"q": 1 + (1 - seen) * error(h) + unseen(h)})
        for i, h in enumerate(sizes)
    ]


def judged(trials: Sequence[Finding], order: float | None) -> list[Assessment]:
    made: list[Assessment] = []
    for i in range(len(trials)):
        made.append(assess(trials[: i + 1], {"q": 1e-3}, order, made[-1] if made else None))
    return made


@pytest.mark.parametrize("seen", [0.4, 0.7, 1.0, 1.4])
@pytest.mark.parametrize("order", [1.0, 3.0])
def test_an_estimate_that_sees_too_little_is_found_out(seen: float, order: float) -> None:
    trials = findings(lambda h: 0.05 * h**order, [1.0, 0.5, 0.25], seen)
    for assessment, finding in list(zip(judged(trials, None), trials, strict=True))[1:]:
        value = finding.values["q"]
        assert isinstance(value, float)
        assert abs(value - 1) <= assessment.bounds["q"] <= 8 * abs(value - 1)


@pytest.mark.parametrize("order", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("sizes", [(1.0, 0.5), (1.0, 0.5, 0.4), (1.0, 0.8, 0.4, 0.3)])
def test_other_meshes_bound_a_misleading_estimate(order: float, sizes: Sequence[float]) -> None:
    trials = findings(lambda h: 1e-9 * h**3, sizes, unseen=lambda h: 0.01 * h**order)
    *_, last = judged(trials, min(order, 2.0))
    error = 0.01 * sizes[-1] ** order
    assert error <= last.bounds["q"] <= 5 * error


def test_one_mesh_determines_no_rate_of_convergence() -> None:
    trials = findings(lambda h: 1e-6, [1.0])
    assert judged(trials, None)[0].excess == pytest.approx(2 * 1e-6 / 1e-3)
    assert math.isinf(judged(trials, 2.0)[0].excess)


def test_errors_of_vectors_are_lengths() -> None:
    trials = Finding(0, 1.0, 2, {"q": [1.0, 0.0, 0.0]}, {"q": [1.0, 3e-4, 4e-4]})
    assert assess([trials], {"q": 1e-3}, None).errors["q"] == pytest.approx(5e-4)
    assert hindsight([trials], {"q": 1e-3}) == [pytest.approx(0.5)]


@pytest.mark.parametrize("left_out", ["", ", the error of the geometry is not included"])
def test_the_certificate_names_the_demand_that_is_not_met(left_out: str) -> None:
    step = AccuracyStep("as it is", 48, 2, 375, {}, {}, {}, None, left_out, 3, 1.0)
    bounds, certain = {"a": 0.5, "b": math.inf}, {"a": 0.1, "b": 1.2}
    record = AccuracyRecord({"a": 1.0, "b": 1.0}, [step], 0, bounds, certain, Ending.LIMIT, 1.0)
    met, missed = record.lines({"a": "m"}, {"m": "mm"})
    rule = "pass up to 1000 mm, which accuracy.a demands; fail if half the estimate is larger"
    assert (met.value, met.unit, met.rule) == (0.5, "m", rule)
    assert (met.verdict, met.note) == (Verdict.PASS, left_out.removeprefix(", "))
    assert missed.verdict is Verdict.FAIL
    assert "not met" in missed.note
    assert missed.note.endswith(left_out)
    assert "solver.maximum_unknowns" in missed.note


def test_a_demand_that_only_safety_factors_exceed_is_not_decided() -> None:
    """Contact within a sphere: the bound exceeds the demand, the estimate does not; then it is far above."""
    for error, expected in ((0.8e-4, Verdict.UNDECIDED), (1.9e-4, Verdict.UNDECIDED), (2.1e-4, Verdict.FAIL)):
        finding = Finding(0, 1.0, 2, {"q": 1.0}, {"q": 1.0 + error})
        made = assess([finding], {"q": 1e-4}, None)
        step = AccuracyStep("as it is", 48, 2, 375, {}, made.errors, made.bounds, made.excess, "", 3, 1.0)
        record = AccuracyRecord({"q": 1e-4}, [step], 0, made.bounds, made.certain, Ending.LIMIT, 1.0)
        (line,) = record.lines({"q": "m"}, {"m": "mm"})
        assert made.excess > 1
        assert line.verdict is expected
        assert line.note.startswith(f"estimated as {error * 1e3:.3g} mm; not met: ")


def test_an_estimate_that_was_too_large_before_makes_no_failure_certain() -> None:
    """The richer discretisation was nearer than the estimate; the present estimate may be too large as well."""
    trials = [Finding(0, 1.0, 2, {"q": 1.0}, {"q": 2.0}), Finding(0, 1.0, 3, {"q": 1.01}, {"q": 1.02})]
    alone, after = judged(trials, None)
    assert alone.certain["q"] == pytest.approx(0.5)
    assert after.certain["q"] == pytest.approx(0.005 * 0.02)


@pytest.mark.parametrize("side", [1, -1])
def test_no_failure_is_certain_above_the_error(side: int) -> None:
    """Values of a richer discretisation on both sides of the true value, 1, which are not less accurate."""
    for richer in np.linspace(-1, 1, 9):
        error = 0.3 * side
        trial = Finding(0, 1.0, 2, {"q": 1 + error}, {"q": 1 + richer * error})
        assert assess([trial], {"q": 1e-3}, None).certain["q"] <= abs(error) * (1 + 1e-12)


def test_an_estimate_that_falls_faster_than_its_value_changes_is_not_believed() -> None:
    """Of the corner of hexahedra: the estimate falls by 20, and the change of the value leaves a far larger error."""
    values, estimates = [-0.13833, -0.14151], [-4.3e-3, -2.2e-4]
    ratio = 0.33  # that the corner allows
    trials = [
        Finding(i, 0.5**i, 2, {"q": q}, {"q": q + e}, ratio * i, is_reliable=False)
        for i, (q, e) in enumerate(zip(values, estimates, strict=True))
    ]
    first = assess(trials[:1], {"q": 1e-3}, None)
    assert first.bounds["q"] == math.inf  # on one mesh errors may cancel
    second = assess(trials, {"q": 1e-3}, None, first)
    assert second.bounds["q"] >= 3.17e-3 * ratio / (1 - ratio)
    assert second.bounds["q"] >= 8.0e-4  # the true error
    assert second.excess > 1
    trusted = assess([replace(f, ratio=0.0, is_reliable=True) for f in trials[:1]], {"q": 1e-2}, None)
    assert trusted.bounds["q"] == pytest.approx(2 * 4.3e-3)  # with nothing singular, by the estimate alone


def test_pieces_at_a_singular_edge_are_halved_again() -> None:
    shares, limits = np.array([1.0, 1.0, 1.0]), np.array([1.1, np.inf, np.inf])
    marked = plan(shares, 20.0, 3.0, limits)
    assert marked.levels[0] > marked.levels[1] == marked.levels[2]
    assert marked.places.cells < 1 + CLOSURE * float(np.mean(8.0**marked.levels - 1))  # not all pieces of the first one
    expected = (2 ** (-1.1 * marked.levels[0]) + 2 * 2.0 ** (-3 * marked.levels[1])) / 3
    assert marked.places.error == pytest.approx(expected)


def test_one_mesh_with_singular_edges_proves_nothing() -> None:
    """The second mesh of a stepped bar (true value -0.4298): the bound is the change between meshes, or larger."""
    values, estimates = [-0.4178, -0.4183, -0.4206], [-1.0e-3, -9.5e-3, -5.9e-3]
    trials = [
        Finding(mesh, size, degree, {"q": q}, {"q": q + e}, ratio, needs_test=True)
        for mesh, size, degree, q, e, ratio in zip(
            (0, 0, 1), (1.0, 1.0, 0.5), (2, 3, 2), values, estimates, (0.0, 0.41, 0.5), strict=True
        )
    ]
    alone, raised, tested = judged(trials, None)
    assert alone.bounds["q"] == raised.bounds["q"] == math.inf  # a higher degree on the one mesh is not a test
    assert tested.bounds["q"] >= max(2.8e-3, 0.4298 - 0.4206)
    trusted = assess([replace(trials[0], needs_test=False)], {"q": 1e-3}, None)
    assert trusted.bounds["q"] == pytest.approx(2 * 1.0e-3)


@pytest.mark.parametrize("order", [0.5, 1.0, 1.5])
def test_the_rate_of_the_last_changes_counts(order: float) -> None:
    """Errors fall slowly, and the estimates of them by 20."""
    sizes, estimates = (1.0, 0.5, 0.25), (4e-3, 2e-4, 1e-5)
    trials = [
        Finding(i, h, 2, {"q": 1 + 0.01 * h**order}, {"q": 1 + 0.01 * h**order - e})
        for i, (h, e) in enumerate(zip(sizes, estimates, strict=True))
    ]
    error = 0.01 * sizes[-1] ** order
    last = judged(trials, None)[-1]
    assert last.least["q"] == pytest.approx(error, rel=1e-6)
    assert error * (1 - 1e-6) <= last.bounds["q"] <= 2 * error


@pytest.mark.parametrize("is_confirmed", [True, False])
def test_irregular_changes_count_less_where_estimates_are_confirmed(*, is_confirmed: bool) -> None:
    """Contact within a sphere (true value 0.694497): changes grow, and estimates are the errors, or miss their size."""
    values, corrected = [0.694266, 0.693698, 0.694513], [0.694446, 0.694435, 0.694496]
    if not is_confirmed:
        corrected = [v + 0.2 * (c - v) for v, c in zip(values, corrected, strict=True)]
    trials = [Finding(i, 0.5**i, 2, {"q": q}, {"q": c}) for i, (q, c) in enumerate(zip(values, corrected, strict=True))]
    bound, error = judged(trials, None)[-1].bounds["q"], abs(values[-1] - 0.694497)
    assert bound >= error
    assert (bound <= 10 * error) is is_confirmed


def test_errors_of_a_layer_enter_the_bound() -> None:
    trial = Finding(0, 1.0, 2, {"q": 1.0}, {"q": 1.0 + 1e-4})
    judged_layer = assess([trial], {"q": 1e-3}, None, layer={"q": 2e-3})
    assert judged_layer.bounds["q"] == pytest.approx(2 * 1e-4 + 2e-3)
    assert judged_layer.layer_excess == 2.0  # no mesh meets the demand
    assert assess([trial], {"q": 1e-3}, None).layer_excess == 0.0


@pytest.mark.parametrize("topic", [DISCRETISATION, UNACCOUNTED])
def test_a_certificate_that_doubts_the_mesh_leaves_a_promise_undecided(topic: Topic) -> None:
    step = AccuracyStep("as it is", 48, 2, 375, {}, {}, {}, None, "", 3, 1.0)
    bounds, certain = {"a": 0.5, "b": 4.0}, {"a": 0.1, "b": 1.2}
    record = AccuracyRecord({"a": 1.0, "b": 1.0}, [step], 0, bounds, certain, Ending.LIMIT, 1.0)
    doubt = Line(topic, 0.08, "", "warning above 0.05", Verdict.WARN)
    met, missed = record.lines({}, {}, [doubt])
    assert (met.verdict, missed.verdict) == (Verdict.UNDECIDED, Verdict.FAIL)
    assert met.note == f"the certificate doubts the mesh: {topic.name}"
    sure, _ = record.lines({}, {}, [replace(doubt, verdict=Verdict.PASS), replace(doubt, topic=ROUND_TRIP)])
    assert sure.verdict is Verdict.PASS
