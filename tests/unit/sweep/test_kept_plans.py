"""Plans that are kept in a store say the same as plans that are made anew, and count only while nothing differs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.command_line import COLUMN, ROOT
from helpers.sweeps import write_sweep

from hpcinv.errors import JobError
from hpcinv.job.job_variants import JobVariants
from hpcinv.studies.sweep import kept_plan
from hpcinv.studies.sweep.kept_plan import keep_plan, known_plan
from hpcinv.studies.sweep.sweep_plan import SweepPlan, read_sweep


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Keys of the cases that were checked, in their order."""
    keys: list[str] = []
    identity = JobVariants.identity

    def noted(self: JobVariants, job: Any) -> Any:
        keys.append((found := identity(self, job))[0])
        return found

    monkeypatch.setattr(JobVariants, "identity", noted)
    monkeypatch.setattr(kept_plan, "LEAST", 4)
    return keys


def found(plan: SweepPlan) -> list[Any]:
    return [(case.key, case.reuse_group, case.numbers, case.home, dict(case.settings)) for case in plan.cases]


def write(directory: Path, *moduli: Any) -> Path:
    mesh = directory / "box.py"
    mesh.write_text((ROOT / "meshes" / "box.py").read_text())
    (directory / "plugin.py").write_text("SCALE = 1.0\n")
    job = COLUMN | {"mesh": COLUMN["mesh"] | {"file": "box.py"}, "plugins": ["plugin.py"]}
    return write_sweep(directory, [{"grid": {"material.mu": [*moduli], "mesh.parameters.lx": [0.2, 0.3]}}], job=job)


def test_a_kept_plan_is_the_plan(planned: list[str], tmp_path: Path) -> None:
    path = write(tmp_path, *(f"{10 + i} kPa" for i in range(6)))
    plan = read_sweep(path).plan()
    assert len(planned) == 12
    keep_plan(plan)
    kept = known_plan(path)
    assert planned[12:] == [planned[0], planned[11]]  # the first and the last case were checked
    assert found(kept) == found(plan)
    assert [*kept.cases.keys] == [*plan.cases.keys]
    assert kept.files_read == plan.files_read >= {tmp_path / "box.py", tmp_path / "plugin.py"}


@pytest.mark.everyday("sweep", "mesh", "other keys")
@pytest.mark.parametrize("changed", ["sweep", "job", "mesh", "plugin", "removed mesh", "damaged plan", "other keys"])
def test_a_plan_is_made_anew_if_something_differs(changed: str, planned: list[str], tmp_path: Path) -> None:
    path = write(tmp_path, 1e4, 2e4, 3e4)
    keep_plan(read_sweep(path).plan())
    [file] = (tmp_path / "store" / "plans").iterdir()
    match changed:
        case "sweep":
            path.write_text(path.read_text().replace("30000.0", "31000.0"))
        case "job":
            job = tmp_path / "block.yaml"
            job.write_text(yaml.safe_dump(yaml.safe_load(job.read_text()) | {"discretisation": {"displacement": 3}}))
        case "mesh" | "plugin":
            (tmp_path / {"mesh": "box.py", "plugin": "plugin.py"}[changed]).open("a").write("\n# changed\n")
        case "removed mesh":
            (tmp_path / "box.py").unlink()
        case "damaged plan":
            file.write_bytes(file.read_bytes()[:-20])
        case "other keys":
            data = json.loads(file.read_bytes())
            data["cases"]["keys"] = "0" * 20 + data["cases"]["keys"][20:]
            file.write_text(json.dumps(data))
    planned.clear()
    faults = {"removed mesh": r"box\.py", "plugin": "has changed since this process imported it"}
    if changed in faults:
        with pytest.raises(JobError, match=faults[changed]):
            known_plan(path)
        return
    assert found(known_plan(path)) == found(read_sweep(path).plan())
    assert len(planned) >= 12


def test_small_sweeps_and_parts_are_not_kept(tmp_path: Path) -> None:
    path = write(tmp_path, 1e4, 2e4)
    keep_plan(read_sweep(path).plan())
    keep_plan(read_sweep(path).plan(1))
    assert not (tmp_path / "store").exists()
