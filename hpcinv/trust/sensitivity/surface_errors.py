"""Standard deviations of shapes and quantities from errors of the given surface, such as a segmented one.

The given surface is wrong by ``w n`` along its normal n, with a Gaussian random field w of mean 0, standard deviation σ
and covariance ``σ² exp(-|x - y|²/(2 ℓ²))`` in space. It is sampled as a sum of plane waves with random directions and
phases; nodes of the surface move by each sample, and shapes and quantities follow as exact derivatives of the discrete
solution show. With m samples each standard deviation is known to about 1/√(2m) of itself.

Source: Shinozuka & Deodatis, "Simulation of multi-dimensional Gaussian stochastic fields by spectral representation"
(1996), doi:10.1115/1.3101883.
"""

import math
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import entities_to_geometry, exterior_facet_indices

from hpcinv.base.quantity.units import Dimension, readable
from hpcinv.errors import SolveError
from hpcinv.job.job import Job
from hpcinv.job.mesh_file import CUT
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh import Body
from hpcinv.mesh.boundary_shells import outer_facets
from hpcinv.mesh.extent import diagonal
from hpcinv.mesh.source import Floats
from hpcinv.mesh.symmetry import symmetry_planes
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.check import Line, Verdict, skipped
from hpcinv.trust.sensitivity.analysis import sensitivities
from hpcinv.trust.sensitivity.sensitivities import SPREAD, Sensitivities, Spreads, joined_sensitivities

_OF_VOXEL = 0.12  # standard deviation that meshes of labels without errors have, in voxels
_OF_SD = 10.0  # correlation length by default, in standard deviations
_SAMPLES = 16
_WAVES = 400
_ROUND_OFF = 1e-9  # of the body's diagonal
_SEED = 18


@dataclass(frozen=True)
class SurfaceErrors:
    """Errors of the given surface; lengths in m.

    Attributes:
        sd: standard deviation along the normal.
        correlation: length over which errors are alike.
        voxel: size of the image's voxels from which both were taken, 0 if they were given.
    """

    sd: float
    correlation: float
    samples: int
    voxel: float

    @property
    def parameters(self) -> list[Parameter]:
        """A parameter for each sample, such that their standard deviations together are the surface's."""
        deviation = 1 / math.sqrt(self.samples)
        return [Parameter(f"surface {i}", "mesh", None, (), 0.0, Dimension(), deviation) for i in range(self.samples)]

    def displacements(self, job: Job, body: Body) -> dict[str, Floats]:
        """Return the samples, displacements (n, 3) m of the local geometry nodes, by key; collective."""
        normals = surface_normals(job, body)
        surface_nodes = np.flatnonzero(normals.any(axis=1))
        points, random = body.given_nodes[surface_nodes], np.random.default_rng(_SEED)
        samples = {}
        for parameter in self.parameters:
            waves = random.standard_normal((_WAVES, 3)) / self.correlation
            phases = random.uniform(0, 2 * np.pi, _WAVES)
            height = np.cos(points @ waves.T + phases).sum(axis=1) * math.sqrt(2 / _WAVES)
            moved = np.zeros_like(normals)
            moved[surface_nodes] = self.sd * height[:, None] * normals[surface_nodes]
            samples[parameter.key] = moved
        return samples

    def as_data(self) -> dict[str, Any]:
        data = {"sd": self.sd, "correlation": self.correlation, "samples": self.samples}
        return data | ({"voxel": self.voxel} if self.voxel else {})


@dataclass(frozen=True)
class SurfaceSpread:
    """Standard deviations that errors of the given surface cause.

    Attributes:
        sensitivities: of all shapes and quantities.
        states: that were solved, by the state whose shape this found.
        seconds: that they took.
        failure: why they are not known; then there is nothing else.
    """

    errors: SurfaceErrors
    sensitivities: Sensitivities | None = None
    states: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    failure: str = ""

    @property
    def shapes(self) -> Mapping[str, Sensitivities]:
        """Results by the state whose shape they are of; ``""`` is the one shape of a job without states."""
        if self.sensitivities is None:
            return {}
        return self.sensitivities.shapes or {"": self.sensitivities}

    def as_data(self) -> dict[str, Any]:
        """Return JSON data, without the fields."""
        if self.sensitivities is None:
            return self.errors.as_data() | {"failure": self.failure}
        shapes = {name: {"sd": shape.deviation, "sd_at": shape.deviation_at} for name, shape in self.shapes.items()}
        return (
            self.errors.as_data()
            | {"quantities": dict(self.sensitivities.deviations)}
            | ({"shape": shapes[""]} if "" in shapes else {"shapes": shapes})
        )

    def deviations(self) -> dict[str, float]:
        """Return the largest standard deviation (m) of each shape, by the state that was solved."""
        return {self.states[name]: shape.deviation or 0.0 for name, shape in self.shapes.items()}

    def lines(self) -> list[Line]:
        """Return the lines of the certificate, which inform and do not judge."""
        if self.sensitivities is None:
            return [skipped(SPREAD, self.failure)]
        e = self.errors
        source = f", from voxels of {readable(e.voxel, 'm')}" if e.voxel else ""
        note = (
            f"surface known to {readable(e.sd, 'm')} over {readable(e.correlation, 'm')}{source};"
            f" {e.samples} samples, to {100 / math.sqrt(2 * e.samples):.0f} %"
        )
        lines = [
            Line(SPREAD, sd, "m", "reported, not judged", Verdict.PASS, note, state=state)
            for state, sd in self.deviations().items()
        ]
        return [replace(lines[0], seconds=self.seconds), *lines[1:]]

    def fields(self) -> list[list[fem.Function]]:
        """Return fields for ParaView for each shape: the standard deviation ``surface sd`` in m."""
        return [[shape.deviation_field("surface sd")] for shape in self.shapes.values()]


class SurfaceSpreads(Spreads):
    """Spread of the shapes of a run by errors of the given surface, solve by solve; methods are collective."""

    def __init__(self, job: Job, body: Body) -> None:
        self._errors = errors_of(job, body)
        self._derivatives: dict[str, Sensitivities] = {}
        self._states: dict[str, str] = {}
        self._first: Solution | None = None
        self._seconds = 0.0
        self._failure = "" if job.has_derivatives else "there are no derivatives of contact with a rigid obstacle"
        if job.remote_loads:
            self._failure = "errors of a region that a remote load moves as a rigid body are not followed"

    def add(self, shape: str, equations: Equations, solution: Solution) -> None:
        if self._errors is None or self._failure:
            return
        begun = time.perf_counter()
        self._states[shape] = solution.state
        parameters = self._errors.parameters
        try:
            if self._first is None:
                moved = self._errors.displacements(solution.job, equations.body)
                self._derivatives[shape] = sensitivities(equations, solution, parameters, mesh=moved)
                self._first = solution
            else:
                first = self._first, next(iter(self._derivatives.values()))
                self._derivatives[shape] = sensitivities(equations, solution, parameters, first)
        except SolveError as error:
            self._failure = error.message
        self._seconds += time.perf_counter() - begun

    def spread_of(self, quantities: Iterable[QuantityOfInterest]) -> SurfaceSpread | None:
        if self._errors is None:
            return None
        if self._failure:
            return SurfaceSpread(self._errors, failure=self._failure)
        return SurfaceSpread(
            self._errors, joined_sensitivities(self._derivatives, quantities), self._states, self._seconds
        )


def errors_of(job: Job, body: Body) -> SurfaceErrors | None:
    """Return the errors of the given surface, ``None`` if they are not known, or not asked for."""
    spec, voxel = job.mesh.surface_error, body.source.voxel
    if not job.certificate.surface or (spec is None and not voxel):
        return None
    if spec is not None:
        return SurfaceErrors(spec.sd, spec.correlation or _OF_SD * spec.sd, spec.samples, 0.0)
    # Errors are alike over a voxel, or between the nodes of a mesh of larger cells.
    return SurfaceErrors(_OF_VOXEL * voxel, max(voxel, (job.mesh.size or 0.0) / 2), _SAMPLES, voxel)


def surface_normals(job: Job, body: Body) -> Floats:
    """Return unit normals (n, 3) out of the body at the local geometry nodes of its surface, 0 at others; collective.

    A node's normal is the mean of its facets' normals, by their area. The region `CUT` does not count, nor do planes of
    symmetry: nodes stay in them.
    """
    with body.at(body.given_nodes):
        return _normals(job, body)


def _normals(job: Job, body: Body) -> Floats:
    mesh, given_nodes = body.mesh, body.given_nodes
    planes = symmetry_planes(job, body, given_nodes, given_nodes)
    facets = exterior_facet_indices(mesh.topology)
    facets = facets[facets < mesh.topology.index_map(2).size_local]
    for name in [plane.region for plane in planes] + [name for name in body.regions if name == CUT]:
        facets = np.setdiff1d(facets, body.facets(name))
    sums = la.vector(mesh.geometry.index_map(), 3)
    if len(facets):
        nodes = entities_to_geometry(mesh, 2, facets)
        np.add.at(sums.array.reshape(-1, 3), nodes.ravel(), np.repeat(outer_facets(mesh, facets)[1], nodes.shape[1], 0))
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    normals = sums.array.reshape(-1, 3).copy()
    tolerance = _ROUND_OFF * diagonal(mesh.comm, given_nodes)
    for plane in planes:
        near = np.abs(given_nodes @ plane.normal - plane.position) <= tolerance
        normals[near] -= np.outer(normals[near] @ plane.normal, plane.normal)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0))
