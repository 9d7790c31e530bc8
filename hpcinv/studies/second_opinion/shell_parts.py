"""Parts of a job with a shell that elements of other programs do not have."""

from __future__ import annotations

from collections.abc import Iterator

from hpcinv.job.job import Job


def unwritten_of_shells(job: Job) -> Iterator[str]:
    """Yield what no deck of a shell says, with its places; nothing for a solid."""
    section = job.mesh.shell
    if section is None:
        return
    if section.layers:
        yield "mesh.shell.layers: only shells of one layer are written"
    if section.surface != "middle":
        yield f"mesh.shell.surface: '{section.surface}': only the middle is written"
    if len(job.laws) > 1:
        yield "material: a shell has one law in a deck"
    for number, support in enumerate(job.supports):
        if support.slides or support.remote is not None:
            yield f"supports[{number}]: slides and remote loads of shells are not written"
