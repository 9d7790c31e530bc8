"""Fixtures of several files: the job of a beam that is edited, what is wrong with it then, and reading in-process."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.job_cases import BEAM, GENERATOR, Edit, Loader

import hpcinv
from hpcinv.base.reading import isolated_reader
from hpcinv.base.reading.fault import Fault
from hpcinv.errors import JobError, MeshError
from hpcinv.formats.readers import elements
from hpcinv.job.job import Job
from hpcinv.mesh.io import vtu


@pytest.fixture
def load(tmp_path: Path) -> Loader:
    """Loads the beam's job after an edit of its contents."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "jobs").mkdir()
    (tmp_path / "meshes" / "beam.py").write_text(GENERATOR)
    (tmp_path / "meshes" / "beam.geo").write_text("DefineConstant [ size = {0.002} ];")
    (tmp_path / "meshes" / "beam.msh").write_text("$MeshFormat\n")

    def load(edit: Edit = lambda job: None, name: str = "arm.yaml") -> Job:
        contents = yaml.safe_load(BEAM)
        edit(contents)
        path = tmp_path / "jobs" / name
        path.write_text(json.dumps(contents))  # JSON is YAML 1.2
        return hpcinv.load(path)

    return load


@pytest.fixture
def problems(load: Loader) -> Callable[[Edit], list[str]]:
    """The errors of the beam's job after an edit, without the name of the file that each must begin with."""

    def problems(edit: Edit) -> list[str]:
        with pytest.raises(JobError) as caught:
            load(edit)
        prefix = re.compile(r".*/jobs/arm\.yaml: ")
        assert all(prefix.match(p) for p in caught.value.problems)
        return [prefix.sub("", p, count=1) for p in caught.value.problems]

    return problems


@pytest.fixture
def same_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read without a process for each file, which takes half a second."""

    def read_here(action: str, path: Path, *_: str) -> Any:
        try:
            return isolated_reader.action_of(action)(path, isolated_reader.Limits(0, 0))
        except Fault as fault:
            raise MeshError(f"{path}: {fault.text}", fault.advice) from None

    monkeypatch.setattr(isolated_reader, "limit", lambda _: None)
    monkeypatch.setattr(elements, "read_isolated", read_here)
    monkeypatch.setattr(vtu, "read_isolated", read_here)
