"""A study of a column, and its plan."""

from pathlib import Path
from typing import Any

import yaml

from helpers.command_line import COLUMN
from hpcinv.studies.study.study_plan import StudyPlan, load_study

STUDY: dict[str, Any] = {
    "job": "column.yaml",
    "series": [
        {"name": "P2", "vary": {"mesh.parameters.nz": [1, 2, 4]}},
        {"name": "P3", "set": {"discretisation.displacement": 3}, "vary": {"mesh.parameters.nz": [1, 2]}},
    ],
    "measure": ["length"],
    "reference": {"length": "1.0802799 m"},
}


def plan(directory: Path, **changes: Any) -> StudyPlan:
    (directory / "column.yaml").write_text(yaml.safe_dump(COLUMN))
    path = directory / "study.yaml"
    path.write_text(yaml.safe_dump(STUDY | changes, sort_keys=False))
    return load_study(path)
