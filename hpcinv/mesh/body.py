"""The body: a distributed mesh with its regions, and the mapping back to the node order of its file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import dolfinx
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from hpcinv.base.files.names import exists
from hpcinv.base.mesh_formats import FORMATS
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.nondimensional import power_of_two
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import MeshError
from hpcinv.job.body_kinds import KINDS
from hpcinv.job.mesh_generators import converted_parameters
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.region_rules import RegionRule
from hpcinv.mesh.cell_count import MeshingMonitor, no_report
from hpcinv.mesh.cells import coordinate_element, kind_and_degree, scalar_element
from hpcinv.mesh.checks import CHUNK, check, check_nodes
from hpcinv.mesh.distributed.partition import Partition, partition_of, partitioner
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.extent import body_length, diagonal
from hpcinv.mesh.facet_groups import join_facets
from hpcinv.mesh.io.length_unit import check_unit
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.readers import GENERATORS
from hpcinv.mesh.regions import Mesh, Region, build_regions, find
from hpcinv.mesh.source import NO_CAD, FinerGeometry, Floats, Ints, MeshSource
from hpcinv.on_demand import on_demand

BODY = "body"
"""name of the region inside of one surface"""


@dataclass(frozen=True)
class Body:
    """A distributed body; the coordinates of ``mesh`` are divided by ``length_scale`` (m), a power of two.

    Straight cells have the nodes of curved ones if the displacement has a higher degree: so they can become the cells
    of the other body.

    Attributes:
        source: the mesh as it was read, whose cells may have fewer nodes than ``mesh``.
        source_geometry: nodes of the source's cells in the partition of ``mesh``, where they were read.
        given_nodes: coordinates of the local geometry nodes of ``mesh`` as it was given, (n, 3) in m; read-only.
    """

    mesh: Mesh
    length_scale: float
    regions: Mapping[str, Region]
    partition: Partition
    source: MeshSource
    source_geometry: dolfinx.mesh.Geometry
    read_finer_geometry: Callable[[], FinerGeometry] | None = None  # to be called on rank 0
    build_halved: Callable[[], Body] | None = None  # collective
    given_nodes: Floats = field(init=False)

    def __post_init__(self) -> None:
        nodes = self.nodes
        nodes.flags.writeable = False
        object.__setattr__(self, "given_nodes", nodes)

    @property
    def nodes(self) -> Floats:
        """Present coordinates of the local geometry nodes, (n, 3) in m."""
        return np.asarray(self.mesh.geometry.x * self.length_scale)

    def move_to(self, nodes: Floats) -> None:
        """Move the mesh; `DiscreteModel.put` does so, and nothing else writes its coordinates.

        Args:
            nodes: coordinates of the local geometry nodes, (n, 3) in m.
        """
        self.mesh.geometry.x[:] = nodes / self.length_scale

    @contextmanager
    def at(self, nodes: Floats) -> Iterator[None]:
        """Context in which the mesh is at ``nodes`` (as in `move_to`); afterwards it is where it was before."""
        before = self.mesh.geometry.x.copy()
        self.move_to(nodes)
        try:
            yield
        finally:
            self.mesh.geometry.x[:] = before

    @cached_property
    def true_geometry_body(self) -> tuple[Body | None, str]:
        """The same cells with the true geometry of the body, and why it is unknown, if it is; collective.

        It is the body itself if its geometry is the true one, and ``None`` if the true one is unknown. It is at the
        coordinates of the source, also if ``mesh`` has been moved since.
        """
        comm, geometries = self.mesh.comm, list[FinerGeometry]()

        def read_on_root() -> tuple[str, MeshSource | None]:
            read = self.read_finer_geometry or (lambda: FinerGeometry(NO_CAD))
            geometries.append(read())
            return geometries[0].unknown, geometries[0].source and geometries[0].source.header()

        unknown, header = on_root(comm, read_on_root)
        if unknown or header is None:
            return None if unknown else self, unknown
        source = geometries[0].source if geometries else header
        assert source is not None
        return replace_geometry(self, source), ""

    @cached_property
    def halved(self) -> Body:
        """The body with each cell of its file cut into cells of half the size; collective at the first access."""
        assert self.build_halved is not None
        return self.build_halved()

    @property
    def degree(self) -> int:
        """Degree of the geometry of ``mesh``."""
        return kind_and_degree(self.mesh)[1]

    def raise_degree(self, degree: int) -> Body:
        """The body with cells of at least this geometry degree, whose nodes are on the given cells; collective."""
        return self if self.degree >= degree else replace(self, mesh=_raised(self.mesh, degree))

    @cached_property
    def length(self) -> float:
        """Length of the body as it was given, in scaled units; collective at the first access."""
        return body_length(self.mesh, self.given_nodes / self.length_scale, self.source.kind, self.degree)

    @cached_property
    def computed(self) -> dict[str, Any]:
        """Results that depend on the shape of the mesh as its source has it, such as fibres by a rule, by key."""
        return {}

    def facets(self, name: str) -> LocalIndices:
        """Local facets of a region; raises ``MeshError`` on all ranks if the region does not exist or has no facets."""
        region = find(self.regions, name, self.source)
        if region.vertices is not None:
            advice = "Only supports hold vertices; a load needs facets of the boundary."
            raise MeshError(f"{self.source.path}: region '{name}' has vertices but no facets", advice)
        if not region.facet_count:
            advice = KINDS[self.source.body_kind].facets_remedy.format(name=name)
            raise MeshError(f"{self.source.path}: region '{name}' has cells but no facets", advice)
        return region.facets

    def held_entities(self, name: str) -> dict[int, LocalIndices]:
        """Local numbers of what a support holds, by dimension: facets, or vertices and edges; as `facets`."""
        region = find(self.regions, name, self.source)
        if region.vertices is None or region.edges is None:
            return {2: self.facets(name)}
        return {0: region.vertices, 1: region.edges}

    def held_facets(self, name: str) -> LocalIndices:
        """Local facets that a support holds, none of vertices; as `facets`."""
        return self.held_entities(name).get(2, np.zeros(0, dtype=np.int32))

    def boundary_facets(
        self, name: str, remedy: str = "A surface load needs a region of the boundary."
    ) -> LocalIndices:
        """Local facets of a region of the boundary; raises ``MeshError`` on all ranks if some are inside the body."""
        facets = self.facets(name)
        topology = self.mesh.topology
        inner_facets = np.setdiff1d(facets, dolfinx.mesh.exterior_facet_indices(topology))
        owned = np.count_nonzero(inner_facets < topology.index_map(2).size_local)
        if count := self.mesh.comm.allreduce(int(owned)):
            raise MeshError(
                f"{self.source.path}: region '{name}' has {count} facets inside the body",
                remedy,
            )
        return facets

    def cells(self, name: str) -> LocalIndices:
        """Local cells of a region; raises ``MeshError`` on all ranks if the region does not exist or has no cells."""
        region = find(self.regions, name, self.source)
        if not region.cell_count:
            raise MeshError(
                f"{self.source.path}: region '{name}' has facets but no cells",
                "Name a physical volume, or a geometric region that contains whole cells.",
            )
        return region.cells


def read_source(
    spec: MeshSpec, path: Path, report: Callable[[str], None] = no_report, size_factor: float = 1.0
) -> MeshSource:
    """Read or generate the mesh on this process, in metres and with the requested geometry degree; not collective.

    Args:
        report: called with the expected number of cells before a generator makes them.
        size_factor: factor of the cell sizes that a generator chooses.

    Raises:
        MeshError: the file is missing, unreadable or not a mesh.
    """
    if not exists(path):
        raise MeshError(f"{path}: no such file", "Paths of a job start from its directory.")
    try:
        source = _made_or_read(spec, path, report, size_factor)
    except OSError as exc:
        raise MeshError(f"{path}: {exc.strerror or exc}", "Is the file readable?") from exc
    check_nodes(source)
    of_kind = source_of(spec.kind.name)
    source = of_kind.oriented(source)
    for note in source.notes:
        report(note)
    source = _with_sets(source, spec, path).drop_unused_nodes()
    known, source = len(source.notes), of_kind.body(source, spec)
    for note in source.notes[known:]:
        report(note)
    source = join_facets(source)
    if spec.geometry_degree is not None:
        source = on_demand("cells of another degree")(source, spec.geometry_degree)
    if spec.interfaces:
        source = on_demand("doubled nodes")(source, spec.interfaces)
    return source


def _made_or_read(spec: MeshSpec, path: Path, report: Callable[[str], None], size_factor: float) -> MeshSource:
    """Return the mesh of a file in metres: generated by it, meshed from a geometry, or as it is."""
    if suffix_of(path) in GENERATORS:
        parameters = spec.parameters
        if suffix_of(path) == ".py" and spec.unit != 1.0:  # a .geo script with a unit has no parameters
            parameters = converted_parameters(path, parameters, spec.unit)
        monitor = MeshingMonitor(spec.maximum_cells, report)
        generate = GENERATORS[suffix_of(path)]
        is_surface = spec.kind.reads_surface
        source = generate(path, parameters, spec.geometry_degree, monitor, size_factor, is_surface=is_surface)
        source = source.convert_to_metres(spec.unit)
    elif spec.wall is not None:
        source = on_demand("mesh of a vessel")(path, spec, report)
    elif spec.is_cad:
        source = on_demand("mesh of a CAD file")(path, spec, report, size_factor)
    elif spec.size is None:
        source = read_mesh_file(spec, path)
    elif spec.is_surface:
        given = spec.surfaces.items()
        parts = {name: [sibling_path(path, spec.file, file) for file in files] for name, files in given}
        source = on_demand("mesh of surfaces")(parts or {BODY: [path]}, spec, report)
    else:
        source = on_demand("mesh of an image")(path, spec, report)
    return source


def read_mesh_file(spec: MeshSpec, path: Path) -> MeshSource:
    """Read a mesh file, of a shell its surface, in metres; not collective.

    Its coordinates are in the unit that it states, unless the mesh section has another one.
    """
    source = source_of(spec.kind.name).read(path, spec.array_labels)
    if suffix_of(path) in FORMATS and FORMATS[suffix_of(path)].is_partitioned:  # in metres
        return source
    if "unit" in spec.model_fields_set:
        check_unit(path, source.unit, spec.unit)
        return source.convert_to_metres(spec.unit)
    return source.convert_to_metres(source.unit or spec.unit)


def _with_sets(source: MeshSource, spec: MeshSpec, path: Path) -> MeshSource:
    """Return the mesh with the regions that a job makes of its arrays, and of surfaces in other files."""
    if spec.faces:
        faces = {n: [sibling_path(path, spec.file, f) for f in files] for n, files in spec.faces.items()}
        source = on_demand("regions in other files")(source, faces, source.unit or spec.unit)
    if spec.array_labels is not None:
        source = source_of(spec.kind.name).labelled(source, spec.array_labels)
        check_nodes(source)
    return source


def sibling_path(path: Path, file: str, other: str) -> Path:
    """Path of a file ``other`` that a job names, from the ``path`` of one that it names ``file``."""
    return Path(str(path).removesuffix(file)) / other if str(path).endswith(file) else path.parent / Path(other).name


def build_body(
    spec: MeshSpec,
    regions: Mapping[str, RegionRule],
    comm: MPI.Intracomm,
    *,
    resolve: Callable[[str], Path] = Path,
    degree: int = 1,
    replacement: MeshSource | None = None,
    report: Callable[[str], None] = no_report,
) -> Body:
    """Read the mesh on rank 0, check it, partition it, and build its regions; collective.

    A partitioned mesh is read by all ranks, and was checked when it was partitioned.

    Args:
        resolve: makes the path in the job one that can be opened.
        degree: of the displacement; cells of a lower degree get the nodes of that degree, at places of the given cells.
        replacement: on rank 0, a mesh to use instead of the file's, such as a refined one.
        report: called on rank 0 with the expected number of cells before a generator makes them.

    Raises:
        MeshError, SystemPartMissing: the same on every rank.
    """
    source = read_anywhere(spec, resolve, comm, replacement, report)
    if not source.is_partitioned:
        on_root(comm, lambda: check(source, may_be_cut=spec.may_be_cut))
    length_scale = power_of_two(diagonal(comm, source.points))  # so that scaling is exact in floating point
    method, destinations = partitioner(comm, source, spec.partition)
    mesh = dolfinx.mesh.create_mesh(
        comm,
        source.cells,
        coordinate_element(source.kind, source.degree),
        source.points / length_scale,
        destinations,
    )
    named = build_regions(mesh, source, regions, length_scale)
    finer = None if source.is_partitioned else lambda: read_finer_geometry(spec, resolve(spec.file), source)

    def build_halved() -> Body:
        cut = None if comm.rank else source_of(source.body_kind).cut(source)
        return build_body(spec, regions, comm, resolve=resolve, degree=degree, replacement=cut)

    body = Body(mesh, length_scale, named, partition_of(mesh, method), source, mesh.geometry, finer, build_halved)
    return body.raise_degree(degree)


def _raised(mesh: Mesh, degree: int) -> Mesh:
    """The same distributed cells with a geometry of a higher degree, whose nodes are on those cells; collective."""
    kind = mesh.basix_cell().name
    element = coordinate_element(kind, degree)
    space = fem.functionspace(mesh, element)
    nodes = la.vector(space.dofmap.index_map, 3)
    _transfer(kind, mesh.geometry.x, mesh.geometry, space.dofmap.list, degree, nodes.array.reshape(-1, 3))
    nodes.scatter_forward()  # so that ranks agree to the last digit
    numbers = space.dofmap.index_map.local_to_global(np.arange(len(nodes.array) // 3, dtype=np.int32))
    return _mesh_at_nodes(mesh, space.dofmap, element, nodes.array.reshape(-1, 3), numbers)


def _mesh_at_nodes(mesh: Mesh, dofmap: fem.DofMap, element: Any, nodes: Floats, numbers: Ints) -> Mesh:
    """A mesh with the topology of another one, and numbered nodes at the degrees of freedom of a space on that."""
    cells = fem.coordinate_element(element.basix_element)
    geometry = dolfinx.mesh.create_geometry(dofmap.index_map, dofmap.list, cells, nodes, numbers)
    whole = dolfinx.cpp.mesh.Mesh_float64(mesh.comm, mesh.topology._cpp_object, geometry._cpp_object)
    return dolfinx.mesh.Mesh(whole, ufl.Mesh(element))


def _transfer(
    kind: str, values: Floats, geometry: dolfinx.mesh.Geometry, nodes: Ints, degree: int, result: Floats
) -> None:
    """Set ``result`` at the ``nodes`` (cells, k) of cells of a degree, from values at the nodes of the same cells.

    If all nodes of a cell that matter at a place have one value, that place has exactly this value.
    """
    shapes: Floats = scalar_element(kind, geometry.cmaps[0].degree).tabulate(0, scalar_element(kind, degree).points)[
        0, :, :, 0
    ]
    shapes = np.where(np.abs(shapes - np.rint(shapes)) < 1e-13, np.rint(shapes), shapes)
    main = np.abs(shapes).argmax(axis=1)
    for start in range(0, len(nodes), CHUNK):
        nodal = values[geometry.dofmaps[0][start : start + CHUNK]]
        first = nodal[:, main]
        steps = np.einsum("pn,cpni->cpi", shapes, nodal[:, None] - first[:, :, None])
        result[nodes[start : start + CHUNK]] = first + steps


def read_finer_geometry(spec: MeshSpec, path: Path, source: MeshSource) -> FinerGeometry:
    """Geometry of higher degree that a mesh file or generator has for the cells of ``source``; not collective."""

    if suffix_of(path) in GENERATORS or spec.is_cad:
        finer: FinerGeometry = on_demand("geometry of a CAD surface")(source)
        return finer
    if spec.geometry_degree != 1 or spec.size is not None:  # of images and surfaces other cells are made
        return FinerGeometry(NO_CAD)
    of_file: FinerGeometry = on_demand("geometry of a mesh file")(
        source, lambda: read_source(spec.model_copy(update={"geometry_degree": None}), path)
    )
    return of_file


def read_anywhere(
    spec: MeshSpec,
    resolve: Callable[[str], Path],
    comm: MPI.Intracomm,
    replacement: MeshSource | None = None,
    report: Callable[[str], None] = no_report,
) -> MeshSource:
    """Read a mesh, or take its replacement: whole on rank 0, or some rows on each rank if partitioned; collective.

    Raises:
        MeshError, SystemPartMissing: the same on every rank.
    """
    if spec.is_partitioned:
        partitioned: MeshSource = on_demand("partitioned mesh")(on_root(comm, lambda: resolve(spec.file)), comm)
        return partitioned
    whole: list[MeshSource] = []

    def read_on_root() -> MeshSource:
        whole.append(replacement or read_source(spec, resolve(spec.file), report))
        return whole[0].header()

    header = on_root(comm, read_on_root)
    return whole[0] if whole else header


def reorder_to_source(body: Body, values: npt.NDArray[np.float64]) -> Floats:
    """Values at the nodes of this rank's source, from values (n, c) at the local geometry nodes; collective.

    Rank 0 gets all of them, or each rank some of them if the mesh is a partitioned one.
    """
    geometry = body.source_geometry
    owned = geometry.index_map().size_local
    rows = Rows.distributed(body.mesh.comm, len(body.source.points))
    return rows.deliver(source_node_values(body, values)[:owned], geometry.input_global_indices[:owned])


def whole_in_source_order(body: Body, values: Floats) -> Floats:
    """Values at all nodes of the source (N, c) on all ranks, from values at the local geometry nodes; collective."""
    comm = body.mesh.comm
    return np.concatenate(comm.allgather(reorder_to_source(body, values)))


def source_node_values(body: Body, values: Floats) -> Floats:
    """Values at the local nodes of the source's cells, from values at the local geometry nodes."""
    if body.degree == body.source.degree:
        return values
    geometry = body.source_geometry
    result = np.empty((len(geometry.x), values.shape[1]))
    _transfer(body.source.kind, values, body.mesh.geometry, geometry.dofmaps[0], body.source.degree, result)
    return result


def source_values(body: Body, values: Floats) -> Floats:
    """Values at the local nodes of the source's cells, from values (n, c) at this rank's rows of them; collective."""
    rows = Rows.distributed(body.mesh.comm, len(body.source.points))
    return rows.fetch(values, body.source_geometry.input_global_indices)


def local_node_values(body: Body, values: Floats) -> Floats:
    """Values at the local geometry nodes, from values (n, c) at the nodes of this rank's source; collective."""
    return values_on_cells(body, source_values(body, values))


def values_on_cells(body: Body, values: Floats) -> Floats:
    """Values at the local geometry nodes, from values (n, c) at the local nodes of the source's cells; collective."""
    if body.degree == body.source.degree:
        return values
    nodes = la.vector(body.mesh.geometry.index_map(), values.shape[1])
    there = nodes.array.reshape(-1, values.shape[1])
    _transfer(body.source.kind, values, body.source_geometry, body.mesh.geometry.dofmaps[0], body.degree, there)
    nodes.scatter_forward()
    return np.array(there)


def replace_geometry(body: Body, source: MeshSource) -> Body:
    """The body with the same distributed cells and the geometry of another source; collective.

    Spaces on both meshes number their unknowns alike, so that functions of one are functions of the other.
    """
    mesh, comm = body.mesh, body.mesh.comm
    element = coordinate_element(source.kind, source.degree)
    dofmap = fem.functionspace(mesh, element).dofmap
    nodes = np.empty(dofmap.index_map.size_local + dofmap.index_map.num_ghosts, dtype=np.int64)
    here = np.asarray(mesh.topology.original_cell_index)
    nodes[dofmap.list] = Rows.distributed(comm, len(source.cells)).fetch(source.cells, here)
    points = Rows.distributed(comm, len(source.points)).fetch(source.points, nodes)
    curved = _mesh_at_nodes(mesh, dofmap, element, points / body.length_scale, nodes)
    return replace(body, mesh=curved, source=source, source_geometry=curved.geometry, read_finer_geometry=None)
