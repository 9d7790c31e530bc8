"""Displacements that supports prescribe, by numbers of the job and by positions of nodes."""

from __future__ import annotations

from functools import partial

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.sensitivities import Parameter
from hpcinv.job.support import Support
from hpcinv.mesh.source import Floats
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.sensitivity.point_maps import PointMaps


class SupportRates:
    """Rates of the displacements (scaled) that supports prescribe, on the given mesh at full load; collective."""

    def __init__(self, equations: Equations, solution: Solution) -> None:
        self._equations, self._direction = equations, solution.direction
        self._supports, self._unknowns = equations.supports, equations.unknowns
        self._owned = self._unknowns.space.dofmap.index_map.size_local * self._unknowns.space.dofmap.index_map_bs

    def by_number(self, parameter: Parameter, by_held: Floats) -> float:
        """Return the derivative by a number of a support, from derivatives by the held local unknowns."""
        rates = self.rates(parameter)[: self._owned]
        return float(self._equations.body.mesh.comm.allreduce(float(by_held[: self._owned] @ rates), op=MPI.SUM))

    def rates(self, parameter: Parameter) -> Floats:
        """Return rates of the held local unknowns by a number of a support, zero at others."""
        owner = parameter.owner
        assert isinstance(owner, Support)
        number = self._equations.job.supports.index(owner)
        replaced = partial(owner.number_replaced, parameter.place)
        return self._on_state(self._supports.rates(number, replaced, parameter.value, self._direction))

    def by_nodes(self, by_held: Floats, maps: PointMaps) -> Floats:
        """Return the derivative (N, 3) by positions (m) of the mesh's nodes, from derivatives by held unknowns."""
        slopes = self._slopes()
        count = len(self._equations.body.source_geometry.x)
        if slopes is None:
            return np.zeros((maps.node_count, 3))
        held = by_held.copy()
        held[self._owned :] = 0.0
        dofs = self._unknowns.displacement_dofs_of_nodes
        at_points = np.zeros((len(dofs), 3))
        for axis, of_axis in enumerate(slopes):
            at_points[:, axis] = (held * of_axis)[dofs].sum(axis=1)
        return maps.summed(maps.positions.at_nodes(at_points[maps.positions.points], count))

    def along_nodes(self, moved: Floats, maps: PointMaps) -> Floats:
        """Return rates of the held local unknowns along rates (m) of the local nodes of the mesh, (n, 3)."""
        slopes, dofs = self._slopes(), self._unknowns.displacement_dofs_of_nodes
        rates = np.zeros(len(self._unknowns.state.x.array))
        if slopes is None:
            return rates
        positions = np.zeros((len(dofs), 3))
        positions[maps.positions.points] = maps.positions.at_points(moved)
        for axis, of_axis in enumerate(slopes):
            rates[dofs] += of_axis[dofs] * positions[:, axis, None]
        return rates

    def _slopes(self) -> list[Floats] | None:
        """Return derivatives of the held local unknowns (scaled) by each coordinate (m) of their points."""
        if not self._supports.prescribe_motion:
            return None
        return [self._on_state(self._supports.position_rates(axis, self._equations.job)) for axis in range(3)]

    def _on_state(self, rates: list[Floats]) -> Floats:
        values = np.zeros(len(self._unknowns.state.x.array))
        for entry, entry_rates in zip(self._supports.prescribed, rates, strict=True):
            values[entry.dofs] = entry_rates[entry.nodes]
        return values
