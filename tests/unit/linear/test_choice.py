"""The rule that chooses a linear solver: its forecasts against MUMPS's own counts, and what it says."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from helpers.verification import box, job

import hpcinv.solver.linear.selection
from hpcinv import run
from hpcinv.base.parallel.left_for_run import available
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.settings import Solver
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.cost_model import COMPACT, Forecast, Shape, shape_of
from hpcinv.solver.linear.selection import Chooser

pytestmark = pytest.mark.slow

SOFT: dict[str, Any] = {
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 200}],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
}


def model(mesh: dict[str, Any], comm: MPI.Intracomm) -> Equations:
    given = job(**SOFT, mesh=mesh)
    return Equations(given, build_body(given.mesh, {}, comm, resolve=given.resolve), Timings())


@pytest.mark.release
@pytest.mark.parametrize(
    ("divisions", "size"), [((6, 6, 6), (1, 1, 1)), ((3, 3, 30), (1, 1, 10)), ((12, 4, 4), (3, 1, 1))]
)
def test_operations_and_entries_are_what_mumps_counts(
    divisions: tuple[int, int, int], size: tuple[float, float, float], comm: MPI.Intracomm
) -> None:
    body = model(box(divisions, **dict(zip(("lx", "ly", "lz"), size, strict=True))), comm)
    equilibrium = body.equilibrium(body.weak_form("inverse"))
    equilibrium.system.linearise(1.0)
    equilibrium.linear.factorize()
    factors = equilibrium.linear.ksp.pc.getFactorMatrix()
    forecast = body.chooser.forecast
    assert 0.6 < forecast.operations / factors.getMumpsRinfog(3) < 1.6
    assert 0.6 < forecast.entries / factors.getMumpsInfog(20) < 1.6
    equilibrium.destroy()


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_shape_of_a_block(comm: MPI.Intracomm) -> None:
    block_shape = shape_of(model(box((3, 3, 12), lz=4.0), comm).unknowns)
    nodes_across = 7 * 7  # of degree 2
    assert block_shape.aspect == pytest.approx(4.0, rel=0.2)
    assert block_shape.cut == pytest.approx(3 * nodes_across, rel=0.2)
    assert block_shape.is_solid
    assert not shape_of(model(box((6, 6, 1), lz=0.1), comm).unknowns).is_solid


@pytest.mark.parametrize("shape", [Shape(cut=300.0, aspect=4.0), Shape(cut=108.0, aspect=30.0)])
def test_a_shape_is_found_from_its_operations(shape: Shape) -> None:
    unknowns = round(shape.aspect * shape.cut**1.5 / 3**0.5)
    equal_rod = Shape.equal_rod(Forecast(unknowns, 2, shape).operations, unknowns)
    assert (equal_rod.cut, equal_rod.aspect) == pytest.approx((shape.cut, shape.aspect), rel=1e-3)


@pytest.mark.parallel([1, 2, 3])
def test_bodies_whose_extents_do_not_decide_are_analysed(comm: MPI.Intracomm) -> None:
    body = model(box((2, 2, 16), lz=8.0), comm)
    body.chooser.forecast = Forecast(300_000, 2, Shape(cut=8700.0, aspect=1.0))  # a cube
    body.chooser.room = 1e12
    ratio = body.chooser.forecast.direct / body.chooser.forecast.iterative
    equilibrium = body.equilibrium(body.weak_form("inverse"))
    assert 1.1 < ratio < 10
    assert equilibrium.linear.choice.configuration == "direct"
    equilibrium.system.linearise(1.0)
    equilibrium.linear.factorize()
    counted = equilibrium.linear.ksp.pc.getFactorMatrix().getMumpsRinfog(3)
    # Ranks that share a factorization have other fronts.
    assert 0.5 < body.chooser.forecast.operations / counted < 2.0
    equilibrium.destroy()


@pytest.mark.parallel([1, 2])
def test_memory_is_shared_by_the_ranks_of_a_node(comm: MPI.Intracomm) -> None:
    total = available(comm)
    assert len(set(comm.allgather(total))) == 1
    assert 1e8 < total < 1e15
    assert total == pytest.approx(available(MPI.COMM_SELF), rel=0.2)


@pytest.mark.parametrize(
    ("shape", "unknowns", "displacement_form", "mixed_form"),
    [
        (Shape(cut=14_400, aspect=1.0), 1_000_000, "iterative", "iterative"),
        (Shape(cut=1000, aspect=1.1), 20_000, "iterative", "direct"),  # the mixed form takes twice the iterations
        (Shape(cut=500, aspect=1.1), 7_000, "direct", "direct"),
        (Shape(cut=236, aspect=40.0), 82_000, "direct", "direct"),
    ],
)
@pytest.mark.parametrize("is_mixed", [False, True])
def test_large_chunky_bodies_are_solved_iteratively_and_others_directly(
    shape: Shape, unknowns: int, displacement_form: str, mixed_form: str, is_mixed: bool, comm: MPI.Intracomm
) -> None:
    expected = mixed_form if is_mixed else displacement_form
    chooser = Chooser(model(box((1, 1, 1)), comm).unknowns, 2)
    chooser.forecast, chooser.room = Forecast(unknowns, 2, shape, is_mixed), 1e12
    chosen = chooser.choose(job(**SOFT, mesh=box()).solver)
    assert chosen.configuration == expected
    assert "times as long" in chosen.why
    assert chosen.other is not None


@pytest.mark.parametrize("continuation", ["auto", "steps"])
def test_a_count_of_operations_does_not_change_the_precision(
    continuation: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lattice of 169,809 unknowns has 4 % of the operations of a block; double precision took 1.6 times as long.

    A sponge, whose equal rod is not compact, took 1.4 times as long by its factors in double precision.
    """
    body = model(box((2, 2, 2)), comm)
    chooser, solver = body.chooser, Solver.model_validate({"continuation": continuation})
    chooser.forecast = replace(chooser.forecast, shape=replace(chooser.forecast.shape, is_solid=False))
    operations = chooser.forecast.operations
    replaced = {
        "SINGLE": 0.9 * operations,
        "_WORTH": 0.0,
        "_OBVIOUS": math.inf,
        "on_demand": lambda _: lambda *_: operations / 25,
    }
    for name, value in replaced.items():
        monkeypatch.setattr(hpcinv.solver.linear.selection, name, value)
    before = chooser.choose(solver)
    chooser.analyse(solver, body.unknowns)
    assert chooser.forecast.operations < 0.9 * operations
    assert chooser.forecast.shape.aspect > COMPACT
    choice = chooser.choose(solver)
    assert (choice.precision, choice.is_refined) == (before.precision, before.is_refined) == ("single", True)


@pytest.mark.parallel([1, 2])
def test_flat_cells_are_solved_directly(comm: MPI.Intracomm) -> None:
    flat, cubes = (model(box((2, 2, layers), lz=height), comm).chooser for layers, height in ((2, 0.02), (2, 1.0)))
    for chooser in (flat, cubes):
        chooser.forecast, chooser.room = Forecast(300_000, 2, Shape(cut=6_000, aspect=1.0)), 1e12
    assert flat.choose(Solver()).why == "100% of the cells are too flat for multigrid"
    assert (flat.choose(Solver()).configuration, flat.choose(Solver()).other) == ("direct", "iterative")
    assert cubes.choose(Solver()).configuration == "iterative"


def test_multigrid_of_degree_1_costs_what_was_measured() -> None:
    """Processor seconds of solves with 1 to 4 set-ups and 47 to 299 iterations, without their assembly."""
    for unknowns, set_ups, iterations, seconds in (
        (10_212, 1, 47, 0.37),
        (27_783, 1, 63, 1.40),
        (14_136, 4, 299, 3.37),
    ):
        forecast = Forecast(unknowns, 1, Shape(cut=1000.0, aspect=1.0))
        assert forecast.multigrid_time(set_ups, iterations) == pytest.approx(seconds, rel=0.2)


@pytest.mark.parametrize("continuation", ["auto", "series", "steps"])
@pytest.mark.parametrize(("aspect", "is_compact"), [(1.1, True), (6.0, False)])
def test_series_take_double_precision_except_on_compact_bodies(
    aspect: float, is_compact: bool, continuation: str, comm: MPI.Intracomm
) -> None:
    """A cube of 15,468 unknowns takes 1.2 times as long with it (`benchmarks/continuation.py`)."""
    chooser = Chooser(model(box((1, 1, 1)), comm).unknowns, 2)
    chooser.forecast, chooser.room = Forecast(15_000, 2, Shape(cut=900.0, aspect=aspect), True), 1e12
    assert chooser.is_compact == is_compact
    single = is_compact or continuation == "steps"
    choice = chooser.choose(Solver.model_validate({"linear": "direct", "continuation": continuation}))
    assert choice.precision == ("single" if single else "double")
    assert choice.is_refined


@pytest.mark.parametrize(("aspect", "low_rank"), [(1.0, True), (40.0, False)])
def test_blocks_of_slender_bodies_are_not_compressed(aspect: float, low_rank: bool, comm: MPI.Intracomm) -> None:
    """A rod of 555,747 unknowns takes 56 s of a rank by full blocks, 157 s by compressed ones, 34 s by multigrid."""
    mesh = box((1, 1, 1)) if aspect == 1 else box((1, 1, 40), lz=aspect)
    chooser = model(mesh, comm).chooser
    chooser.forecast, chooser.room = Forecast(555_747, 2, Shape(cut=832.0, aspect=aspect)), 1e12
    choice = chooser.choose(Solver.model_validate({"linear": "direct"}))
    assert (choice.precision, choice.low_rank) == ("single", low_rank)
    if not low_rank:
        assert 1.1 < chooser.forecast.direct / chooser.forecast.iterative < 2.0


def test_iterations_cost_the_entries_of_rows() -> None:
    """A cube of 20,577 unknowns takes 8.5 ms with degree 2, 14 ms with degree 3; there, factors take 0.75 as long."""
    quadratic, cubic = (Forecast(20_577, degree, Shape(cut=1026.0, aspect=1.0)) for degree in (2, 3))
    assert cubic.multigrid_time(0, 1) / quadratic.multigrid_time(0, 1) == pytest.approx(14 / 8.5, rel=0.1)
    assert 0.6 < cubic.direct / cubic.iterative < 0.85


@pytest.mark.parametrize(("stiffness", "factor"), [(2.2, 1.0), (49.7, 52 / 25), (500.0, 160 / 25)])
def test_nearly_incompressible_bodies_take_more_iterations_in_the_displacement_form(
    stiffness: float, factor: float
) -> None:
    """Cubes of degree 2 take 25, 52 and 160 iterations to 1e-6 with Poisson's ratios of 0.45, 0.49 and 0.499."""
    soft, stiff = (Forecast(6_591, 2, Shape(cut=500.0, aspect=1.0), stiffness=ratio) for ratio in (1.0, stiffness))
    assert stiff.krylov / soft.krylov == pytest.approx(factor, rel=0.15)
    mixed = Forecast(6_591, 2, Shape(cut=500.0, aspect=1.0), is_mixed=True)
    assert replace(mixed, stiffness=math.inf).krylov == mixed.krylov


def test_stiffness_reaches_the_forecast(comm: MPI.Intracomm) -> None:
    given = job(
        **SOFT | {"material": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.499}},
        mesh=box((1, 1, 1)),
        discretisation={"displacement": 2, "formulation": "displacement"},
    )
    equations = Equations(given, build_body(given.mesh, {}, comm, resolve=given.resolve), Timings())
    chooser = equations.chooser
    assert chooser.forecast.stiffness == pytest.approx(499.7, abs=0.1)
    assert "formulation: mixed" not in chooser.choose(Solver()).why  # factors, which do not mind
    assert (
        "multiplies iterations by about 7.1 in the displacement form, but not"
        in chooser.choose(Solver(linear="iterative")).why
    )
    chooser.forecast = replace(chooser.forecast, stiffness=2.0)
    assert "formulation" not in chooser.choose(Solver(linear="iterative")).why


def test_slow_multigrid_stops_after_a_fifth_of_the_time_of_factorizations(comm: MPI.Intracomm) -> None:
    chooser = Chooser(model(box((1, 1, 1)), comm).unknowns, 2)
    chooser.forecast, chooser.room = Forecast(300_000, 2, Shape(cut=6_000, aspect=1.0)), 1e12
    forecast, choice = chooser.forecast, chooser.choose(Solver())
    assert choice.configuration == "iterative"
    assert forecast.krylov < choice.most < math.inf
    assert forecast.multigrid_time(0, choice.most) < 0.2 * forecast.direct
    assert chooser.choose(Solver(linear="iterative")).most == math.inf
    chooser.room = 0.0  # there is no other
    assert chooser.choose(Solver()).most == math.inf


@pytest.mark.parametrize(
    ("ratio", "configuration", "why"),
    [
        (1.6, "iterative", "factorizations would take about 1.6 times as long as multigrid"),
        (
            1.05,
            "direct",
            "multigrid would take about 0.95 times as long as factorizations; it is taken below 0.91, since",
        ),
        (0.5, "direct", "multigrid would take about 2 times as long as factorizations"),
    ],
)
def test_the_reason_that_is_reported_is_the_one_that_decided(
    ratio: float, configuration: str, why: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    chooser = Chooser(model(box((1, 1, 1)), comm).unknowns, 2)
    monkeypatch.setattr(Forecast, "direct", property(lambda forecast: ratio * forecast.iterative))
    chosen = chooser.choose(job(**SOFT, mesh=box()).solver)
    assert chosen.configuration == configuration
    assert chosen.why.split(" of them in a cross-section, ")[1].startswith(why)
    assert ("it is taken" in chosen.why) == (configuration == "direct" and ratio > 1)


@pytest.mark.parallel([1, 2])
def test_without_memory_for_factors_nothing_is_factorized(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hpcinv.solver.linear.selection, "available", lambda comm: 1e5)
    result = run(job(**SOFT, mesh=box((3, 3, 3)), certificate={"round_trip": "near"}), comm)
    used = result.statistics["solutions"][0]["linear"]
    assert used["configuration"] == "iterative"
    assert used["why"].startswith("factors would take 0.0")
    lines = {line.name: line for line in result.certificate.lines}
    estimated = lines["discretisation error of the shape, relative to the displacement"]
    assert estimated.value is None
    assert estimated.note.startswith("there is no memory for")
    assert lines["stability: unstable directions"].value == 0.0
    assert "; estimated" in lines["stability: unstable directions"].note
    assert lines["round trip, relative to the displacement"].value is not None


def test_a_solver_of_the_users_own_is_left_alone(comm: MPI.Intracomm) -> None:
    own = job(**SOFT, mesh=box(), solver={"petsc": {"pc_type": "gamg", "ksp_type": "fgmres"}}).solver
    chosen = Chooser(model(box((1, 1, 1)), comm).unknowns, 2).choose(own)
    assert chosen.is_own
    assert chosen.other is None


def test_a_hierarchy_is_kept_where_four_of_them_fit_in_memory(comm: MPI.Intracomm) -> None:
    chooser = model(box((2, 2, 2)), comm).chooser
    for share, kept in ((1.01, True), (0.99, False)):
        chooser.room = share * 4 * chooser.forecast.multigrid
        assert chooser.can_keep_multigrid is kept


@pytest.mark.parametrize(("length", "slender"), [(4.0, False), (40.0, True)])
def test_slender_bodies_have_factors_of_their_own_kind(length: float, slender: bool, comm: MPI.Intracomm) -> None:
    body = model(box((2, 2, 20), lz=length), comm)
    choice = body.chooser.choose(body.job.solver)
    assert (choice.minimum_fill, choice.nearly_symmetric) == (slender, not slender)


@pytest.mark.parallel(2)
def test_minimum_fill_is_for_one_rank(comm: MPI.Intracomm) -> None:
    body = model(box((2, 2, 20), lz=40.0), comm)
    assert not body.chooser.choose(body.job.solver).minimum_fill


@pytest.mark.parametrize(
    ("shape", "unknowns", "expected"),
    [
        (Shape(cut=431, aspect=24), 125_000, {"inverse", "forward"}),
        (Shape(cut=195, aspect=24), 38_000, {"inverse", "forward"}),
        (Shape(cut=155, aspect=24), 27_000, {"forward"}),
        (Shape(cut=130, aspect=24), 20_000, set()),  # cells twice as large are too coarse
        (Shape(cut=3_000, aspect=1), 125_000, set()),  # one factorization is enough anyway
    ],
)
def test_nested_iteration_is_taken_where_it_clearly_pays(
    shape: Shape, unknowns: int, expected: set[str], comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forecast(*_: Any) -> Forecast:
        return Forecast(unknowns, 2, shape)

    monkeypatch.setattr(hpcinv.solver.linear.selection, "Forecast", forecast)
    monkeypatch.setattr(hpcinv.solver.linear.selection, "shape_of", lambda _: shape)
    chooser = Chooser(model(box((1, 1, 1)), comm).unknowns, 2)
    chooser.room = 1e12
    directions: tuple[Any, ...] = ("inverse", "forward")
    nested = {direction for direction in directions if chooser.is_nested_iteration_worth(Solver(), direction)}
    assert nested == expected
    assert not chooser.is_nested_iteration_worth(Solver(linear="iterative"), "forward")
    chooser._ranks = 1000  # the coarser mesh is made on one
    assert not chooser.is_nested_iteration_worth(Solver(), "forward")


def test_a_coarser_mesh_has_an_eighth_of_the_unknowns() -> None:
    coarser = Forecast(80_000, 2, Shape(cut=400, aspect=20)).coarser
    assert coarser.unknowns == 10_000
    assert coarser.shape == Shape(cut=100, aspect=20)
