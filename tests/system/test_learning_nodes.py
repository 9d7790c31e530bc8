"""The nodes of the given body as an input of a job, next to central differences and to runs on moved meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.learning import check_products
from helpers.moved_meshes import write_block
from helpers.sheets import flat, save_sheet
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError
from hpcinv.studies.learning.differentiable_job import DifferentiableJob

NODES, LOAD = "mesh.nodes", "effects[0].pressure"


def block(comm: MPI.Intracomm, directory: Path, moved: Any = 0.0, tip: Any = (2, 1, 1), **data: Any) -> hpcinv.Job:
    """A block of 72 tetrahedra under pressure, with a support that moves by a formula of the place."""
    degree = data.pop("geometry", 1)
    write_block(comm, directory / "block.vtu", moved=moved, degree=degree)
    common: dict[str, Any] = {
        "analysis": "inverse",
        "mesh": {"file": str(directory / "block.vtu")},
        "material": {"law": "neo-hookean", "mu": "20 kPa", "lam": "30 kPa"},
        "effects": [{"effect": "pressure", "region": "x1", "pressure": 900}],
        "supports": [{"region": "x0", "displacement": ["0.02*y*z/(1 m)", 0, 0]}],
        "discretisation": {"displacement": 1, "formulation": "displacement"},
        "solver": {"tolerance": 1e-13},
        "quantities": [
            {"name": "tip", "of": "displacement", "at": list(tip)},
            {"name": "stress", "of": "von_mises/(1 kPa)", "on": "block", "reduce": "rms"},
        ],
        "sensitivities": [LOAD],
    }
    return job(**(common | data))


def rates(model: DifferentiableJob, size: float) -> list[Any]:
    random = np.random.default_rng(7)
    return [size * random.normal(size=shape) if shape else np.array(30.0) for shape in model.input_shapes]


@pytest.mark.parallel([1, 2])
def test_a_moved_body_is_the_body_of_a_moved_file(comm: MPI.Intracomm, run_directory: Path) -> None:
    """On an earlier body, too; points of quantities move with the material."""
    with DifferentiableJob(block(comm, run_directory), [NODES, LOAD], ["shape", "tip", "stress"], comm) as model:
        assert model.input_shapes == ((36, 3), ())
        assert model.output_shapes == ((36, 3), (3,), ())
        first = model.evaluate(model.start)
        motion = rates(model, 0.03)[0]
        corner = int(np.abs(model.start[0] - [2, 1, 1]).sum(axis=1).argmin())
        found = model.evaluate([model.start[0] + motion, 700.0])
        check_products(model, [model.start[0] + motion, np.array(700.0)], rates(model, 0.05))
        again = model.evaluate(model.start)
    moved = block(comm, run_directory, motion, model.start[0][corner] + motion[corner])
    fresh = hpcinv.run(moved.with_({LOAD: 700}), comm, progress=False)
    np.testing.assert_allclose(found[0], fresh.shape_in_file, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found[1], fresh.quantities["tip"], rtol=0, atol=1e-11)
    assert float(found[2]) == pytest.approx(fresh.quantities["stress"], rel=1e-9)
    np.testing.assert_allclose(again[0], first[0], rtol=0, atol=1e-11)


@pytest.mark.release
@pytest.mark.parallel([2])
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
@pytest.mark.parametrize(("geometry", "displacement"), [(1, 2), (2, 2), (2, 1)])
def test_cells_of_other_degrees(
    comm: MPI.Intracomm, run_directory: Path, analysis: str, geometry: int, displacement: int
) -> None:
    """Nodes half way that a displacement of degree 2 needs follow the vertices; nodes of curved cells are inputs."""
    spaces = {"displacement": displacement, "formulation": "displacement"}
    posed = block(comm, run_directory, geometry=geometry, analysis=analysis, discretisation=spaces)
    with DifferentiableJob(posed, [NODES, LOAD], ["shape", "tip", "stress"], comm) as model:
        assert model.input_shapes[0] == ((36 if geometry == 1 else 175), 3)
        check_products(model, model.start, rates(model, 0.02))


def sheet(comm: MPI.Intracomm, directory: Path, **data: Any) -> hpcinv.Job:
    """A curved strip of three cells of shell that is held at one end."""
    path = directory / "sheet.msh"
    if comm.rank == 0:

        def place(s: np.ndarray, t: np.ndarray) -> np.ndarray:
            points = flat(1, 0.5)(s, t)
            points[:, 2] = 0.1 * s * (1 + t)
            return points

        save_sheet(path, 3, 1, place)
    comm.Barrier()
    common: dict[str, Any] = {
        "analysis": "inverse",
        "mesh": {"file": str(path), "shell": {"thickness": 0.1}},
        "material": {"law": "neo-hookean", "mu": 3e4, "lam": 1.2e5},
        "effects": [{"effect": "pressure", "region": "inner", "pressure": 30}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "quantities": [{"name": "tip", "of": "displacement", "at": [1, 0.25, 0.15]}],
        "solver": {"tolerance": 1e-13},
        "sensitivities": [LOAD],
    }
    return job(**(common | data))


@pytest.mark.parallel([1, 2])
def test_nodes_of_the_surface_of_a_shell(comm: MPI.Intracomm, run_directory: Path) -> None:
    """The thickness of each node stays, along the normals of the moved surface."""
    with DifferentiableJob(sheet(comm, run_directory), [NODES, LOAD], ["shape", "tip"], comm) as model:
        assert (model.input_shapes, model.output_shapes[0]) == (((21, 3), ()), (63, 3))
        check_products(model, model.start, rates(model, 0.02))
        assert model.output_shapes[0] == model.evaluate(model.start)[0].shape


@pytest.mark.release
@pytest.mark.parametrize(
    "shell",
    [{"thickness": "0.1 m * (1 + x/(1 m))"}, {"thickness": 0.1, "layers": {"a": 2, "b": 3}}],
    ids=["x", "layers"],
)
def test_other_shells(comm: MPI.Intracomm, run_directory: Path, shell: dict[str, Any]) -> None:
    posed = sheet(comm, run_directory, analysis="forward").with_({"mesh.shell": shell})
    with DifferentiableJob(posed, [NODES], ["shape", "tip"], comm) as model:
        check_products(model, model.start, rates(model, 0.01))


@pytest.mark.release  # each day: products of a thicker shell, above
@pytest.mark.parametrize("thickness", [1e-2, 3e-3])
def test_thin_shells(comm: MPI.Intracomm, run_directory: Path, thickness: float) -> None:
    """Rounding leaves residuals of 1e-7 and 1e-5 of the right-hand side; the products keep 8 and 5 digits."""
    posed = sheet(comm, run_directory, analysis="forward").with_(
        {"mesh.shell": {"thickness": thickness}, LOAD: 1e5 * thickness**3}
    )
    with DifferentiableJob(posed, [LOAD], ["tip"], comm) as model:
        slope, weight = model.along(model.start, [1.0])[0], np.array([0.0, 0.0, 1.0])
        ends = [model.evaluate([(1 + s) * model.start[0]])[0] for s in (1e-3, -1e-3)]
        difference = (ends[0] - ends[1]) / (2e-3 * model.start[0])
        np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-4 * np.abs(slope).max())
        assert float(model.gradient(model.start, [weight])[0]) == pytest.approx(slope[2], rel=1e-5)


@pytest.mark.parallel([2])
def test_inverted_cells_are_one_message(comm: MPI.Intracomm, run_directory: Path) -> None:
    with DifferentiableJob(block(comm, run_directory), [NODES], ["tip"], comm) as model:
        moved = model.start[0].copy()
        moved[np.abs(moved - [2, 1, 1]).sum(axis=1).argmin()] -= 1.5
        with pytest.raises(
            MeshError, match=r"with the given nodes, .*block\.vtu: .*cells are inverted, with det J < 0"
        ):
            model.evaluate([moved])
        with pytest.raises(JobError, match=r"'mesh\.nodes' must have the shape \(36, 3\), not \(36,\)"):
            model.evaluate([moved[:, 0]])
        with pytest.raises(JobError, match=r"'mesh\.nodes' has values that are not finite"):
            model.evaluate([np.full((36, 3), np.nan)])
        assert np.isfinite(model.evaluate(model.start)[0]).all()


@pytest.mark.parallel([2])
@pytest.mark.release
@pytest.mark.parametrize("place", ["cells", "nodes"])
def test_pressures_and_fibres_of_data_arrays(comm: MPI.Intracomm, run_directory: Path, place: str) -> None:
    """A pressure by cell has a value for each facet that is the only one of its cell in the region."""
    file = run_directory / "block.vtu"
    points, middles = write_block(comm, file)
    random = np.random.default_rng(3)
    pressures = random.uniform(300, 900, len(middles if place == "cells" else points)) / 1e3
    fibres = np.array([1, 0.3, 0.2]) + 0.2 * random.normal(size=(len(points), 3))
    write_block(comm, file, arrays={"p": pressures, "a": fibres})
    law = {"law": "holzapfel-gasser-ogden", "mu": 2e4, "kappa": 9e4, "k1": 8e3, "k2": 0.8, "dispersion": 0.1}
    posed = job(
        analysis="inverse",
        mesh={"file": str(file)},
        material=law | {"fibres": ["f"]},
        fibres={"f": {"data": "a", "given_on": "current"}},
        effects=[{"effect": "pressure", "region": "x1", "pressure": {"data": "p", "unit": "kPa"}}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        discretisation={"displacement": 1, "formulation": "displacement"},
        solver={"tolerance": 1e-13},
    )
    with DifferentiableJob(posed, [LOAD, "fibres.f.direction", NODES], ["shape"], comm) as model:
        assert model.input_shapes == (pressures.shape, (len(points), 3), (len(points), 3))
        np.testing.assert_allclose(model.start[0], pressures, rtol=1e-12)
        check_products(model, model.start, [random.normal(size=v.shape) * 0.1 * np.abs(v).mean() for v in model.start])
