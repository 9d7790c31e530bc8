"""Cavities of a job on a body."""

from hpcinv.errors import naming_field
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.mesh.enclosed_volume import EnclosedVolume


def enclosed_volume(job: Job, body: Body, name: str) -> EnclosedVolume:
    """Return a cavity of a job on a body, made once; collective.

    Raises:
        MeshError: on all ranks, if its regions do not enclose a cavity.
    """
    cavity = job.cavities[name]
    key = f"cavity {cavity!r}"
    if key not in body.computed:
        with naming_field(f"cavities.{name}"):
            body.computed[key] = EnclosedVolume(body, list(cavity.regions.values()), cavity.apex)
    enclosed: EnclosedVolume = body.computed[key]
    return enclosed


def check_cavities(job: Job, body: Body) -> None:
    """Check that the regions of all cavities of a job enclose cavities; collective.

    Raises:
        MeshError: on all ranks, if they do not.
    """
    for name in job.cavities:
        enclosed_volume(job, body, name)
