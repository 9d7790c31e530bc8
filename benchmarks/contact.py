"""Factorizations of jobs with contact, and of the same jobs with supports instead of the obstacle.

Usage: python benchmarks/contact.py
"""

import hpcinv.base.parallel.runtime

# isort: split
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import hpcinv
from hpcinv.job.job import Job
from hpcinv.solver.methods.direct_method import AUGMENTATION

MESHES = Path(__file__).parents[1] / "meshes"
MATERIAL = {"law": "neo-hookean", "young": "100 kPa", "poisson": 0.3}
WEIGHT = {"effect": "gravity", "acceleration": [0, 0, -10], "density": 1000, "density_in": "reference"}
SYMMETRY = [{"region": f"{axis}0", "fix": [axis]} for axis in "xy"]
BALL = {"radius": "10 mm", "size": "3 mm", "at_pole": "0.2 mm", "extent": "1 mm"}
BEAM = {"nx": 20, "ny": 1, "nz": 1, "lx": 1.0, "ly": 0.05, "lz": 0.05, "hexahedra": True}


def mesh(file: str, **parameters: Any) -> dict[str, Any]:
    return {"mesh": {"file": str(MESHES / file), "parameters": parameters, "geometry_degree": 2}}


SCENES: Mapping[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "ball between plates": (
        mesh("ball.py", **BALL)
        | {
            "regions": {"touched": "norm(x, y) < 0.5 mm and z > 9 mm"},
            "supports": [*SYMMETRY, {"region": "z0", "fix": ["z"]}],
        },
        {
            "region": "outer",
            "obstacle": {"shape": "plane", "point": [0, 0, "10 mm"], "normal": [0, 0, -1]},
            "travel": [0, 0, "-0.05 mm"],
        },
        {"region": "touched", "displacement": [None, None, "-0.05 mm + 0*x"]},
    ),
    "block on a floor": (
        mesh("box.py", nx=4, ny=4, nz=4) | {"effects": [WEIGHT], "supports": SYMMETRY},
        {"region": "z0", "obstacle": {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1]}},
        {"region": "z0", "fix": ["z"]},
    ),
    "beam on a peg": (
        mesh("box.py", **BEAM)
        | {
            "regions": {"touched": "abs(x - 0.8 m) < 0.051 m and z < 1e-6 m"},
            "effects": [WEIGHT | {"density": 0.333}],
            "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        },
        {
            "region": "z0",
            "obstacle": {"shape": "cylinder", "point": [0.8, 0, -0.11], "axis": [0, 1, 0], "radius": 0.1},
        },
        {"region": "touched", "displacement": [None, None, "-0.01 m + 0*x"]},
    ),
}


def job(scene: Mapping[str, Any], **more: Any) -> Job:
    common = {"analysis": "forward", "material": MATERIAL, "certificate": "off"}
    return hpcinv.load({**common, **scene, **more})


def counts(given: Job) -> str:
    (solution,) = hpcinv.run(given, progress=False).solutions
    updates = sum(solve.strategy == AUGMENTATION for solve in solution.solves)
    return f"{solution.factorizations:>14}{updates:>9}"


def main() -> None:
    print(f"{'scene':<22}{'':<10}{'factorizations':>14}{'updates':>9}")
    for name, (scene, contact, support) in SCENES.items():
        contact_job = job(scene, effects=[{"effect": "contact", **contact}, *scene.get("effects", [])])
        supports = [*scene["supports"], support]
        print(f"{name:<22}{'contact':<10}{counts(contact_job)}")
        print(f"{'':<22}{'supports':<10}{counts(job(scene, supports=supports))}")


if __name__ == "__main__":
    main()
