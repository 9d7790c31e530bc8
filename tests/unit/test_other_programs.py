"""The typed example of the page on other programs, in a directory with the files of a run."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.body import read_source
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import DataArray

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "other-programs.md").read_text()


def test_files_of_a_run_go_on_in_dolfinx(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import dolfinx
    import ufl

    box = {"file": "box.py", "parameters": {"lx": 3.0, "nx": 3, "ny": 2, "nz": 1}}
    source = read_source(MeshSpec.model_validate(box, context={"directory": ROOT / "meshes"}), ROOT / "meshes/box.py")
    middles = source.points[source.cells].mean(axis=1)
    fibres = np.column_stack([np.cos(middles[:, 0]), np.sin(middles[:, 0]), 0 * middles[:, 0]])
    shape = replace(source, data={"fibre": DataArray("fibre", "cells", fibres)})
    run = tmp_path / "results" / "ventricle"
    run.mkdir(parents=True)
    for suffix in (".msh", ".vtu"):
        save(run / f"shape{suffix}", shape, shape.points)
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    found: dict[str, Any] = {}
    exec(code, found)

    mesh, f0, markers = found["mesh"], found["f0"], found["markers"]
    assert {"x0", "x1", "z0"} <= set(markers)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=found["facet_tags"])
    tag, dim = markers["x1"]
    assert dim == 2
    sides = np.ptp(source.points, axis=0)
    area = dolfinx.fem.assemble_scalar(dolfinx.fem.form(dolfinx.fem.Constant(mesh, 1.0) * ds(tag)))
    assert mesh.comm.allreduce(area, op=MPI.SUM) == pytest.approx(sides[1] * sides[2])
    at = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(len(f0.x.array) // 3, dtype=np.int32))[:, 0]
    assert f0.x.array.reshape(-1, 3) == pytest.approx(np.column_stack([np.cos(at), np.sin(at), 0 * at]))
