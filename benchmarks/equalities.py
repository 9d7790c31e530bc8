"""Runs that theory makes equal, over scenes drawn from the registries of laws and effects.

Each scene is run as drawn, then rotated and scaled, mirrored, renumbered, with its loads in halves, with another text
of its law, and after another case with the same equations. Differences of displacement and energy are relative; one
above the bound is an error, and the scene is drawn again by its seed.

Command: python benchmarks/equalities.py --seed 1 --count 200
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / "tests")]

from helpers.equalities import TOLERANCE, compare, drawn  # noqa: E402

import hpcinv  # noqa: E402, F401  (before MPI)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the first scene")
    parser.add_argument("--count", type=int, default=20, help="of scenes, each with the next seed")
    options = parser.parse_args()
    failures = compared = 0
    for seed in range(options.seed, options.seed + options.count):
        rng = np.random.default_rng(seed)
        scene = drawn(rng)
        with tempfile.TemporaryDirectory() as directory:
            differences = list(compare(scene, rng, Path(directory)))
        bad = [f"{name} {d:.1e}" for name, d in differences if not d < TOLERANCE]
        largest = max((d for _, d in differences), default=np.nan)
        ending = "load not carried" if not differences else f"FAILS: {', '.join(bad)}" if bad else f"{largest:.1e}"
        print(f"{seed}: {scene.title}: {ending}", flush=True)
        failures += len(bad)
        compared += len(differences)
    print(f"{compared} pairs of runs, {failures} above {TOLERANCE:g}")
    return 1 if failures or not compared else 0


if __name__ == "__main__":
    sys.exit(main())
