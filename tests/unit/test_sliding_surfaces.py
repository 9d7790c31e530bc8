"""Surfaces on which regions slide."""

import numpy as np
import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.job.support import Support
from hpcinv.mesh.source import Floats
from hpcinv.model.sliding_surfaces import surface_of


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_no_curved_surface_is_fitted_to_a_flat_region(kind: str) -> None:
    normal = np.array([1.0, 2.0, -2.0]) / 3
    draws = np.random.default_rng(7).uniform(-1, 1, (40, 3))
    points = 0.3 + 0.1 * (draws - np.outer(draws @ normal, normal))
    points = np.round(points, 8)  # of a file with few digits
    spec = Support.model_validate({"region": "base", "fix": ["normal"], "surface": kind})
    with pytest.raises(MeshError, match=f"'base' is flat, so that no {kind} fits it"):
        surface_of(spec, "supports[0]", points, np.tile(normal, (40, 1)), points, MPI.COMM_SELF)


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_the_fitted_surface_is_that_of_exact_nodes(kind: str) -> None:
    """A patch far from the origin, which is not symmetric, on a surface of radius 30 mm in general position."""
    centre, axis = np.array([0.2, -0.1, 0.5]), np.array([1.0, 2.0, -2.0]) / 3
    draws = np.random.default_rng(45).uniform(-1, 1, (40, 3)) + np.array([2.0, 0.0, 0.0])

    def radial(arms: Floats) -> Floats:
        across = arms - np.outer(arms @ axis, axis) if kind == "cylinder" else arms
        return np.asarray(across / np.linalg.norm(across, axis=1)[:, None])

    normals = radial(draws)
    along = np.outer(draws @ axis, axis) * 0.01 if kind == "cylinder" else 0.0
    points = centre + 0.03 * normals + along
    spec = Support.model_validate({"region": "bore", "fix": ["normal"], "surface": kind})
    surface = surface_of(spec, "supports[0]", points, normals, points, MPI.COMM_SELF)
    outside = points + 0.01 * normals
    assert surface.distances(outside) == pytest.approx(np.full(40, 0.01), abs=1e-11)
    values = surface.values(outside)
    assert np.abs(values.gradient - normals).max() < 1e-9
    # principal curvatures: 1/r twice on a sphere, once on a cylinder
    curvatures = np.linalg.eigvalsh(values.hessian)
    assert curvatures[:, 1:] == pytest.approx(np.tile([25.0 if kind == "sphere" else 0.0, 25.0], (40, 1)), abs=1e-6)
