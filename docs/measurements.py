"""What benchmarks print, kept with command, machine and date for the pages that include it.

``python3 -m uv run python docs/measurements.py NAME…`` runs the benchmarks of these names, on an otherwise idle
machine, and keeps what they print in ``docs/printed``, from where the pages include it.
"""

from __future__ import annotations

import datetime
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PRINTED = Path(__file__).parent / "printed"
COMMANDS = {
    "strategies": "python benchmarks/strategies.py",
    "continuation": "mpirun -n 1 python benchmarks/continuation.py",
    "contact": "python benchmarks/contact.py",
    "interfaces": "python benchmarks/interfaces.py --across 12",
    "assembly": "python benchmarks/assembly.py --repeat 3",
    "stability-modes": "python benchmarks/stability.py modes",
    "stability-counts": "python benchmarks/stability.py counts",
    "stability-price": "python benchmarks/stability.py price",
    "certificate": "python benchmarks/certificate.py --repeat 1 --ranks 1 2",
    "derivatives": "python benchmarks/derivatives.py",
    "ranks": "python benchmarks/beam_and_block.py ranks",
    "linear": "python benchmarks/beam_and_block.py linear --sizes 16000 25000 35000 50000 100000 180000 --repeat 1",
    "phases": "python benchmarks/beam_and_block.py phases",
    "factorizations": "python benchmarks/factorizations.py --repeat 1",
    "linear-solvers": "mpirun -n 1 python benchmarks/linear_solvers.py",
    "krylov-sizes": "mpirun -n 1 python benchmarks/krylov_counts.py --sizes 20000 60000",
    "krylov-ranks": "python benchmarks/krylov_counts.py --ranks 1 2 4 8 --sizes 8000",
    "solver-choice": "mpirun -n 1 python benchmarks/solver_choice.py",
    "memory-parts": "mpirun -n 1 python benchmarks/memory_parts.py --size 60000",
    "cold-kernels": "python benchmarks/cold_kernels.py",
    "points": "python benchmarks/points.py",
    "cost-model": "mpirun -n 1 python benchmarks/cost_model.py",
    "scaling": "python benchmarks/scaling.py --per-rank 4000",
    "hard-cases": "mpirun -n 1 python benchmarks/hard_cases.py",
    "sweep-throughput": "python benchmarks/sweep_throughput.py",
    "sweep-shares": "python benchmarks/sweep_shares.py --cases 32",
    "stability-without-factors": "mpirun -n 1 python benchmarks/stability.py without-factors",
    "image-meshes": "python benchmarks/image_meshes.py",
    "newton": "mpirun -n 1 python benchmarks/newton.py",
    "two-level": "python benchmarks/two_level.py",
    "effectivity-linear": "python benchmarks/effectivity.py --divisions 4 8 --displacement 1",
    "effectivity": "python benchmarks/effectivity.py --divisions 2 4 --displacement 2",
    "effectivity-singular": "python benchmarks/effectivity.py --bodies corner cantilever slot --divisions 1"
    " --displacement 2 3",
    "promises": "python benchmarks/promises.py --levels 3 1 0.3",
    "effectivity-layers": "python benchmarks/effectivity.py --divisions 2 4 --displacement 2"
    ' --bodies "layered sphere" "grown layers"',
    "cavities": "mpirun -n 1 python benchmarks/cavities.py",
    "contact-intervals": "python benchmarks/contact_intervals.py --cells 3",
    "contact-intervals-drawn": "python benchmarks/contact_intervals.py --cells 0 --drawn 30",
    "creep": "python benchmarks/creep.py",
    "robustness": "mpirun -n 1 python benchmarks/robustness.py",
    "effectivity-cubic": "python benchmarks/effectivity.py --divisions 2 --displacement 3",
}


def heading(command: str, note: str) -> str:
    """Return the first lines of what a command printed: the command, the date, the machine, and a note."""
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text()) if sys.platform == "linux" else None
    machine = f"{model[1] if model else 'processor'}, {len(os.sched_getaffinity(0))} cores"
    return f"$ python3 -m uv run {command}\n{datetime.datetime.now(datetime.UTC).date()}, {machine}: {note}\n\n"


def main() -> None:
    for name in sys.argv[1:] or COMMANDS:
        command, note = COMMANDS[name], f"load average {os.getloadavg()[0]:.1f} before it began"
        words = [sys.executable if word == "python" else word for word in shlex.split(command)]
        # imports as a user has them: from the second run on Python reads what it has compiled in the first
        environment = os.environ | {"PETSC_OPTIONS": "-options_left 0", "PYTHONDONTWRITEBYTECODE": ""}
        for variable in ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"):  # and the kernels that OpenBLAS takes by itself
            environment.pop(variable, None)
        done = subprocess.run(words, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)
        if done.returncode:
            sys.exit(f"{command} fails")
        PRINTED.mkdir(parents=True, exist_ok=True)
        (PRINTED / f"{name}.txt").write_text(heading(command, note) + done.stdout.strip("\n") + "\n")


if __name__ == "__main__":
    main()
