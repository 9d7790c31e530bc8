"""A rigid obstacle of a weak form at points: its distances, and where it is now."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.model.obstacle_passage import Passage, SurfacePoints
from hpcinv.model.parameters import present_value
from hpcinv.model.spaces import Unknowns
from hpcinv.model.surface_distance import SurfaceDistance
from hpcinv.physics.effects.contact import Contact
from hpcinv.physics.effects.obstacles import SurfaceObstacle


class ObstacleSurface:
    """The obstacle of one contact.

    Args:
        effect, load, par: the contact, its load factor and its quantities in the weak form.
        resolve: path of a file of the job.

    Attributes:
        effect: as given; a job of the same reuse group may replace it.
    """

    def __init__(
        self, effect: Contact, load: Any, par: Any, body: Body, resolve: Callable[[str], Path], comm: MPI.Intracomm
    ) -> None:
        self.effect, self._load, self._par = effect, load, par
        self._body, self._resolve, self._comm = body, resolve, comm

    @cached_property
    def triangles(self) -> SurfaceDistance | None:
        """Triangulated surface of the obstacle; ``None`` of other shapes. Collective at the first access."""
        obstacle = self.effect.obstacle
        if not isinstance(obstacle, SurfaceObstacle):
            return None
        return SurfaceDistance(self._resolve(obstacle.file), obstacle.unit, obstacle.flip, self._comm)

    def distances(self, points: Floats) -> tuple[Floats, Floats]:
        """Return signed distances (n,) of points (n, 3) from where 'obstacle' places it, and directions (n, 3) out."""
        if (triangles := self.triangles) is not None:
            length = self._body.length_scale
            gaps, directions = triangles(points * length)
            return gaps / length, directions
        numbers = {name: present_value(entry) for name, entry in self.effect.obstacle_entries(self._par).items()}
        columns = {name: n[:, None] if isinstance(n, np.ndarray) else n for name, n in numbers.items()}
        with np.errstate(all="ignore"):  # the direction is not determined in the middle
            gaps, directions = self.effect.obstacle.distance(points.T, SimpleNamespace(**columns))
        return gaps, np.broadcast_to(directions, points.T.shape).T

    @property
    def load(self) -> float:
        """Present load factor of the obstacle's travel."""
        return float(present_value(self._load))

    @property
    def travel(self) -> Floats:
        """Travel (3,) at full load, scaled."""
        travel: Floats = np.zeros(3) if self.effect.travel is None else present_value(self._par.travel)
        return travel

    def shift(self) -> Floats:
        """Return the present displacement (3,) of the obstacle of a forward solve, scaled."""
        return self.load * self.travel

    def passage(self, unknowns: Unknowns) -> Passage | None:
        """Return the ways of the region past the obstacle; ``None`` if it cannot be passed."""
        if not self.effect.obstacle.can_be_passed:
            return None
        size, bounds = self._size()
        points = SurfacePoints(self._body, self._body.boundary_facets(self.effect.region), unknowns, size)
        return Passage(points, self.distances, bounds, self.shift)

    def _size(self) -> tuple[float | None, tuple[Floats, Floats]]:
        """Return the half thickness of the obstacle, if it is known, and the corners of a box around it, scaled."""
        triangles, length = self.triangles, self._body.length_scale
        if triangles is None:
            radius = getattr(self._par, "obstacle_radius", None)
            return None if radius is None else present_value(radius), (np.full(3, -np.inf), np.full(3, np.inf))
        thickness, (low, high) = triangles.half_thickness, triangles.bounds
        return None if thickness is None else thickness / length, (low / length, high / length)
