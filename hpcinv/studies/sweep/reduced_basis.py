"""Initial guesses by a reduced basis of the solutions of a sweep, and a regression of their coefficients.

The solutions of the cases are combinations of few modes (proper orthogonal decomposition). At the numbers of a new job,
the coefficients of the modes are interpolated (`hpcinv.studies.sweep.radial_basis`). Newton's method corrects the
prediction to its own tolerance, so a poor one costs time, not accuracy.

A directory has ``start.json`` (points and coefficients of the cases) and ``modes.bp`` (ADIOS2, in the cell order of the
mesh's source, so that the number of ranks does not matter).

Source: Sirovich, "Turbulence and the dynamics of coherent structures", Q. Appl. Math. 45, 561-571, 1987,
doi:10.1090/qam/910462 (method of snapshots).
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
from dolfinx.fem import Function

from hpcinv.base.files.atomic import output_errors, replace
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import JobError
from hpcinv.job.job import UNNAMED, Job
from hpcinv.job.reuse_key import digests_of_structure, numbers_of
from hpcinv.mesh.source import Floats
from hpcinv.output.checkpoint import cells_digest, functions_digest
from hpcinv.output.function_files import read_function, write_function
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.method import Guess
from hpcinv.studies.sweep.radial_basis import RadialBasis

STRATEGY = "start of a sweep"
"""Strategy of a solve from a predicted solution, for reports."""
_FORMAT = 2
_TRUNCATION = 0.1
"""Size of modes that are left out, relative to the errors of cases predicted from all others. Smaller: more modes."""
_OUTSIDE = 0.1
"""Share of the range of a number by which a job may lie outside. Larger: more starts that fail, and cost a solve."""


@dataclass(frozen=True)
class TrainingCase:
    """Solution of one case.

    Attributes:
        numbers: of the case.
        guesses: the solution of each solve of the plan.
    """

    numbers: tuple[float, ...]
    guesses: Sequence[Guess]


@dataclass(frozen=True)
class _Field:
    """One field of one solve: modes (r, local values), and coefficients of the cases (cases, r)."""

    modes: Floats
    coefficients: Floats

    @classmethod
    def decomposed(cls, snapshots: Floats, numbers: Sequence[Sequence[float]], owned: int, comm: MPI.Intracomm) -> Self:
        """Return orthonormal modes of snapshots (cases, local values); the first ``owned`` values count; collective."""
        gram = comm.allreduce(snapshots[:, :owned] @ snapshots[:, :owned].T)
        squares, vectors = np.linalg.eigh(gram)
        kept = squares > np.finfo(float).eps * squares[-1]
        sizes, vectors = np.sqrt(squares[kept]), vectors[:, kept]
        error = np.median(np.linalg.norm(RadialBasis(numbers, vectors * sizes).errors, axis=1))
        worth = sizes > _TRUNCATION * error * np.sqrt(len(snapshots))
        sizes, vectors = sizes[worth], vectors[:, worth]
        return cls((vectors / sizes).T @ snapshots, vectors * sizes)


@dataclass(frozen=True)
class ReducedBasis:
    """Modes of the solutions of a reuse group, and the coefficients of the cases of a sweep.

    Attributes:
        structure: hashes of the sections that a job must share, without its numbers.
        numbers: of each case.
        signs: of the tangent's determinant, (cases, solves).
        fields: displacement and pressure of each solve; ``None`` without pressures.
    """

    structure: Mapping[str, str]
    numbers: Sequence[tuple[float, ...]]
    signs: Sequence[Sequence[int]]
    fields: Sequence[tuple[_Field, _Field | None]]

    @classmethod
    def from_cases(cls, job: Job, equations: Sequence[Equations], cases: Sequence[TrainingCase]) -> Self:
        """Return the basis of the solutions of cases of a job; collective."""
        structure, numbers = _structure(job, equations[0]), [case.numbers for case in cases]
        fields: list[tuple[_Field, _Field | None]] = []
        for step, step_equations in enumerate(equations):
            u, p = step_equations.unloaded().fields
            guesses = [case.guesses[step] for case in cases]
            pressures = [guess.pressure for guess in guesses if guess.pressure is not None]
            pressure = None if p is None else _decomposed(p, pressures, numbers)
            fields.append((_decomposed(u, [guess.displacement for guess in guesses], numbers), pressure))
        signs = [[guess.sign for guess in case.guesses] for case in cases]
        return cls(structure, numbers, signs, fields)

    @property
    def mode_count(self) -> int:
        """Number of modes of the displacement, of the solve with the most."""
        return max(len(u.modes) for u, _ in self.fields)

    def errors(self) -> Floats:
        """Return for each case the relative error of its displacement as predicted from all other cases."""
        errors = [
            np.linalg.norm(RadialBasis(self.numbers, u.coefficients).errors, axis=1)
            / np.linalg.norm(u.coefficients, axis=1)
            for u, _ in self.fields
        ]
        return np.asarray(np.max(errors, axis=0))

    def guesses(self, numbers: Sequence[float]) -> list[Guess]:
        """Return the predicted solution of each solve at the numbers of a job; empty outside of the swept ranges."""
        predicted: list[Guess] = []
        for step, (u, p) in enumerate(self.fields):
            regression = RadialBasis(self.numbers, u.coefficients)
            if regression.outside(numbers) > _OUTSIDE:
                return []
            pressure = None if p is None else RadialBasis(self.numbers, p.coefficients)(numbers) @ p.modes
            sign = self.signs[regression.nearest(numbers)][step]
            predicted.append(Guess(regression(numbers) @ u.modes, pressure, sign, STRATEGY))
        return predicted

    def write(self, path: Path, equations: Sequence[Equations], comm: MPI.Intracomm) -> None:
        """Write the directory, which appears whole or not at all; collective."""
        partial = path.with_name(f".{path.name}.partial")

        def begin() -> None:
            with output_errors(path, "Choose another --output."):
                shutil.rmtree(partial, ignore_errors=True)
                partial.mkdir(parents=True)

        on_root(comm, begin)
        for name, mode, values in self._modes(equations):
            mode.x.array[:] = values
            write_function(partial / "modes.bp", name, mode)
        comm.Barrier()
        data: dict[str, Any] = {
            "format": _FORMAT,
            "structure": self.structure,
            "numbers": self.numbers,
            "signs": self.signs,
            "coefficients": [[f and f.coefficients.tolist() for f in step] for step in self.fields],
        }

        def finish() -> None:
            with output_errors(path, "Choose another --output."):
                data["digest"] = functions_digest(data, partial / "modes.bp")
                replace(partial / "start.json", json.dumps(data).encode())
                shutil.rmtree(path, ignore_errors=True)
                partial.rename(path)

        on_root(comm, finish)

    def _modes(self, equations: Sequence[Equations]) -> list[tuple[str, Function, Floats]]:
        """Return the name of each mode, a function for it, and its values."""
        return [
            (f"{function.name}-{step}-{i}", function, values)
            for step, fields in enumerate(self.fields)
            for function, field in zip(equations[step].unloaded().fields, fields, strict=True)
            if function is not None and field is not None
            for i, values in enumerate(field.modes)
        ]

    @classmethod
    def read(cls, path: Path, job: Job, equations: Sequence[Equations]) -> Self:
        """Read a basis for a job; collective.

        Raises:
            JobError: on all ranks, if there is none, or it is of other equations.
        """
        comm = equations[0].body.mesh.comm
        where = f"{job.path or UNNAMED}: solver.start: {path}"
        data = on_root(comm, lambda: _content(path, where))
        own = _structure(job, equations[0])
        if differing := [name for name, value in own.items() if data["structure"].get(name) != value]:
            raise JobError(
                f"{where} is of jobs with another {', '.join(differing)}: teach it again by a sweep of this job"
            )
        fields: list[tuple[_Field, _Field | None]] = []
        for step, parts in enumerate(data["coefficients"]):
            functions = equations[step].unloaded().fields
            u, p = (
                None if f is None else _read(path, f, step, np.array(part))
                for f, part in zip(functions, parts, strict=True)
            )
            assert u is not None  # every solve has displacements
            fields.append((u, p))
        return cls(own, [tuple(numbers) for numbers in data["numbers"]], data["signs"], fields)


def predicted_guesses(job: Job, equations: Sequence[Equations], note: Callable[[str], None]) -> Sequence[Guess]:
    """Return the predicted solution of each solve of a job by its ``solver.start``; empty outside of the swept ranges.

    Collective.

    Raises:
        JobError: on all ranks, if there is none, or it is of other equations.
    """
    if job.solver.start is None:
        return ()
    path = job.resolve(job.solver.start)
    guesses = ReducedBasis.read(path, job, equations).guesses(numbers_of(job))
    if not guesses:
        note(f"{path} is not used, and the path begins unloaded: the numbers lie outside of the ranges of its sweep")
    return guesses


def _structure(job: Job, equations: Equations) -> dict[str, str]:
    """Return hashes of what a basis depends on; a generator may make other cells on another machine; collective."""
    cells = cells_digest(equations.body)
    return on_root(equations.body.mesh.comm, lambda: digests_of_structure(job) | {"cells": cells})


def _decomposed(function: Function, values: Sequence[Floats], numbers: Sequence[Sequence[float]]) -> _Field:
    dofs = function.function_space.dofmap
    owned = dofs.index_map.size_local * dofs.index_map_bs
    return _Field.decomposed(np.stack(values), numbers, owned, function.function_space.mesh.comm)


def _read(path: Path, function: Function, step: int, coefficients: Floats) -> _Field:
    modes = np.empty((coefficients.shape[1], len(function.x.array)))
    for i in range(len(modes)):
        read_function(path / "modes.bp", f"{function.name}-{step}-{i}", function)
        modes[i] = function.x.array
    return _Field(modes, coefficients)


def _content(path: Path, where: str) -> Mapping[str, Any]:
    """Return the content of ``start.json``; on rank 0."""
    try:
        data: dict[str, Any] = json.loads((path / "start.json").read_bytes())
        version, digest = data["format"], data.pop("digest")
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise JobError(f"{where} is not a start of 'hpcinv sweep teach'") from None
    if version != _FORMAT:
        raise JobError(f"{where} has format {version}, but this version of hpcinv reads {_FORMAT}: teach it again")
    if digest != functions_digest(data, path / "modes.bp"):
        raise JobError(f"{where} is damaged: teach it again by 'hpcinv sweep teach'")
    return data
