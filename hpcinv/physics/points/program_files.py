"""Programs of a form or expression, kept as numbers in a file of the cache."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha1
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.parallel import code_cache
from hpcinv.base.parallel.ranks import wait_for_all
from hpcinv.base.parallel.runtime import MPI
from hpcinv.physics.points.program import Program
from hpcinv.physics.points.scalar_graph import NotAnalytic

_SOURCE = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
"""programs depend on the modules that make them"""

_LARGEST = 250_000
"""bytes of a file that is read once in a process; larger ones would take the memory that meshes need"""


@dataclass(frozen=True)
class Integral:
    """Programs of one domain of integration, or of an expression.

    Attributes:
        kind: of the integral, as UFL names it.
        number: of the region; -1 for all cells or facets.
        cell: number that Basix has for the kind of its cells or facets.
        enabled: whether it takes each of the functions.
        programs: one for each quadrature rule or derivative.
    """

    kind: str
    number: int
    cell: int
    enabled: tuple[bool, ...]
    programs: tuple[Program, ...]


@dataclass(frozen=True)
class Programs:
    """Programs of a form or of an expression.

    Attributes:
        functions: those that they take, by their numbers in it.
        integrals: their domains; one of an expression.
        notes: what else was found when they were made; of the types that JSON has.
    """

    functions: list[int]
    integrals: list[Integral]
    notes: Any = None

    @classmethod
    def of_expression(cls, program: Program, functions: list[int], notes: Any = None) -> Programs:
        """Return the program of an expression with the functions that it takes."""
        return cls(functions, [Integral("expression", 0, 0, (True,) * len(functions), (program,))], notes)

    def to_bytes(self) -> bytes:
        """Return them as the content of a file."""
        head = [(i.kind, i.number, i.cell, list(map(int, i.enabled)), len(i.programs)) for i in self.integrals]
        arrays = {"head": np.array(json.dumps([self.functions, head, self.notes]))}
        for n, integral in enumerate(self.integrals):
            for k, program in enumerate(integral.programs):
                arrays |= program.to_arrays(f"{n}_{k}_")
        with io.BytesIO() as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes the first for a flag
            return file.getvalue()

    @classmethod
    def from_bytes(cls, content: bytes) -> Programs:
        """Return the programs of a file; raise ``ValueError`` or ``KeyError`` for one that is damaged."""
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            functions, head, notes = json.loads(str(arrays["head"]))
            integrals = []
            for n, (kind, number, cell, enabled, count) in enumerate(head):
                made = tuple(Program.from_arrays(arrays, f"{n}_{k}_") for k in range(count))
                integrals.append(Integral(kind, number, cell, tuple(map(bool, enabled)), made))
        return cls(functions, integrals, notes)


def kept_programs(comm: MPI.Intracomm, description: bytes, make: Callable[[], Programs]) -> Programs:
    """Return programs, from the cache or made on rank 0; collective.

    Args:
        description: all on which they depend except the modules that make them.

    Raises:
        NotAnalytic: on all ranks, if `make` raises it.
    """
    return kept(comm, f"points_{digest(description)}.npz", lambda: make().to_bytes(), _read)


def kept[T](comm: MPI.Intracomm, name: str, make: Callable[[], bytes], load: Callable[[bytes], T]) -> T:
    """Return what ``load`` makes of a file of the cache, or of what ``make`` returns on rank 0; collective.

    Args:
        name: of the file, with a digest of all on which its content depends.

    Raises:
        NotAnalytic: on all ranks, if `make` raises it.
    """
    if (content := comm.bcast(code_cache.read(name) if comm.rank == 0 else None)) is not None:
        with suppress(ValueError, KeyError, TypeError):  # it is another's, or refers to what it does not have
            return load(content)
    content, fault = None, ""
    if comm.rank == 0:
        code_cache.note_missing(name)
        try:
            content = make()
        except NotAnalytic as reason:
            fault = str(reason)
        except Exception as error:  # UFL's errors have many types; FFCx, which is tried next, reports what is wrong
            fault = f"{type(error).__name__}: {error}"
        else:
            code_cache.keep(name, content)
    wait_for_all(comm)
    content, fault = comm.bcast((content, fault))
    if content is None:
        raise NotAnalytic(fault)
    return load(content)


def _read(content: bytes) -> Programs:
    return _read_once(content) if len(content) <= _LARGEST else Programs.from_bytes(content)


@lru_cache(maxsize=128)  # the cases of a sweep need the same ones
def _read_once(content: bytes) -> Programs:
    return Programs.from_bytes(content)


def digest(description: bytes) -> str:
    """Return a digest of all on which what is made depends: a description, and the modules of this package."""
    return sha1(_SOURCE + description).hexdigest()
