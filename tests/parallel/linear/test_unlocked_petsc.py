"""Long calls of PETSc let other threads of Python run, as the one that waits for signals."""

from __future__ import annotations

import gc
import threading
import time

import numpy as np
import pytest
import scipy.sparse as sparse
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_calls import set_up, solve


def laplacian(n: int) -> PETSc.Mat:
    line, one = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n)), sparse.eye(n)
    terms = ((line, one, one), (one, line, one), (one, one, line))
    matrix = sum(sparse.kron(sparse.kron(a, b), c) for a, b, c in terms).tocsr()
    indices = matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType)
    return PETSc.Mat().createAIJ(matrix.shape, csr=(*indices, matrix.data), comm=PETSc.COMM_SELF)


def test_threads_run_during_a_factorization_and_its_solution_is_right() -> None:
    matrix, times = laplacian(26), list[float]()
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setType("preonly")
    ksp.setOperators(matrix)
    ksp.pc.setType("lu")
    ksp.pc.setFactorSolverType("mumps")
    ended = threading.Event()

    def tick() -> None:
        while not ended.wait(0.005):
            times.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    begun = time.monotonic()
    set_up(ksp)
    end = time.monotonic()
    ended.set()
    thread.join()
    assert sum(begun + 0.01 < at < end - 0.01 for at in times) >= 3
    x, b, product = (matrix.createVecLeft() for _ in range(3))
    b.set(1.0)
    solve(ksp, b, x)
    matrix.mult(x, product)
    assert np.abs(product.array - 1.0).max() < 1e-9


def test_errors_are_those_of_petsc4py() -> None:
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    with pytest.raises(PETSc.Error):
        set_up(ksp)


def test_no_other_thread_collects_garbage_during_a_factorization() -> None:
    """It would destroy objects of PETSc and communicators of MPI, next to a factorization that uses both."""
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setType("preonly")
    ksp.setOperators(laplacian(26))
    ksp.pc.setType("lu")
    ksp.pc.setFactorSolverType("mumps")
    ended, collections, rounds = threading.Event(), list[float](), list[int]()

    def note(phase: str, _: object) -> None:
        if phase == "start" and threading.current_thread() is thread:
            collections.append(time.monotonic())

    def fill() -> None:
        while not ended.wait(0.002):
            rounds.append(len([[] for _ in range(2000)]))  # more than Python lets pass without a collection

    thread = threading.Thread(target=fill)
    gc.callbacks.append(note)
    try:
        thread.start()
        begun = time.monotonic()
        set_up(ksp)
        end = time.monotonic()
    finally:
        ended.set()
        thread.join()
        gc.callbacks.remove(note)
    assert len(rounds) >= 3
    # The thread may be at work before the factorization begins, and after it.
    assert [at for at in collections if (begun + end) / 2 < at < end - 0.01] == []
    assert gc.isenabled()
