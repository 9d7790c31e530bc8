"""``hpcinv compile`` and the directory of kernels: what is made once need not be again, by anybody."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK, CUBE, ROOT, environment, hpcinv, write_job

from hpcinv.base.quantity.docstrings import meanings
from hpcinv.base.quantity.expressions import Expression
from hpcinv.job.job import parse
from hpcinv.mesh.body import read_source
from hpcinv.mesh.sample_mesh import HELD, sample_body

# All that a run may compute, in one job.
EVERYTHING: Mapping[str, Any] = {
    **BLOCK,
    "analysis": "round_trip",
    "discretisation": {"displacement": 1},
    "regions": {"low": "z < 0.51"},
    "quantities": [
        *BLOCK["quantities"],
        {"name": "stress", "of": "von_mises", "at": [0.41, 0.52, 0.33]},
        {"name": "work", "of": "energy", "on": "low", "reduce": "integral", "over": "reference"},
        {"name": "area", "of": "J", "on": "x1", "reduce": "mean"},
    ],
    "sensitivities": {"material.mu": "1 kPa"},
    "certificate": {"estimate": True},
}

READ_ONLY = "import os, runpy; os.access = lambda *_: False; runpy.run_module('hpcinv', run_name='__main__')"


def kernels(directory: Path) -> set[str]:
    return {path.name for pattern in ("*.so", "*.npz") for path in directory.glob(pattern)}


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A job, and the directory of its kernels."""
    here = tmp_path_factory.mktemp("compiled")
    job = write_job(here / "job.yaml", EVERYTHING)
    done = hpcinv(1, "compile", job, "--cache", here / "kernels", cwd=here)
    assert done.returncode == 0, done.stderr
    assert f"{len(kernels(here / 'kernels'))} programs made" in done.stdout
    return job, here / "kernels"


def test_a_run_finds_every_kernel_that_was_compiled_for_it(compiled: tuple[Path, Path], tmp_path: Path) -> None:
    job, directory = compiled
    before = kernels(directory)
    assert before
    env = {"HPCINV_KERNELS": str(directory), "XDG_CACHE_HOME": str(tmp_path / "own")}
    done = hpcinv(1, "run", job, "--output", "results", cwd=tmp_path, **env)
    assert done.returncode in (0, 6), done.stderr
    assert "round trip: closes" in done.stdout
    assert kernels(directory) == before
    assert not (tmp_path / "own").exists()


def test_kernels_missing_in_a_read_only_directory_go_to_the_users_cache(
    compiled: tuple[Path, Path], tmp_path: Path
) -> None:
    _, directory = compiled
    before = kernels(directory)
    other = {**EVERYTHING, "quantities": [{"name": "height", "of": "X*J", "on": "low", "reduce": "mean"}]}
    job = write_job(tmp_path / "job.yaml", other, certificate=CUBE["certificate"])
    env = environment(HPCINV_KERNELS=str(directory), XDG_CACHE_HOME=str(tmp_path))
    command = [sys.executable, "-c", READ_ONLY, "run", str(job), "--output", str(tmp_path / "results")]
    done = subprocess.run(command, env=env, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert kernels(directory) == before
    # The one program of the quantity: all others were found.
    assert len(kernels(tmp_path / "fenics")) == 1


def test_a_directory_that_cannot_be_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    job = write_job(tmp_path / "job.yaml", CUBE)
    done = hpcinv(1, "run", job, cwd=tmp_path, HPCINV_KERNELS=str(tmp_path / "file" / "kernels"))
    assert done.returncode == 2
    assert done.stderr.startswith(f"HPCINV_KERNELS={tmp_path / 'file' / 'kernels'}: Not a directory")


def test_flags_of_the_environment_give_kernels_of_their_own(tmp_path: Path) -> None:
    def flags(**env: str) -> str:
        code = "from hpcinv.base.parallel.jit import JIT_OPTIONS; print(JIT_OPTIONS['cffi_extra_compile_args'])"
        command = [sys.executable, "-c", code]
        return subprocess.run(command, env=environment(**env), cwd=tmp_path, check=True, capture_output=True).stdout

    assert flags() != flags(CFLAGS="-ffast-math") != flags(CFLAGS="-O0")
    assert flags(CFLAGS="-O0") == flags(CFLAGS="-O0")


def test_a_specimen_has_a_cell_of_each_kind_apart_from_the_others() -> None:
    divisions = {"nx": 3, "ny": 3, "nz": 3}
    job = parse({**BLOCK, "mesh": {**BLOCK["mesh"], "parameters": divisions, "geometry_degree": 2}}, ROOT / "job.yaml")
    source = read_source(job.mesh, job.resolve(job.mesh.file))
    body = sample_body(source, {"low": Expression("z < 0.35")}, [np.array([0.5, 0.5, 0.5])])
    assert body.source.kind == "tetrahedron"
    assert body.source.degree == 2
    for face in ("x0", "x1", "y0", "y1", "z0", "z1", "low", "boundary"):
        assert body.regions[face].facet_count > 0
    cells = body.source.cells
    assert body.regions["block"].cell_count == len(cells) < len(source.cells)
    assert 0 < body.regions["low"].cell_count < len(cells)
    assert len(np.unique(cells)) == cells.size  # no node in two cells
    assert body.regions[HELD].facet_count == len(cells)
    # A facet of each region lies where the region does.
    x1 = next(g for g in body.source.groups if g.name == "x1")
    assert np.allclose(body.source.points[body.source.facets[x1.members], 0], 1.0)


def test_meanings_are_those_in_the_source() -> None:
    from hpcinv.job.settings import Solver
    from hpcinv.physics.effects import effects

    assert meanings(Solver)["petsc"] == "PETSc options by name, without the dash"
    gravity = meanings(effects()["gravity"])
    assert gravity["acceleration"] == "acceleration of free fall, along x, y and z"
    assert "case" in gravity  # of its base
