"""Whether a sweep's process grows: resident memory and free communicators over many cases in one process.

Blocks of random stiffness are solved as a sweep does it, some with another law or mesh than the one before, so that
models and meshes come and go. The curve goes to docs/pictures/sweep-memory.{png,svg}.

Command: python benchmarks/sweep_memory.py [--cases 500]
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
from pathlib import Path
from typing import Any

import matplotlib as mpl
import yaml

from hpcinv.batch.worker import work
from hpcinv.parallel.runtime import MPI
from hpcinv.sweep.sweep_batch import sweep_batch
from hpcinv.sweep.sweep_plan import load_sweep

mpl.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[1]
EVERY = 10


def resident() -> float:
    """Resident memory of this process in MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def free_communicators() -> int:
    """How many more communicators MPI can make."""
    made = []
    with contextlib.suppress(MPI.Exception):
        while True:
            made.append(MPI.COMM_SELF.Dup())
    for comm in made:
        comm.Free()
    return len(made)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=500)
    options = parser.parse_args()
    laws: dict[str, dict[str, Any]] = {
        "neo-Hooke": {"set": {"material": {"law": "neo-hookean", "lam": "40 kPa"}}},
        "Gent": {"set": {"material": {"law": "gent", "jm": 30, "kappa": "40 kPa"}}},
    }
    for branch in laws.values():
        branch["axes"] = [{"sobol": {"material.mu": ["8 kPa", "20 kPa"]}, "count": -(-options.cases // 10)}]
    meshes = [{"lx": "1 m", "nx": n, "ny": 3, "nz": 3} for n in range(2, 7)]
    job = {
        "mesh": {"file": str(ROOT / "meshes" / "box.py")},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 200}],
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    }
    seen: list[tuple[int, float, int]] = []
    done = 0

    def note(_: str) -> None:
        nonlocal done
        done += 1
        if done % EVERY == 0:
            seen.append((done, resident(), free_communicators()))

    with tempfile.TemporaryDirectory() as directory:
        base, sweep = Path(directory) / "block.yaml", Path(directory) / "sweep.yaml"
        base.write_text(yaml.safe_dump(job))
        axes = [{"grid": {"mesh.parameters": meshes}}, {"name": "law", "branches": laws}]
        sweep.write_text(yaml.safe_dump({"job": base.name, "store": "store", "axes": axes}))
        plan = load_sweep(sweep)
        work(sweep_batch(plan), MPI.COMM_WORLD, 0.0, 60.0, note, lambda: False)

    reuse_groups = len({case.reuse_group for case in plan.cases})
    print(f"{done} cases of {reuse_groups} reuse groups in one process; MB resident, communicators free")
    for number, memory, free in seen[:: max(len(seen) // 10, 1)]:
        print(f"  {number:5d}  {memory:7.1f}  {free}")
    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(6.0, 4.5), layout="constrained")
    upper.plot([n for n, _, _ in seen], [m for _, m, _ in seen])
    upper.set(ylabel="resident memory in MB", ylim=(0, None))
    lower.plot([n for n, _, _ in seen], [f for _, _, f in seen])
    lower.set(ylabel="communicators free", xlabel="cases solved in one process", ylim=(0, None))
    for form in ("png", "svg"):
        figure.savefig(ROOT / "docs" / "pictures" / f"sweep-memory.{form}")


if __name__ == "__main__":
    main()
