"""Regions that move as rigid bodies under a force and a moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcinv.job.job import Job
from hpcinv.job.support import RemoteLoad
from hpcinv.mesh.source import Floats, Group, MeshSource
from hpcinv.physics.kinematics.rigid_motion import rotation_vector
from hpcinv.studies.second_opinion.regions import group_of


@dataclass(frozen=True)
class RemoteRegion:
    """Facets that move as a rigid body.

    Attributes:
        point: reference point at rest (3,), m.
        force: at the point, N.
        moment: about the point, N m; both keep their direction in space.
        rotation: from rest to the loaded body, as a rotation vector (3,), rad.
    """

    place: str
    group: Group
    point: Floats
    force: Floats
    moment: Floats
    rotation: Floats

    @property
    def moment_by_components(self) -> Floats:
        """The moment (3,) that does the work of ``moment`` on changes of the components of the rotation vector, N m.

        A change ``δw`` of the vector is a spin ``T δw`` with ``T = I + (1 - cos θ)/θ² W + (θ - sin θ)/θ³ W²``.

        Source: Cardona & Géradin, Int. J. Numer. Meth. Engng 26, 2403 (1988), doi:10.1002/nme.1620261105.
        """
        angle = float(np.linalg.norm(self.rotation))
        if not angle:
            return self.moment
        axis = self.rotation / angle
        cross = np.cross(np.eye(3), axis)
        tangent = np.eye(3) + (1 - np.cos(angle)) / angle * cross + (1 - np.sin(angle) / angle) * cross @ cross
        moment: Floats = tangent.T @ self.moment
        return moment


def remote_region(
    rest: MeshSource, loaded: Floats, job: Job, remote: RemoteLoad, place: str, region: str
) -> RemoteRegion:
    """Return the region of a remote load, whose point is of the given body.

    Args:
        loaded: places of the nodes (n, 3), m.
    """
    group = group_of(rest, region)
    point, force, moment = (np.array(v, dtype=np.float64) for v in (remote.about, remote.force, remote.moment))
    nodes = np.unique(rest.facets[group.members])
    rotation, before, after = _rigid_motion(rest.points[nodes], loaded[nodes])
    if job.directions[0] == "inverse":
        point = before + rotation.T @ (point - after)
    return RemoteRegion(place, group, point, force, moment, rotation_vector(rotation))


def _rigid_motion(points: Floats, images: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the rotation (3, 3), and centres before and after it, that move points (n, 3) nearest to their images.

    Source: Kabsch, Acta Cryst. A32, 922 (1976), doi:10.1107/S0567739476001873.
    """
    before, after = points.mean(axis=0), images.mean(axis=0)
    left, _, right = np.linalg.svd((images - after).T @ (points - before))
    left[:, 2] *= np.linalg.det(left @ right)
    return left @ right, before, after
