"""What one rank holds of a mesh once it is distributed: cells, nodes, and memory, of the fullest rank.

Command: mpirun -n RANKS python benchmarks/mesh_memory.py body.bp
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import peak, resident
from hpcinv.job.job import MeshSpec
from hpcinv.mesh import build_body


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh", type=Path)
    spec = MeshSpec.model_validate({"file": str(parser.parse_args().mesh)})
    comm = MPI.COMM_WORLD
    comm.Barrier()
    memory_before, highest, seconds = resident(), peak(), time.process_time()
    body = build_body(spec, {}, comm)
    figures = {
        "cells": body.mesh.topology.index_map(3).size_local,
        "nodes": len(body.mesh.geometry.x),
        "MB kept": (resident() - memory_before) / 1e6,
        "MB at most": (peak() - highest) / 1e6,
        "s of CPU": time.process_time() - seconds,
    }
    most = {name: comm.allreduce(value, op=MPI.MAX) for name, value in figures.items()}
    if comm.rank == 0:
        method = body.partition.method
        print(f"{comm.size} ranks, {method}: " + ", ".join(f"{value:.4g} {name}" for name, value in most.items()))


if __name__ == "__main__":
    main()
