"""Meshes of one body in a search: made by their generator, or refined from another mesh."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.job.job import Job
from hpcinv.job.mesh_generators import Resolution, is_generator, resolution_of
from hpcinv.mesh.body import Body, build_body, read_source
from hpcinv.mesh.cells import sub_entities, vertex_count
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.refine.degree import inner_dofs
from hpcinv.mesh.refine.refinement import refine
from hpcinv.mesh.source import Floats, Ints, MeshSource

MOST = 16  # largest refinement factor
# Distance of a node from a singular edge that counts as none, relative to its straight segment: curved ones are off it.
BESIDE = 0.02
FLAT = 1e-6  # rounding error of a generator: distance of a node from the middle of its edge, relative to the edge


@dataclass(frozen=True)
class Variant:
    """One mesh of the body.

    Attributes:
        resolution: parameters of the generator that differ from the job; empty for a refined mesh.
        given: the mesh, on rank 0, if it was refined from another one.
        size: of its cells, relative to the job's mesh; ``None`` if they were refined locally.
        origin: description of how it was made.
        ratio: least ratio of errors to the errors of the mesh that was refined locally, by singular edges; 0 of others.
    """

    resolution: Resolution
    given: MeshSource | None
    refined: bool
    size: float | None
    origin: str
    ratio: float = 0.0


class Meshes:
    """Maker of the meshes of a job; all methods are collective."""

    def __init__(self, job: Job, comm: MPI.Intracomm) -> None:
        self.job, self.comm = job, comm
        path, parameters = job.resolve(job.mesh.file), job.mesh.parameters
        self.resolution = on_root(
            comm, lambda: resolution_of(path, parameters) if is_generator(path) else Resolution({}, {})
        )
        self.first = Variant(self.resolution, None, False, 1.0, "as given")

    def curve(self) -> bool:
        """Put nodes of degree 2 on the surface in all further meshes, if the job leaves that open; return whether."""
        spec = self.job.mesh
        is_open = spec.geometry_degree is None and self.job.discretisation.displacement > 1
        if is_open:
            self.job = self.job.model_copy(update={"mesh": spec.model_copy(update={"geometry_degree": 2})})
        return is_open

    def build(self, variant: Variant) -> Body:
        return build_body(
            self.job_on(variant).mesh,
            self.job.regions,
            self.comm,
            resolve=self.job.resolve,
            degree=self.job.discretisation.displacement,
            replacement=variant.given,
        )

    def job_on(self, variant: Variant) -> Job:
        """Return the job with the parameters of a mesh."""
        parameters = {**self.job.mesh.parameters, **variant.resolution.parameters}
        return self.job.model_copy(update={"mesh": self.job.mesh.model_copy(update={"parameters": parameters})})

    def coarser(self) -> Variant | None:
        """Return the job's mesh with cells twice as large; ``None`` if no generator can make it."""
        coarse = self._generated(self.first, 0.5)
        return None if coarse.resolution == self.resolution else coarse

    def factors(self, variant: Variant) -> Sequence[float]:
        """Return the possible refinement factors of a mesh, ascending."""
        if variant.refined or not self.resolution.parameters:
            return [2.0**n for n in range(1, 5)]
        if divisions := variant.resolution.divisions:
            least = min(divisions.values())
            return [n / least for n in range(least + 1, MOST * least + 1)]
        return [1.25**n for n in range(1, 13)]

    def everywhere(self, variant: Variant, body: Body, factor: float) -> Variant:
        """Return the mesh with all cells smaller by one of the `factors`."""
        if not variant.refined and self.resolution.parameters:
            return self._generated(variant, factor)
        given, times = None, round(np.log2(factor))
        if self.comm.rank == 0:
            given = body.source
            for _ in range(times):
                given = source_of(given.body_kind).cut(given)
        size = None if variant.size is None else variant.size / factor
        parts = 2 ** (self.job.mesh.kind.dimension * times)
        return Variant(variant.resolution, given, True, size, f"each cell cut into {parts}")

    def halved_cells(
        self, variant: Variant, body: Body, levels: Ints, segments: Floats | None = None, ratio: float = 0.0
    ) -> Variant:
        """Return the mesh with each cell of the source halved ``levels`` times; ``levels`` is used on rank 0.

        Args:
            segments: singular edges (n, 2, 3) m; of cells that touch them, only the pieces that do are halved again.
            ratio: least ratio of errors that these edges allow.
        """
        given, marked = None, self.comm.bcast(int(np.count_nonzero(levels)))
        if self.comm.rank == 0:
            given = body.source
            graded = touching(given, segments)
            while levels.max(initial=0) > 0:
                refined = refine(given, np.flatnonzero(levels))
                given, levels = refined.source, np.maximum(levels - 1, 0)[refined.parent]
                here = touching(given, segments)
                levels[graded[refined.parent] & ~here] = 0
                graded = here
        return Variant(variant.resolution, given, True, None, f"refined in {marked} cells", ratio)

    def have_one_shape(self, body: Body) -> bool:
        """Return whether finer meshes have exactly the same geometry: flat faces only, or no generator."""
        if not self.resolution.parameters:
            return True

        def is_flat() -> bool:
            source = body.source
            if source.degree == 1:  # with degree 2 the generator puts nodes on the surface
                spec = self.job.mesh.model_copy(update={"geometry_degree": 2})
                source = read_source(spec, self.job.resolve(self.job.mesh.file))
            return is_straight(source)

        return on_root(self.comm, is_flat)

    def _generated(self, variant: Variant, factor: float) -> Variant:
        resolution = variant.resolution.finer(factor)
        assert variant.size is not None
        origin = ", ".join(f"{name} {value:.3g}" for name, value in resolution.parameters.items())
        return Variant(resolution, None, False, variant.size / factor, origin)


def is_straight(source: MeshSource) -> bool:
    """Return whether the edges of a mesh of degree 2 have their nodes in the middle."""
    ends = source.points[source.cells[:, sub_entities(source.kind, 1)]]
    middles = source.points[source.cells[:, inner_dofs(source.kind, 1)]]
    offset = np.linalg.norm(middles - ends.mean(axis=2), axis=2)
    return bool((offset <= FLAT * np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)).all())


def touching(source: MeshSource, segments: Floats | None) -> npt.NDArray[np.bool_]:
    """Return which cells have a vertex on one of the ``segments`` (n, 2, 3) m."""
    if segments is None or not len(segments):
        return np.zeros(len(source.cells), dtype=bool)
    vertices = source.cells[:, : vertex_count(source.kind)]
    is_on_segment = np.zeros(len(source.points), dtype=bool)
    for first, last in segments:
        chord = last - first
        length = np.linalg.norm(chord)
        candidates = np.flatnonzero((np.abs(source.points - (first + last) / 2) <= length).all(axis=1))
        offset = source.points[candidates] - first
        shares = np.clip(offset @ chord / length**2, 0, 1)
        is_on_segment[candidates] |= np.linalg.norm(offset - shares[:, None] * chord, axis=1) <= BESIDE * length
    return np.asarray(is_on_segment[vertices].any(axis=1))
