"""Coefficients of the residual along a path whose unknowns and load factor are power series.

With ``x(a) = Σ xₖ aᵏ`` and ``λ(a) = Σ λₖ aᵏ``, the coefficient of ``aᵏ`` of ``R(x(a), λ(a))`` is linear in ``xₖ`` and
``λₖ``. Gradients and integrals are linear, so that only the duals of test functions at quadrature points need Taylor
arithmetic (`hpcinv.model.assembly.taylor_code`): stresses, the volume equation, and loads that depend on the
displacement.
"""

from __future__ import annotations

import ctypes
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from hpcinv.base.parallel.c_code import NoLibrary, array_type, compile_library
from hpcinv.base.parallel.left_for_run import available
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.cells import jacobians, kind_and_degree, quadrature
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly import tangent_moduli
from hpcinv.model.assembly import taylor_code as code_writer
from hpcinv.model.assembly.element_matrices import directions_of, tabulated
from hpcinv.model.assembly.tangent_moduli import Slot, UnsupportedForm, slots_of, volume_parts
from hpcinv.model.assembly.taylor_arrays import TaylorArrays
from hpcinv.model.assembly.taylor_code import LANES, taylor_code
from hpcinv.model.spaces import Unknowns
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.points.integrands import Integrand, Sources
from hpcinv.physics.points.interpreter import PointKernel
from hpcinv.physics.points.point_scalars import PointScalars
from hpcinv.physics.points.program_files import Programs, digest, kept, kept_programs
from hpcinv.physics.points.scalar_graph import Node, NotAnalytic, ScalarGraph
from hpcinv.physics.points.slopes import coefficients
from hpcinv.physics.points.tables import Tables, facet_rule

_SOURCE = b"".join(Path(str(m.__file__)).read_bytes() for m in (tangent_moduli, code_writer, sys.modules[__name__]))
"""plans depend on the modules that make them"""
_SHARE = 0.4
"""Share of the available memory for coefficients of the unknowns, at nodes and at quadrature points. With more of them,
there are fewer orders, whose range is shorter; a larger share may leave too little memory for the factors."""
_LEAST = 8
"""Orders that are made however little memory there is. With fewer, a range is so short that load steps are cheaper."""
_VECTORS = 5  # copies of the coefficients at nodes, while the orthonormal basis of a series is made


class TaylorResidual:
    """Coefficients of the residual of a weak form, at a state and load; methods are collective.

    Args:
        weak_form: its residual without prescribed displacements, and with loads from the unloaded body on.

    Attributes:
        orders: number of orders for which there is memory; set by `begin`.
        order_bytes: memory that each of them takes on all ranks.

    Raises:
        NotAnalytic: on all ranks, if the residual has no Taylor series; the message names the reason.
    """

    def __init__(self, weak_form: WeakForm) -> None:
        self._unknowns, self._parameters = weak_form.unknowns, weak_form.parameters
        self.orders, self.order_bytes = 0, 0.0
        self._rates: list[float] = []
        self._parts: list[_KernelTerm] = []
        try:
            integrals = [*_volume(weak_form), *_surface(weak_form)]
            plans = _plans(integrals, weak_form)
        except UnsupportedForm as reason:
            raise NotAnalytic(str(reason)) from None
        for integral, plan in zip(integrals, plans, strict=True):
            if plan.outputs:
                kernel = _TaylorKernel(plan, integral, weak_form)
                for domain in integral.domains:
                    inputs = _inputs(integral, domain, weak_form) if plan.input_count else None
                    self._parts.append(_KernelTerm(kernel, inputs, domain, self._unknowns))

    def begin(self, orders: int, load: float) -> None:
        """Begin at the present state and position of the mesh, with room for coefficients up to an order.

        Where the coefficients of the unknowns take too much memory, `orders` are fewer.

        Args:
            load: the load factor that the weak form has.
        """
        comm = self._unknowns.mesh.comm
        vectors = _VECTORS * 8.0 * self._unknowns.state.x.petsc_vec.local_size
        self.order_bytes = comm.allreduce(vectors + sum(part.order_bytes for part in self._parts))
        self.orders = min(orders, max(math.floor(_SHARE * available(comm) / self.order_bytes), _LEAST))
        self._rates = self._parameters.path_rates(load)
        loads = [float(self._parameters.constant.value[i]) for i in self._parameters.path_entries]
        for part in self._parts:
            part.begin(self.orders + 1)
            part.put(0, self._unknowns.state.x.array, loads)

    def put(self, k: int, x: npt.NDArray[np.float64] | None, load: float) -> None:
        """Set the ``k``-th coefficients of the unknowns (local ones, ghosts included; ``None``: 0) and the load factor.

        Unknowns of lower order must be set, and assembled, before.
        """
        rates = [load * rate for rate in self._rates]
        for part in self._parts:
            part.put(k, x, rates)

    def assemble(self, k: int, b: PETSc.Vec) -> None:
        """Set ``b`` to the ``k``-th coefficient of the residual, without regard to supports.

        Unknowns of order ``k`` count as zero unless they are set; unknowns of order ``k - 1`` may have been set again.
        """
        with b.localForm() as local:
            local.set(0.0)
            for part in self._parts:
                part.add(part.sweep(k), local.array)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)


@dataclass(frozen=True)
class _Domain:
    """Cells, or cells with one of their facets, over which an integral goes.

    Attributes:
        entities: cells (n,), or pairs of cell and local facet (n, 2).
        points: quadrature points in coordinates of the reference cell, (points, 3).
        weights: their weights on the reference cell, or on the reference facet.
        normal: normal of the facet of the reference cell times its area, ``None`` for cells.
    """

    entities: LocalIndices
    points: Floats
    weights: Floats
    normal: Floats | None = None

    @property
    def cells(self) -> LocalIndices:
        return self.entities if self.normal is None else self.entities[:, 0]


@dataclass(frozen=True)
class _Integral:
    """An integrand and its domains; ``key`` differs from the keys of the others of its form."""

    key: bytes
    integrand: Any
    domains: list[_Domain]

    @property
    def points(self) -> bytes:
        """Bytes of all quadrature points, for a description."""
        return b"".join(domain.points.tobytes() for domain in self.domains)


def _volume(weak_form: WeakForm) -> Iterator[_Integral]:
    degree, parts = volume_parts(weak_form.residual, weak_form.unknowns)
    mesh = weak_form.unknowns.mesh
    points, weights = quadrature(mesh.basix_cell().name, degree)
    owned = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    for number, part in enumerate(parts):
        cells = owned if part.cells is None else part.cells[part.cells < len(owned)]
        yield _Integral(b"part %d" % number, part.integrand, [_Domain(cells, points, weights)])


def _surface(weak_form: WeakForm) -> Iterator[_Integral]:
    """Yield the integrals over regions of the boundary, by region and quadrature degree."""
    kind = weak_form.unknowns.mesh.basix_cell().name
    integrands: dict[tuple[int, int], Any] = {}
    entities: dict[int, LocalIndices] = {}
    for integral in weak_form.residual.integrals():
        if integral.integral_type() == "cell":
            continue
        degree, region = integral.metadata().get("quadrature_degree"), integral.subdomain_id()
        if integral.integral_type() != "exterior_facet" or not isinstance(degree, int) or not isinstance(region, int):
            raise UnsupportedForm("it has an integral that is neither over cells nor over a region of the boundary")
        entities[region] = np.asarray(dict(integral.subdomain_data())[region], dtype=np.int32).reshape(-1, 2)
        key = region, degree
        integrands[key] = integrands[key] + integral.integrand() if key in integrands else integral.integrand()
    for (region, degree), integrand in integrands.items():
        points, weights, normals = facet_rule(kind, {"quadrature_degree": degree})
        local = entities[region][:, 1]
        domains = [
            _Domain(entities[region][local == number], points[number], weights, normal)
            for number, normal in enumerate(normals)
        ]
        yield _Integral(b"region %d, degree %d" % (region, degree), integrand, domains)


@dataclass(frozen=True)
class _Plan:
    """Taylor arithmetic of the duals of test functions in an integral, as it is recorded.

    Attributes:
        outputs: slots of the test functions.
        leaves: slots of the unknowns on which the duals depend.
        cases: load cases on whose factors they depend, or numbers among the entries that change along the path.
        text: C code (`taylor_code`).
        kept, choices: sizes of its arrays.
        input_count: number of inputs.
    """

    outputs: tuple[Slot, ...]
    leaves: tuple[Slot, ...] = ()
    cases: tuple[int, ...] = ()
    text: str = ""
    kept: int = 0
    choices: int = 0
    input_count: int = 0

    @classmethod
    def from_data(cls, data: Any) -> _Plan:
        outputs, leaves, *rest = data
        return cls(tuple(Slot(*slot) for slot in outputs), tuple(Slot(*slot) for slot in leaves), *rest)


def _plans(integrals: Sequence[_Integral], weak_form: WeakForm) -> list[_Plan]:
    """Return the plans of integrals, from the cache or made on rank 0; collective.

    The reason why there is no Taylor series is kept too.
    """

    def make() -> bytes:
        try:
            plans = [astuple(_derived(integral.integrand, weak_form).plan()) for integral in integrals]
        except NotAnalytic as reason:
            return json.dumps(str(reason)).encode()
        return json.dumps(plans).encode()

    description = _description(weak_form) + b"".join(integral.points for integral in integrals)
    name = f"taylor_{digest(_SOURCE + description)}.json"
    data = kept(weak_form.unknowns.mesh.comm, name, make, json.loads)
    if isinstance(data, str):
        raise NotAnalytic(data)
    return [_Plan.from_data(entry) for entry in data]


def _description(weak_form: WeakForm) -> bytes:
    """Return a text of all on which the derivation depends except the quadrature points."""
    functions, constants, parameters = (
        weak_form.residual.coefficients(),
        weak_form.residual.constants(),
        weak_form.parameters,
    )
    numbers = functions.index(weak_form.unknowns.state), parameters.path_entries
    place = constants.index(parameters.constant) if parameters.constant in constants else None
    return f"{weak_form.residual.signature()} {numbers} {place}".encode()


def _inputs(integral: _Integral, domain: _Domain, weak_form: WeakForm) -> PointKernel:
    """Return what evaluates the inputs of an integral at the quadrature points of a domain; collective."""
    mesh, functions, constants = (
        weak_form.unknowns.mesh,
        weak_form.residual.coefficients(),
        weak_form.residual.constants(),
    )
    normals = None if domain.normal is None else domain.normal[None]

    def make() -> Programs:
        duals, sources = _derived(integral.integrand, weak_form), Sources(functions, constants)
        maker = Integrand(mesh.ufl_domain(), Tables(domain.points, normals=normals), sources, duals.graph)
        return Programs.of_expression(maker.values(duals.inputs), sources.used)

    description = b"inputs " + _description(weak_form) + domain.points.tobytes() + integral.key
    kept = kept_programs(mesh.comm, description, make)
    return PointKernel(kept, functions, constants)


@dataclass(frozen=True)
class _Duals:
    """Duals of test functions in an integrand, as a graph.

    Attributes:
        graph: of the integrand.
        nodes: the duals.
        reduced: graph with the same nodes, which has what does not depend on the unknowns as inputs.
        inputs: nodes of the first graph that are inputs of the second.
        outputs, leaves, cases: as in a plan.
    """

    graph: ScalarGraph
    nodes: list[Node]
    reduced: ScalarGraph
    inputs: list[Node]
    outputs: tuple[Slot, ...]
    leaves: tuple[Slot, ...]
    cases: tuple[int, ...]

    def plan(self) -> _Plan:
        code = taylor_code(self.reduced, _leaf_count(self.leaves, self.cases), self.nodes)
        return _Plan(self.outputs, self.leaves, self.cases, code.text, code.kept, code.choices, len(self.inputs))


def _leaf_count(leaves: Sequence[Slot], cases: Sequence[int]) -> int:
    return sum(math.prod(slot.shape) for slot in leaves) + len(cases)


def _derived(integrand: Any, weak_form: WeakForm) -> _Duals:
    """Derive the duals of an integrand; raise ``NotAnalytic`` if they have no Taylor series."""
    state, parameters = weak_form.unknowns.state, weak_form.parameters
    entries = [(parameters.constant, i) for i in parameters.path_entries]
    graph = ScalarGraph()
    scalars = PointScalars(graph, (state,), entries)
    (root,) = scalars.of(integrand)
    outputs = _duals(scalars, graph, root, weak_form.unknowns)
    nodes = [node for own in outputs.values() for node in own]
    needed = {graph.operations[node][1] for node in graph.needed(nodes) if graph.operations[node][0] == "leaf"}
    slots = [slot for slot in slots_of(weak_form.unknowns.parts) if needed.intersection(_keys(slot, state))]
    loads = [number for number, entry in enumerate(entries) if ("constant", *entry) in needed]
    keys = [*(key for slot in slots for key in _keys(slot, state)), *(("constant", *entries[i]) for i in loads)]
    reduced, inputs = graph.cut(nodes, {key: number for number, key in enumerate(keys)})
    return _Duals(graph, nodes, reduced, inputs, tuple(outputs), tuple(slots), tuple(loads))


def _duals(scalars: PointScalars, graph: ScalarGraph, root: Node, unknowns: Unknowns) -> dict[Slot, list[Node]]:
    """Return the duals of the test functions in an integrand, by the slots that it has."""
    slots = slots_of(unknowns.parts)
    tests = [scalars.function(unknowns.test, *member) for slot in slots for member in slot.members]
    duals = iter(coefficients(graph, root, graph.number(1.0), tests))
    outputs = {slot: [next(duals) for _ in slot.members] for slot in slots}
    return {
        slot: [graph.number(0.0) if dual is None else dual for dual in own]
        for slot, own in outputs.items()
        if any(dual is not None for dual in own)
    }


def _keys(slot: Slot, state: Any) -> list[Any]:
    """Return the names of the unknowns of a slot among the leaves of a graph."""
    return [("function", state, *member) for member in slot.members]


class _CompiledTaylor:
    """Taylor arithmetic of duals in C; collective.

    Raises:
        NoLibrary: on all ranks.
    """

    kept = ()
    """nodes with coefficients at all points: a block's fit in the cache"""

    def __init__(self, plan: _Plan, outputs: int, comm: MPI.Intracomm) -> None:
        self.plan, self.outputs = plan, outputs
        self.library = compile_library(comm, plan.text)
        doubles, masks = array_type(np.float64), array_type(np.int64)
        self.library.sweep.argtypes = [ctypes.c_int64, *2 * [ctypes.c_int], *3 * [doubles], masks, doubles]

    def begin(self, blocks: int, stored: int) -> _CompiledSeries:
        return _CompiledSeries(self, blocks, stored)


class _CompiledSeries:
    """Coefficients of duals in C."""

    def __init__(self, taylor: _CompiledTaylor, blocks: int, stored: int) -> None:
        self._library, self._stored = taylor.library, stored
        self._kept = np.empty((taylor.plan.kept, stored, LANES))
        self._choices = np.empty((taylor.plan.choices, LANES), dtype=np.int64)
        self._results = np.empty((blocks, taylor.outputs, LANES))

    def sweep(self, order: int, leaves: Floats, inputs: Floats) -> Floats:
        """Return the coefficients of an order of the outputs, (blocks, outputs, lanes)."""
        arrays = leaves, inputs, self._kept, self._choices, self._results
        self._library.sweep(len(leaves), self._stored, order, *arrays)
        return self._results


class _TaylorKernel:
    """Taylor arithmetic of duals: in C, or in NumPy where there is no compiler; collective."""

    def __init__(self, plan: _Plan, integral: _Integral, weak_form: WeakForm) -> None:
        self.plan = plan
        self.leaves = _leaf_count(plan.leaves, plan.cases)
        self.outputs = sum(math.prod(slot.shape) for slot in plan.outputs)
        self.arithmetic: _CompiledTaylor | TaylorArrays
        try:
            self.arithmetic = _CompiledTaylor(plan, self.outputs, weak_form.unknowns.mesh.comm)
        except NoLibrary:
            duals = _derived(integral.integrand, weak_form)
            self.arithmetic = TaylorArrays(duals.reduced, duals.nodes)


class _KernelTerm:
    """What one kernel adds to coefficients of the residual on one domain.

    Args:
        inputs: evaluates the inputs at quadrature points, ``None`` if there are none.
    """

    def __init__(self, kernel: _TaylorKernel, inputs: PointKernel | None, domain: _Domain, unknowns: Unknowns) -> None:
        self._kernel, self._input_kernel, self._domain, self._mesh = kernel, inputs, domain, unknowns.mesh
        self._dofs = [dofs[domain.cells] for dofs in unknowns.dofs_of_cells()]
        self._tables = [tabulated(element, domain.points) for element in unknowns.scalar_elements]
        self._count = len(domain.cells) * len(domain.points)
        self._blocks = -(-self._count // LANES)

    @property
    def order_bytes(self) -> float:
        """Memory of the coefficients that are kept at quadrature points, for one order."""
        return 8.0 * LANES * self._blocks * (self._kernel.leaves + len(self._kernel.arithmetic.kept))

    def begin(self, stored: int) -> None:
        """Evaluate inputs and the geometry of the cells, and make room for coefficients of the unknowns."""
        kernel, domain = self._kernel, self._domain
        kind, degree = kind_and_degree(self._mesh)
        nodes = self._mesh.geometry.x[self._mesh.geometry.dofmaps[0][domain.cells]]
        to_mesh = jacobians(kind, degree, nodes, domain.points)
        volumes = np.abs(np.linalg.det(to_mesh))
        if domain.normal is not None:  # Nanson's formula
            volumes = volumes * np.linalg.norm(domain.normal @ np.linalg.inv(to_mesh), axis=-1)
        self._weights = (domain.weights * volumes)[..., None]
        self._series = kernel.arithmetic.begin(self._blocks, stored)
        self._leaves = np.zeros((self._blocks, kernel.leaves, stored, LANES))
        self._inputs = np.zeros((self._blocks, kernel.plan.input_count, LANES))
        if self._input_kernel is not None and self._count:
            self._inputs[:] = self._in_lanes(self._input_kernel.eval(self._mesh, domain.cells))

    def put(self, k: int, x: npt.NDArray[np.float64] | None, loads: list[float]) -> None:
        if not self._count:
            return
        at, plan = 0, self._kernel.plan
        for slot in plan.leaves:
            size = math.prod(slot.shape)
            values: Any = 0.0 if x is None else self._in_lanes(self._at_points(slot, x))
            self._leaves[:, at : at + size, k] = values
            at += size
        for case in plan.cases:
            self._leaves[:, at, k] = loads[case]
            at += 1

    def sweep(self, k: int) -> Floats:
        """Return the ``k``-th coefficients of the duals times weights, (cells, points, components of all slots)."""
        results = self._series.sweep(k, self._leaves, self._inputs)
        points = results.transpose(0, 2, 1).reshape(-1, self._kernel.outputs)[: self._count]
        duals: Floats = points.reshape(*self._weights.shape[:2], self._kernel.outputs) * self._weights
        return duals

    def add(self, duals: Floats, b: npt.NDArray[np.float64]) -> None:
        """Add the integrals of duals times test functions to ``b``, at the local unknowns."""
        at = 0
        for slot in self._kernel.plan.outputs if self._count else ():
            size = math.prod(slot.shape)
            values = duals[..., at : at + size].reshape(*duals.shape[:2], slot.components, -1)
            table = self._tables[slot.part][directions_of(slot)]  # (directions, points, nodes)
            nodal = np.tensordot(values, table, axes=((3, 1), (0, 1)))  # (cells, components, nodes)
            dofs = self._dofs[slot.part].transpose(0, 2, 1)
            b += np.bincount(dofs.ravel(), nodal.ravel(), minlength=len(b))
            at += size

    def _at_points(self, slot: Slot, x: npt.NDArray[np.float64]) -> Floats:
        """Return values of unknowns, or gradients by reference coordinates, (cells, points, components of the slot)."""
        table = self._tables[slot.part][directions_of(slot)]
        nodal = x[self._dofs[slot.part]]  # (cells, nodes, components)
        values = np.tensordot(nodal, table, axes=(1, 2)).transpose(
            0, 3, 1, 2
        )  # (cells, points, components, directions)
        return values.reshape(*values.shape[:2], -1)

    def _in_lanes(self, values: Floats) -> Floats:
        """Return values (cells, points, n) as (blocks, n, lanes); the last block is filled up with the first points."""
        flat = values.reshape(self._count, -1)
        padded = flat[np.arange(self._blocks * LANES) % self._count]
        return padded.reshape(self._blocks, LANES, -1).transpose(0, 2, 1)
