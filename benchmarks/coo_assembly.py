"""PETSc's COO assembly of the tangent against the filling of its arrays in place: processor time, memory and lines.

Both take the same element matrices. MatSetPreallocationCOO has the row and column of each entry of each of them, and
MatSetValuesCOO all of their values at once; entries of prescribed unknowns have negative rows, which PETSc leaves out.

Command: mpirun -n 1 python benchmarks/coo_assembly.py [--cases beam beam-cubic sphere-hexahedra] [--block 100000]
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from assembly import CASES, fastest, model_of, say
from bodies import block

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
from petsc4py import PETSc

from hpcinv.model.assembly.csr_tangent import FilledTangent


class COOTangent:
    """The tangent that PETSc assembles from coordinates."""

    def __init__(self, tangent: FilledTangent, unknowns: Any, conditions: Any) -> None:
        self._volume = tangent._volume
        dofmap = unknowns.space.dofmap
        nodes, bs = dofmap.index_map, dofmap.index_map_bs
        count = bs * (nodes.size_local + nodes.num_ghosts)
        names = nodes.local_to_global(np.arange(count // bs, dtype=np.int32))
        names = (bs * names[:, None] + np.arange(bs)).ravel().astype(PETSc.IntType)
        prescribed = np.zeros(count, dtype=bool)
        for condition in conditions:
            prescribed[condition.dof_indices()[0]] = True
        kept = np.where(prescribed, -1, names).astype(PETSc.IntType)
        owned = names[: bs * nodes.size_local][prescribed[: bs * nodes.size_local]]
        dofs = (bs * dofmap.list[:, :, None] + np.arange(bs)).reshape(len(dofmap.list), -1)
        places = [self._places(dofs[part.cells], block) for part in self._volume for block in part.blocks]
        rows = np.concatenate([kept[r].ravel() for r, _ in places] + [owned])
        columns = np.concatenate([kept[c].ravel() for _, c in places] + [owned])
        self.values = np.zeros(len(rows))
        self.values[len(rows) - len(owned) :] = 1.0
        size = (bs * nodes.size_local, bs * nodes.size_global)
        self.matrix = PETSc.Mat().create(nodes.comm)
        self.matrix.setSizes((size, size), bsize=bs)
        self.matrix.setType("aij")
        matrix: Any = self.matrix  # whose stubs ask for lists, which take ten times the memory
        matrix.setPreallocationCOO(rows, columns)

    def _places(self, dofs: Any, block: Any) -> tuple[Any, Any]:
        rows, columns = (dofs[:, side.leading()] for side in (block.rows, block.columns))
        c, d = np.arange(block.rows.components), np.arange(block.columns.components)
        shape = len(dofs), *block.shape
        return (
            np.broadcast_to(rows[:, None, None, :, None] + c[:, None, None, None], shape),
            np.broadcast_to(columns[:, None, None, None, :] + d[:, None, None], shape),
        )

    def assemble(self) -> None:
        offset = 0
        for part in self._volume:
            begins = np.cumsum([offset, *(len(part.cells) * int(np.prod(block.shape)) for block in part.blocks)])
            for chunk, blocks in part:
                for begin, entries in zip(begins, blocks, strict=False):
                    first = begin + chunk.start * entries[0].size
                    self.values[first : first + entries.size] = entries.ravel()
            offset = begins[-1]
        matrix: Any = self.matrix
        matrix.setValuesCOO(self.values, PETSc.InsertMode.INSERT_VALUES)


def resident() -> float:
    """MB that this process has, without what it could give back."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def grown(make: Callable[[], Any]) -> tuple[Any, float, float]:
    """What is made, the MB that it keeps, and the processor seconds that it took."""
    memory_before, begun = resident(), time.process_time()
    made = make()
    seconds = time.process_time() - begun
    return made, resident() - memory_before, seconds


def compare(name: str, data: dict[str, Any], repeat: int) -> None:
    model = model_of(data)
    weak_form, conditions = model.weak_form(data["analysis"]), model.supports.conditions
    weak_form.parameters.set_load(1.0)
    tangent = FilledTangent(weak_form)
    entries = sum(len(part.cells) * int(np.prod(block.shape)) for part in tangent._volume for block in part.blocks)
    for part in tangent._volume:  # so that its buffers are there
        for _ in part:
            pass
    theirs, their_memory, first_theirs = grown(lambda: COOTangent(tangent, weak_form.unknowns, conditions))
    (ours, assemble), our_memory, first_ours = grown(lambda: tangent.create_matrix(conditions))
    times = fastest({"filled": assemble, "COO": theirs.assemble}, repeat)
    norm = ours.norm(PETSc.NormType.INFINITY)
    theirs.matrix.axpy(-1.0, ours, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    gap = theirs.matrix.norm(PETSc.NormType.INFINITY) / norm
    cells = (times["filled"], times["COO"], times["COO"] / times["filled"])
    say(
        f"{name:20}{model.unknowns.size:9}{entries / 1e6:10.1f}{cells[0]:10.0f}{cells[1]:8.0f}{cells[2]:7.2f}"
        f"{first_ours:10.2f}{first_theirs:8.2f}{our_memory:10.0f}{their_memory:8.0f}{gap:8.0e}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--cases", nargs="*", choices=CASES, default=["beam", "beam-cubic", "sphere-hexahedra"])
    parser.add_argument("--block", type=int, default=100_000, help="unknowns of a block, about; 0 for none (100000)")
    options = parser.parse_args()
    say(
        f"{'':20}{'unknowns':>9}{'1e6 items':>10}{'filled ms':>10}{'COO':>8}{'ratio':>7}"
        f"{'set-up s':>10}{'COO':>8}{'MB':>10}{'COO':>8}{'gap':>8}"
    )
    for name in options.cases:
        compare(name, CASES[name], options.repeat)
    if options.block:
        compare("block", {**block(options.block), "analysis": "inverse"}, options.repeat)
