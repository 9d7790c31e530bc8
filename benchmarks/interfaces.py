"""Price of an interface: two blocks that are tied, slide or touch, compared with one block with as many cells.

Usage: python benchmarks/interfaces.py [--across 20]
"""

import hpcinv.base.parallel.runtime

# isort: split
import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import hpcinv

MESHES = Path(__file__).parents[1] / "meshes"
COMMON: Mapping[str, Any] = {
    "material": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.4},
    "discretisation": {"displacement": 1},
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
    "supports": [
        {"region": "z0", "fix": ["x", "y", "z"]},
        {"region": "z1", "displacement": ["0.5 mm", 0, "-2 mm"]},
    ],
    "certificate": "off",
}
KINDS: Mapping[str, dict[str, Any] | None] = {
    "one block": None,
    "tied": {"kind": "tied"},
    "sliding": {"kind": "sliding"},
    "contact": {"kind": "contact", "closure": "conforming"},
    "friction 0.3": {"kind": "contact", "friction": 0.3, "closure": "coulomb"},
}


def mesh(across: int, *, is_whole: bool) -> dict[str, Any]:
    """Return the mesh of a cube of 60 mm: one block, or an upper one with one division more than the lower one."""
    if is_whole:
        return {
            "file": str(MESHES / "box.py"),
            "parameters": dict.fromkeys(("lx", "ly", "lz"), "60 mm")
            | {"nx": across, "ny": across, "nz": across, "hexahedra": True},
        }
    sizes = {"lx": "60 mm", "ly": "60 mm", "lower_height": "30 mm", "upper_height": "30 mm"}
    counts = {"lower": across - 1, "upper": across, "layers": across // 2, "hexahedra": True}
    return {"file": str(MESHES / "two_blocks.py"), "parameters": sizes | counts}


def solved(across: int, analysis: str, kind: dict[str, Any] | None) -> tuple[int, int, float]:
    """Return unknowns, factorizations and the processor time (s) of a run."""
    given: dict[str, Any] = {**COMMON, "analysis": analysis, "mesh": mesh(across, is_whole=kind is None)}
    if kind is not None:
        interface = {"between": ["bottom", "top"], **kind}
        if analysis == "forward":
            interface.pop("closure", None)
        given["interfaces"] = [interface]
    job = hpcinv.load(given)
    begin = time.process_time()
    result = hpcinv.run(job, progress=False)
    (solution,) = result.solutions
    return result.statistics["mesh"]["unknowns"], solution.factorizations, time.process_time() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--across", type=int, default=20, help="divisions of the upper block")
    across = parser.parse_args().across
    print(f"{'':<24}{'unknowns':>9}{'factorizations':>16}{'CPU [s]':>9}{'/ one block':>13}")
    for analysis in ("forward", "inverse"):
        whole = None
        for name, kind in KINDS.items():
            solved(4, analysis, kind)  # programs and kernels
            unknowns, factorizations, seconds = solved(across, analysis, kind)
            whole = whole or seconds
            ratio = seconds / whole
            print(
                f"{analysis + ', ' + name:<24}{unknowns:>9}{factorizations:>16}{seconds:>9.1f}{ratio:>13.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
