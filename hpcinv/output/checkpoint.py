"""Checkpoints: converged states of a run; it resumes from them with any number of ranks.

A checkpoint is a directory with the functions (ADIOS2, in the cell order of the mesh's source, so that neither the
partition nor the number of ranks matters) and ``state.json``: position of the run, fingerprint of the problem, and a
digest of all. It is written under another name and renamed when all ranks have finished, so that it is always whole.
"""

import errno
import hashlib
import json
import math
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
from dolfinx.fem import Function

from hpcinv.base.files.atomic import replace
from hpcinv.base.files.saved_mark import mark_saved
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import CheckpointError, OutputError
from hpcinv.job.fingerprint import check_same_problem
from hpcinv.mesh import Body
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.model.contact_reports import SlipHistory
from hpcinv.model.outcome import Outcome
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import Direction
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.method import Start
from hpcinv.solver.newton import NewtonIteration, Solve

_FORMAT = 6
_NAME = re.compile(r"\d{4,}")
_WITH_ITS_VERSION = "Resume with the version that wrote it."


@dataclass(frozen=True)
class Position:
    """Progress of a run: the direction, the load factor reached in it, and the solves of each direction so far.

    Attributes:
        slips: numbers of the histories of slip, by direction and contact; ``None`` of contacts without one.
    """

    direction_index: int
    load: float
    solves: tuple[tuple[Solve, ...], ...]
    slips: tuple[tuple[Mapping[str, Any] | None, ...], ...] = ()

    def as_json(self) -> dict[str, Any]:
        solutions = [[asdict(s) | {"outcome": s.outcome.name} for s in solves] for solves in self.solves]
        slips = [list(histories) for histories in self.slips]
        return {"direction": self.direction_index, "load": self.load, "solves": solutions, "slips": slips}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        def solve(s: Mapping[str, Any]) -> Solve:
            iterations = tuple(NewtonIteration(**i) for i in s["iterations"])
            read = {"outcome": Outcome[s["outcome"]], "iterations": iterations}
            return Solve(**(dict(s) | read | {name: tuple(s[name]) for name in ("signs", "mode") if name in s}))

        solves = tuple(tuple(map(solve, solution)) for solution in data["solves"])
        return cls(data["direction"], data["load"], solves, tuple(map(tuple, data["slips"])))


@dataclass(frozen=True)
class Restart:
    """A checkpoint to resume from; ``complaints`` lists later ones that are damaged."""

    path: Path
    position: Position
    functions: tuple[str, ...]
    complaints: tuple[str, ...]

    def start(self, number: int, equations: Equations, direction: Direction | None = None) -> Start | None:
        """Return the start in a direction (from 0), ``None`` if that had not begun; collective.

        Args:
            direction: of a solve that goes on, with the slip of its contacts; fields are enough without it.
        """
        if self.position.direction_index < number:
            return None
        u, p = equations.unloaded().fields
        for name, function in named(number, u, p).items():
            self.read(name, function)
        load = self.position.load if self.position.direction_index == number else 1.0
        slips = () if direction is None else tuple(self._slips(number, equations, direction))
        return Start((u, p), load, self.position.solves[number], slips=slips)

    def _slips(self, number: int, equations: Equations, direction: Direction) -> Iterator[SlipHistory | None]:
        for contact, numbers in enumerate(self.position.slips[number] if self.position.slips else ()):
            history = None
            if numbers is not None:
                contacts = equations.weak_form(direction).contacts
                history = contacts.new_history(contact, equations.scales).with_numbers(numbers)
                for name, function in named_slips(number, [None] * contact + [history]).items():
                    self.read(name, function)
            yield history

    def read(self, name: str, function: Function) -> None:
        """Read the function that was saved under ``name``; collective."""
        on_demand("function of a file")(self.path / "functions.bp", name, function)


class Checkpoints:
    """Checkpoints of one run in ``directory``, oldest first.

    Args:
        fingerprint: of the job; only checkpoints of the same problem are read.
    """

    def __init__(self, directory: Path, comm: MPI.Intracomm, fingerprint: Mapping[str, Any], keep: int) -> None:
        self.directory, self.comm, self.fingerprint, self.keep = directory, comm, fingerprint, keep
        self._damaged: list[Path] = []

    def write(self, position: Position, functions: Mapping[str, Function]) -> None:
        """Save a converged state; collective.

        Raises:
            OutputError: on every rank if there is no space for it, else on each rank that cannot write it; earlier
                checkpoints are kept.
            SystemPartMissing: on all ranks, if this installation cannot write checkpoints.
        """
        write_function = on_demand("file of functions")
        number = on_root(self.comm, lambda: max((int(p.name) for p in self._all()), default=0) + 1)
        partial = self.directory / f".partial-{number:04}"
        size = sum(map(_size, functions.values()))
        on_root(self.comm, lambda: _create(partial, size))
        try:
            for name, function in functions.items():
                write_function(partial / "functions.bp", name, function)
        except RuntimeError as exc:  # the only exception of ADIOS2
            raise _unwritable(partial, _reason(exc, partial, size)) from exc
        self.comm.Barrier()

        def finish() -> None:
            state = {
                "format": _FORMAT,
                "position": position.as_json(),
                "functions": sorted(functions),
                "problem": self.fingerprint,
            }
            try:
                state["digest"] = functions_digest(state, partial / "functions.bp")
                replace(partial / "state.json", json.dumps(state, indent=1).encode())
                partial.replace(self.directory / f"{number:04}")
                mark_saved()
            except OSError as exc:
                raise _unwritable(partial, exc.strerror or str(exc)) from exc
            # A damaged checkpoint must not count, so that a whole one is kept.
            for old in [*self._damaged, *[p for p in self._all() if p not in self._damaged][: -self.keep]]:
                shutil.rmtree(old, ignore_errors=True)

        on_root(self.comm, finish)

    def latest(self) -> Restart | None:
        """Return the last checkpoint that is not damaged, ``None`` if there is none yet; collective.

        Raises:
            CheckpointError: on every rank, if all are damaged or belong to another problem.
        """

        def search() -> Restart | None:
            complaints: list[str] = []
            for path in reversed(self._all()):
                try:
                    return self._open(path, tuple(complaints))
                except _Damaged as exc:
                    self._damaged.append(path)
                    complaints.append(f"{path}: {exc}")
            if complaints:
                raise CheckpointError(
                    "\n".join(["no checkpoint can be used:", *complaints]),
                    "Restore one from a copy, or start the job again with 'run'.",
                )
            return None

        restart = on_root(self.comm, search)
        on_root(self.comm, lambda: _remove_partial(self.directory))  # last: a refused resume changes nothing
        return restart

    def _all(self) -> list[Path]:
        if not self.directory.is_dir():
            return []
        return sorted((p for p in self.directory.iterdir() if _NAME.fullmatch(p.name)), key=lambda p: int(p.name))

    def _open(self, path: Path, complaints: tuple[str, ...]) -> Restart:
        try:
            state = json.loads((path / "state.json").read_text())
            version, digest = state["format"], state.pop("digest")
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as exc:
            raise _Damaged(f"state.json is missing or damaged ({type(exc).__name__})") from exc
        if version != _FORMAT:
            raise CheckpointError(
                f"{path}: has format {version}, but this version of hpcinv reads {_FORMAT}",
                _WITH_ITS_VERSION,
            )
        if digest != functions_digest(state, path / "functions.bp"):
            raise _Damaged("functions.bp or state.json is damaged: the digest does not match")
        try:  # after the digest: what is whole, but not known here, is not damage, after which it would be removed
            fingerprint, functions = state["problem"], tuple(state["functions"])
            position = Position.from_json(state["position"])
        except (ValueError, KeyError, TypeError, AttributeError) as exc:
            raise CheckpointError(f"{path}: was written by another version of hpcinv", _WITH_ITS_VERSION) from exc
        check_same_problem(path, fingerprint, self.fingerprint)
        return Restart(path, position, functions, complaints)


def named(number: int, u: Function, p: Function | None) -> dict[str, Function]:
    """Return the functions of one direction (from 0) by their names in a checkpoint."""
    functions = {f"displacement-{number}": u}
    return functions if p is None else functions | {f"pressure-{number}": p}


def cells_digest(body: Body) -> str:
    """Return a checksum of the cells of a body's mesh; functions are saved in their order; collective."""
    cells = body.source.cells
    return Rows.distributed(body.mesh.comm, len(cells)).checksum(cells)


def nodes_digest(body: Body) -> str:
    """Return sums of the positions of a body's nodes with irregular weights, rounded, so that other nodes differ.

    Unlike a checksum it is the same where a generator rounds differently, as on another processor; collective.
    """
    points, comm = body.source.points, body.mesh.comm
    first = comm.exscan(len(points)) or 0
    weights = np.cos(_IRREGULAR * (1 + first + np.arange(len(points)))) if len(points) else np.zeros(0)
    sums = comm.allreduce(weights @ points) / body.length_scale
    return " ".join(f"{value + 0.0:.{_DIGITS}f}" for value in sums)


_IRREGULAR = 1.6180339887
"""radians between the weights of successive nodes: any number that has no simple ratio to a turn"""
_DIGITS = 8
"""digits in lengths of the body; with more, rounding errors count as other nodes"""


def named_slips(number: int, histories: Sequence[SlipHistory | None]) -> dict[str, Function]:
    """Return the functions of the histories of slip of one direction (from 0) by their names in a checkpoint."""
    return {
        f"contact-{number}-{contact}-{name}": function
        for contact, history in enumerate(histories)
        if history is not None
        for name, function in history.functions.items()
    }


class _Damaged(Exception):
    pass


def _remove_partial(directory: Path) -> None:
    """Remove the partial checkpoints of a run that was killed while writing."""
    for partial in directory.glob(".partial-*"):
        shutil.rmtree(partial, ignore_errors=True)


def _create(partial: Path, size: int) -> None:
    """Create the directory of a checkpoint of ``size`` bytes.

    A full disk is found here, because ADIOS2 reports it in other words, and on one rank while the others wait.
    """
    _remove_partial(partial.parent)
    try:
        partial.parent.mkdir(exist_ok=True)  # the run's directory is not made again if it was removed
        partial.mkdir()
    except OSError as exc:
        raise OutputError(f"{partial}: cannot be created: {exc.strerror}", "Is the directory writable?") from exc
    if _free(partial) < size:
        _remove_partial(partial.parent)
        raise _unwritable(partial, _FULL)


_FULL = os.strerror(errno.ENOSPC)
_COLOUR = re.compile(r"\x1b\[[\d;]*m")


def _unwritable(partial: Path, reason: str) -> OutputError:
    advice = "Make room there, then resume the run, or start it again if it has no checkpoint yet."
    return OutputError(f"{partial}: cannot be written: {reason}", advice)


def _reason(error: RuntimeError, partial: Path, size: int) -> str:
    """Reason why ADIOS2 cannot write a checkpoint of about ``size`` bytes."""
    return _FULL if _free(partial) < size else _COLOUR.sub("", str(error)).strip().splitlines()[-1]


def _free(directory: Path) -> float:
    """Bytes left on the disk; infinite if that is not known."""
    try:
        disk = os.statvfs(directory)
    except OSError:
        return math.inf
    return (disk.f_bavail if os.geteuid() else disk.f_bfree) * disk.f_frsize if disk.f_blocks else math.inf


def _size(function: Function) -> int:
    """Bytes that a function takes in a checkpoint, or up to a tenth more: values in each cell, and their numbers."""
    space = function.function_space
    topology, dofs = space.mesh.topology, space.dofmap
    cell_bytes = dofs.dof_layout.num_dofs * (8 * dofs.index_map_bs + 8) + 16
    return int(topology.index_map(topology.dim).size_global * cell_bytes) + 2**13


def functions_digest(state: Mapping[str, Any], functions: Path) -> str:
    """Return a hash of JSON data and of a directory of functions."""
    digest = hashlib.sha256(json.dumps(state, sort_keys=True).encode())
    for file in sorted(p for p in functions.rglob("*") if p.is_file()):
        digest.update(str(file.relative_to(functions)).encode())
        with file.open("rb") as content:
            digest.update(hashlib.file_digest(content, "sha256").digest())
    return digest.hexdigest()
