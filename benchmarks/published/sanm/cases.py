"""Jobs and published solutions of SANM's scenes, from the folder that ``HPCINV_SCENES`` names.

It holds ``SCENE.vtu``, ``SCENE-forward.yaml``, ``SCENE-inverse.yaml``, and what SANM found, by the same node order:
``sanm-solutions/SCENE-DIRECTION.npz`` with ``nodes`` (n, 3) in m, NaN where it prints none.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hpcinv.base.parallel.runtime import on_root
from hpcinv.mesh.body import reorder_to_source

from ..runs import Missing

if TYPE_CHECKING:
    from hpcinv.output.result import Result

FOLDER = "HPCINV_SCENES"


def _file(name: str) -> Path:
    folder = os.environ.get(FOLDER)
    if folder is None:
        raise Missing(f"the scenes of SANM are not here: set {FOLDER} to their folder")
    if not (path := Path(folder) / name).exists():
        raise Missing(f"{path} is missing ({FOLDER})")
    return path


def job_file(name: str, store: Path) -> Path:
    """Return the job of a scene and direction; raises `Missing`."""
    return _file(f"{name}.yaml")


def quantities(name: str, result: Result) -> dict[str, float]:
    """Return the largest displacement, and the largest distance from where SANM puts a node; in m, collective."""
    body, solution = result.body, result.solutions[0]
    given, ours = (reorder_to_source(body, nodes) for nodes in (solution.mesh_nodes, solution.other_nodes))

    def compare() -> dict[str, float]:
        theirs = np.load(_file(f"sanm-solutions/{name}.npz"))["nodes"]
        printed = ~np.isnan(theirs).any(axis=1)
        return {
            "displacement": float(np.linalg.norm(ours - given, axis=1)[printed].max()),
            "distance": float(np.linalg.norm(ours - theirs, axis=1)[printed].max()),
        }

    return on_root(body.mesh.comm, compare)
