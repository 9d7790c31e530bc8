"""Newton's method and continuation: what is reused, where the step is cut, and that neither changes the answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import silicone_beam
from helpers.verification import job
from petsc4py import PETSc

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.model.outcome import Outcome
from hpcinv.output.result import Result
from hpcinv.solver.newton import NewtonIteration, NewtonMonitor
from hpcinv.solver.predictor import Increment


def beam(comm: MPI.Intracomm, *, direction: str = "forward", load: float = 1.0, **solver: Any) -> Result:
    return hpcinv.run(
        job(
            analysis=direction,
            **silicone_beam.beam(load=load),
            solver=solver,
        ),
        comm,
    )


def times_logged(event: str) -> int:
    return int(PETSc.Log.Event(event).getPerfInfo()["count"])


@pytest.mark.release
@pytest.mark.parametrize("solver", [{}, {"strategy": "fixed", "steps": 4}], ids=["default", "four steps"])
def test_one_symbolic_analysis_serves_the_run(solver: dict[str, Any], comm: MPI.Intracomm) -> None:
    PETSc.Log.begin()
    symbolic, numeric = times_logged("MatLUFactorSym"), times_logged("MatLUFactorNum")
    result = beam(comm, direction="inverse", **solver)
    assert times_logged("MatLUFactorSym") - symbolic == 1
    assert times_logged("MatLUFactorNum") - numeric == result.solutions[0].factorizations


@pytest.mark.everyday("forward")
@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_reuse_and_steps_do_not_change_the_answer(direction: str, comm: MPI.Intracomm) -> None:
    default = beam(comm, direction=direction)
    careful = beam(comm, direction=direction, strategy="fixed", steps=4, reuse_tangent=False)
    assert default.solutions[0].factorizations * 2 < careful.solutions[0].factorizations
    assert np.abs(default.shape - careful.shape).max() < 1e-10 * silicone_beam.LENGTH


@pytest.mark.release
def test_step_that_would_turn_too_far_is_shortened_beforehand(comm: MPI.Intracomm) -> None:
    result = beam(comm, load=2.0)
    solves = result.solutions[0].solves
    assert solves[0].load < 1.0
    assert all(s.outcome.accepted for s in solves)
    small_steps = beam(comm, load=2.0, initial_step=0.1)
    assert np.abs(result.shape - small_steps.shape).max() < 1e-10 * silicone_beam.LENGTH


@pytest.mark.release
def test_step_is_cut_where_newton_fails_and_the_load_is_still_reached(comm: MPI.Intracomm) -> None:
    """A block whose top is moved sideways by twice its height."""
    sheared, small_steps = (
        hpcinv.run(
            job(
                analysis="forward",
                mesh={"file": "../meshes/box.py", "parameters": {"nx": 3, "ny": 3, "nz": 3}},
                material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
                supports=[
                    {"region": "z0", "fix": ["x", "y", "z"]},
                    {"region": "z1", "displacement": ["2 m", 0, 0]},
                ],
                solver=solver,
            ),
            comm,
        )
        for solver in ({"continuation": "steps"}, {"initial_step": 0.1})
    )
    outcomes = [s.outcome for s in sheared.solutions[0].solves]
    assert not outcomes[0].accepted
    assert outcomes[-1].accepted
    assert np.abs(sheared.shape - small_steps.shape).max() < 1e-10


@pytest.mark.everyday("1.0-8")
@pytest.mark.parametrize(("load", "most"), [(1.0, 8), (2.0, 14), (4.0, 18), (8.0, 20)])
def test_forward_beam_takes_few_factorizations(load: float, most: int, comm: MPI.Intracomm) -> None:
    assert beam(comm, load=load).solutions[0].factorizations <= most


@pytest.mark.release
def test_slender_beam_of_stiff_volume_needs_no_rescue(comm: MPI.Intracomm) -> None:
    """In the displacement form, with a bulk modulus 1e5 times the shear modulus, and 21 times as long as thick."""
    result = hpcinv.run(
        job(
            analysis="forward",
            **silicone_beam.beam() | {"material": silicone_beam.MATERIAL | {"d1": 2.5e10}},
            discretisation={"formulation": "displacement"},
        ),
        comm,
    )
    assert {s.strategy for s in result.solutions[0].solves} <= {"load steps", "power series"}
    assert result.solutions[0].factorizations <= 25


def test_a_correction_that_would_invert_an_element_is_backed_off_from(comm: MPI.Intracomm) -> None:
    """Squeezed to a third in one step, the block's first correction turns elements inside out."""
    squeezed = hpcinv.run(
        job(
            analysis="forward",
            mesh={"file": "../meshes/box.py", "parameters": {"nx": 2, "ny": 2, "nz": 2}},
            material={"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
            supports=[
                {"region": "z0", "fix": ["x", "y", "z"]},
                {"region": "z1", "displacement": [0, 0, "-0.65 m"]},
            ],
        ),
        comm,
    )
    assert squeezed.solutions[0].solves[-1].outcome.accepted
    assert squeezed.solutions[0].J_range[0] > 0


def test_a_load_that_cannot_be_reached_ends_with_a_diagnosis(comm: MPI.Intracomm) -> None:
    with pytest.raises(SolveError, match=r"stopped at load factor 0 of 1: \w.*\n  \w"):
        beam(comm, load=50.0, minimum_step=0.5, rescue=[], continuation="steps")


def test_petsc_options_reach_the_solver_and_unused_ones_are_named(comm: MPI.Intracomm) -> None:
    options = {"snes_linesearch_type": "l2", "mat_mumps_icntl_14": 80, "snes_linesearch_typ": "l2"}
    result = beam(comm, direction="inverse", petsc=options)
    assert result.statistics["unused_petsc_options"] == ["snes_linesearch_typ"]


def monitored(*corrections: float, tolerance: float = 1e-10) -> tuple[NewtonMonitor, Outcome | None]:
    monitor = NewtonMonitor(tolerance, limit=30, reuse=0.3)
    outcome = None
    for correction in corrections:
        outcome = monitor.judge(NewtonIteration(correction, 1.0, 1.0, monitor.needs_new_tangent))
    return monitor, outcome


def test_converged_means_that_the_error_left_is_small_not_the_last_correction() -> None:
    assert monitored(1.0, 1e-2, 1e-7)[1] is Outcome.CONVERGED
    assert monitored(1e-7, 5e-8, 2.5e-8)[1] is None  # contraction 1/2: as far to go as the last correction
    assert monitored(1.0)[1] is None


def test_tolerance_may_depend_on_the_change() -> None:
    monitor = NewtonMonitor(lambda change: 0.05 * change, limit=30, reuse=0.6)
    corrections = [1e-5, 5e-6, 2.5e-6, 1.25e-6, 6.25e-7]
    outcomes = [monitor.judge(NewtonIteration(c, 1.0, 1.0, new_tangent=c == 1e-5)) for c in corrections]
    # With contraction 0.5 the error is the last correction: 7 % of the change after the fourth, 3 % after the fifth.
    assert outcomes == [None, None, None, None, Outcome.CONVERGED]


def test_linear_residual_counts_in_the_newton_criterion() -> None:
    monitor = NewtonMonitor(1e-10, limit=30, reuse=0.3, inexact=0.03)
    outcomes = [monitor.judge(NewtonIteration(c, 1.0, 1.0, True)) for c in (1.0, 1e-2, 1e-7, 2e-9)]
    assert outcomes == [None, None, None, Outcome.CONVERGED]  # 3 % of 1e-7 would be too much


def test_rounding_errors_end_the_iteration_and_growth_gives_it_up() -> None:
    assert monitored(1e-3, 1e-9, 9e-10, tolerance=1e-14)[1] is None  # the tangent was old
    assert monitored(1e-9, 9e-10, 8.9e-10, tolerance=1e-14)[1] is Outcome.ROUND_OFF
    assert monitored(1.0, 2.0, 1.5, 3.0, 2.0, 5.0)[1] is Outcome.DIVERGED
    assert monitored(1.0, float("nan"))[1] is Outcome.NOT_FINITE


def test_tangent_is_kept_only_near_the_solution_and_while_it_contracts() -> None:
    assert monitored(1.0, 0.1)[0].needs_new_tangent  # still far
    assert not monitored(1.0, 0.01)[0].needs_new_tangent
    assert monitored(0.01, 0.008)[0].needs_new_tangent  # hardly contracts


def test_correction_of_a_kept_tangent_is_taken_only_if_it_contracts() -> None:
    foretold = NewtonMonitor(1e-10, limit=30, reuse=0.3, predicted=1.0)
    assert not foretold.needs_new_tangent
    assert foretold.accepts(0.01, 1.0)
    assert not foretold.accepts(0.1, 1.0)  # contracts, far from the solution
    assert not NewtonMonitor(1e-10, limit=30, reuse=0.3, predicted=0.01).accepts(0.005, 1.0)
    assert foretold.judge(NewtonIteration(1e-12, 1.0, 1.0, False)) is None  # one correction shows no contraction
    assert monitored(1.0, 0.01)[0].accepts(0.009, 1.0)
    assert not monitored(1.0, 0.01)[0].accepts(0.011, 1.0)
    assert NewtonMonitor(1e-10, limit=30, reuse=0.0, predicted=1.0).needs_new_tangent


def test_solve_near_the_last_one_begins_with_its_tangent() -> None:
    near = NewtonMonitor(1e-10, limit=30, reuse=0.3, begins_near=True, keeps=True)
    assert not near.needs_new_tangent
    assert near.accepts(4e-3, 1.0)
    assert not near.accepts(6e-3, 1.0)  # far
    assert near.judge(NewtonIteration(4e-3, 1.0, 1.0, False)) is None
    assert not near.needs_new_tangent  # contraction is not known yet
    assert near.judge(NewtonIteration(2e-3, 1.0, 1.0, False)) is None
    assert near.needs_new_tangent  # hardly contracts
    assert NewtonMonitor(1e-10, limit=30, reuse=0.0, keeps=True).needs_new_tangent


def test_solve_is_given_up_where_a_correction_would_wind_the_body_up() -> None:
    first, wild = NewtonMonitor(1e-10, limit=30, reuse=0.3), Increment(rotation=20.0, strain=0.1)
    assert not first.is_too_large(wild)  # linear, as nothing is known yet
    assert monitored(1.0)[0].is_too_large(wild)
    assert monitored(1.0)[0].is_too_large(Increment(rotation=0.1, strain=20.0))
    assert monitored(1.0)[0].is_too_large(Increment(rotation=float("nan"), strain=0.0))
    assert not monitored(1.0)[0].is_too_large(Increment(rotation=3.0, strain=3.0))
