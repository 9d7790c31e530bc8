"""Remote loads of a job: a force and a moment on a region that moves as a rigid body, by a motion that is found."""

from __future__ import annotations

from typing import Annotated, Any

from hpcinv.quantity.parameter_paths import Number
from hpcinv.quantity.quantity import Length, Quantity, quantities_of
from hpcinv.quantity.schema import Faults, KeyPath, Spec, Triple


class RemoteLoad(Spec):
    """Force and moment on a region that moves as a rigid body, by an unknown motion.

    Both keep their direction in space.
    """

    force: Triple[Annotated[float, Quantity("N")]] = (0.0, 0.0, 0.0)
    """force on the region, along x, y and z, at the point 'about'"""
    moment: Triple[Annotated[float, Quantity("N m")]] = (0.0, 0.0, 0.0)
    """moment on the region about the point 'about', about x, y and z"""
    about: Triple[Length]
    """point in the given mesh, inside or outside of the body, which moves with the region"""

    def numbers(self) -> dict[KeyPath, Number | str]:
        """All numbers by place."""
        return {
            (name, i): Number(x, dimension)
            for name, dimension in quantities_of(type(self)).items()
            for i, x in enumerate(getattr(self, name))
        }


def unsuited_remote_loads(job: Any) -> Faults:
    """Faults of remote loads in a job, with their places in the job."""
    lists: list[tuple[KeyPath, Any]] = [(("supports",), job.supports)]
    lists += [(("states", number, "supports"), state.supports or ()) for number, state in enumerate(job.states)]
    places = [
        (*place, number, "remote")
        for place, supports in lists
        for number, support in enumerate(supports)
        if support.remote is not None
    ]
    if not places:
        return
    if job.states:
        yield places[0], "is not possible with 'states': give a traction"
    if job.mesh.shell is not None:
        yield places[0], "is not possible with a shell"
    remedy = "a remote load: give a 'motion', or a traction"
    if job.mesh.surface_error is not None:
        yield ("mesh", "surface_error"), f"is not possible with {remedy}"
    yield from unsuited_to_unknown_loads(job, remedy)


def unsuited_to_unknown_loads(job: Any, remedy: str) -> Faults:
    """Faults of sections of a job that are not possible where numbers of its loads or supports are unknown."""
    refused = {
        "load_cases": bool(job.load_cases),
        "method": job.method != "direct",
        "solver.continuation": job.solver.continuation == "series",
        "solver.nested_iteration": job.solver.nested_iteration == "on",
    }
    text = f"is not possible with {remedy}"
    yield from ((tuple(where.split(".")), text) for where, is_refused in refused.items() if is_refused)
    if job.accuracy:
        yield ("accuracy",), f"needs an estimate of the discretisation error, which {text}"
