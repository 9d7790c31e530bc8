"""Volumes of cavities of a body in both states."""

from __future__ import annotations

import math

import pytest
from helpers.thick_sphere import INNER, sphere
from helpers.verification import job

import hpcinv
from hpcinv.errors import JobError
from hpcinv.parallel.runtime import MPI

OCTANT = {"cavities": {"hole": {"surface": "inner", "lid": {"apex": [0, 0, 0]}}}}
VOLUMES = [{"name": over, "of": "volume", "cavity": "hole", "over": over} for over in ("reference", "current")]


@pytest.mark.parallel([1, 2])
def test_volumes_of_both_bodies(comm: MPI.Intracomm) -> None:
    data = dict(sphere(3, hexahedra=True).data) | OCTANT
    values = hpcinv.run(job(**data | {"quantities": [*data["quantities"], *VOLUMES]}), comm).quantities
    # The wall keeps its volume, and so does the difference of the radii's cubes; the mesh is curved, but not a sphere.
    assert values["current"] == pytest.approx(math.pi * INNER**3 / 6, rel=2e-4)
    assert values["reference"] == pytest.approx(math.pi * values["inner"] ** 3 / 6, rel=1e-3)


def test_unknown_cavities_are_refused() -> None:
    data = dict(sphere(1, hexahedra=True).data) | {"cavities": {"hole": {"surface": "iner"}}}
    with pytest.raises(JobError, match=r"there is no cavity 'hol'.*Did you mean 'hole'"):
        job(**data | {"quantities": [VOLUMES[0] | {"cavity": "hol"}]})
    with pytest.raises(JobError, match="cavity: is needed for a volume"):
        job(**data | {"quantities": [{"name": "v", "of": "volume"}]})
    with pytest.raises(JobError, match="exactly one of 'region' and 'apex'"):
        job(**data | {"cavities": {"hole": {"surface": "inner", "lid": {}}}})
