"""Jobs at larger loads, whose loads are arrays of the mesh: ``NAME-full`` forward, ``NAME-full-unloaded`` back.

A formula of the unknown body would be another load all along the path. Panels are solved back from a cylinder with a
radius 10 % too large, since they have several unloaded bodies.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from . import backwards

_SECTIONS = {
    "moment": "3.2",
    "cylinder": "3.5",
    "pinched": "3.6",
    "semi": "3.7",
    "roof": "3.8 roof of 12.7",
    "laminate": "3.8 roof of three",
}


def job_file(name: str, store: Path) -> Path:
    """Return the job file of that name, next to its meshes."""
    case_name = name.split("-", maxsplit=1)[0]
    directory = store / f"{case_name}-full-files"
    directory.mkdir(parents=True, exist_ok=True)
    section = _SECTIONS[case_name]
    (case,) = (case for key, case in backwards.cases(directory).items() if key.startswith(section))
    output = {"fields": False, "mesh": [], "unit_warnings": False}
    job = {**case.job, "job": name, "output": output, "certificate": {"level": "off"}}
    if name.endswith("-unloaded"):
        job |= backwards.way_back(case, Path("loaded.msh")) | {"quantities": _quantities(case)}
    else:
        job |= {"analysis": "forward", "quantities": []}
    path = directory / f"{name}.yaml"
    path.write_text(yaml.safe_dump(job, sort_keys=False))
    return path


def _quantities(case: backwards.BackwardCase) -> list[dict[str, Any]]:
    """Return the largest and the least radius of a cylinder, or the place of the end of a strip."""
    if not case.radius:
        return [
            {"name": name, "of": axis, "on": "x1", "reduce": "mean"}
            for name, axis in (("length", "X"), ("height", "Z"))
        ]
    radius = f"norm(X, Z - {case.radius!r})"
    return [{"name": n, "of": radius, "on": "boundary", "reduce": r} for n, r in (("largest", "max"), ("least", "min"))]
