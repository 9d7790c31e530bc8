"""The bodies of the benchmarks, of about a number of unknowns: the silicone beam of the paper, a block, a sphere."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bench_runs import WITHOUT_CERTIFICATE, Bench, Findings, JobData

from hpcinv.errors import HpcinvError

MESHES = Path(__file__).resolve().parents[1] / "meshes"
BEAM_SIZE, BEAM_UNKNOWNS = 2.2e-3, 32_528  # m; of jobs/pdms-beam.yaml
CURVED, COARSEST = 4e-3, 8.5e-3  # m; larger cells cannot follow the curved side, or have no room


def beam(unknowns: int, **changes: Any) -> JobData:
    """The silicone beam of Mazier et al. (2022), doi:10.1007/s00366-021-01597-z, under its own weight; mixed form."""
    size = min(BEAM_SIZE * (BEAM_UNKNOWNS / unknowns) ** (1 / 3), COARSEST)
    degree = 2 if size <= CURVED else 1
    return {
        "job": "beam",
        "mesh": {
            "file": str(MESHES / "pdms_beam.py"),
            "parameters": {"size": round(size, 6)},
            "geometry_degree": degree,
        },
        "material": {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8},
        "effects": [{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 963}],
        "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
        "checkpoint": {"every": 0},
        "output": {"fields": False, "mesh": []},
        **changes,
    }


def block(unknowns: int, **changes: Any) -> JobData:
    """A cube of the same silicone, 1 m high, which stands on its clamped bottom under its own weight; mixed form."""
    divisions = min(range(1, 100), key=lambda n: abs(3 * (2 * n + 1) ** 3 + (n + 1) ** 3 - unknowns))
    return {
        **beam(unknowns),
        "job": "block",
        "mesh": {"file": str(MESHES / "box.py"), "parameters": dict.fromkeys(("nx", "ny", "nz"), divisions)},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 963}],
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        **changes,
    }


def sphere(unknowns: int, **changes: Any) -> JobData:
    """An octant of an incompressible hollow sphere under inner pressure, on curved cells; mixed form."""

    def size(n: int) -> int:
        """Unknowns of ``n`` divisions along the surface and half as many across the wall."""
        return 3 * (12 * n**2 + 6 * n + 1) * (n + 1) + (3 * n**2 + 3 * n + 1) * (n // 2 + 1)

    divisions = min(range(2, 100, 2), key=lambda n: abs(size(n) - unknowns))
    wall = {"inner": 1.0, "outer": 1.5, "radial": divisions // 2, "along": divisions}
    return {
        **beam(unknowns),
        "job": "sphere",
        "mesh": {"file": str(MESHES / "thick_sphere.py"), "parameters": wall, "geometry_degree": 2},
        "material": {"law": "mooney-rivlin", "c1": 0.3, "c2": 0.2, "d1": "incompressible"},
        "effects": [{"effect": "pressure", "region": "inner", "pressure": 0.2}],
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        **changes,
    }


def sagging_beam(bench: Bench, size: int) -> dict[str, Any]:
    """The mesh of the beam's loaded shape, for inverse analyses."""
    kept = bench.directory / f"sagging-{size}.msh"
    if not kept.exists():
        output = {"fields": False, "mesh": ["msh"]}
        loaded = beam(size, analysis="forward", output=output, certificate=WITHOUT_CERTIFICATE)
        bench.must_run("the sagging beam", loaded)
        shutil.copyfile(bench.results / "shape.msh", kept)
    return {"file": str(kept)}


def measure(parser: argparse.ArgumentParser, section: Callable[[Bench, argparse.Namespace], list[Findings]]) -> None:
    """Run a section of measurements, print its tables, and write its figures to ``--out``."""
    parser.add_argument("--repeat", type=int, default=3, help="rounds, for medians (3)")
    parser.add_argument("--out", type=Path, help="all figures as JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hpcinv-bench-") as directory:
        try:
            tables = section(Bench(Path(directory), lambda text: print(text, file=sys.stderr, flush=True)), options)
        except HpcinvError as error:
            sys.exit(str(error))
    for table in tables:
        table.show()
    if options.out is not None:
        data: list[Mapping[str, Any]] = [table.data for table in tables]
        options.out.write_text(json.dumps(data, indent=2) + "\n")
