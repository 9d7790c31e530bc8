"""What a job cannot have together.

One table says it: messages, the page of the documentation and a test of all pairs come from it. Each row names the part
of a job that a message blames, and by each other part the reason or remedy, which follows the place of the first one.
Parts without a row here meet each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpcinv.base.quantity.schema import Faults, KeyPath
from hpcinv.job.mesh_generators import is_generator
from hpcinv.job.owners import have_derivatives


@dataclass(frozen=True)
class Part:
    """A part of a job that not all others allow.

    Attributes:
        title: its name in the documentation.
        places: where a job has it; none if it does not.
        is_of_first_solve: whether only the first solve of the job has to allow it.
    """

    title: str
    places: Callable[[Any], Iterable[KeyPath]]
    is_of_first_solve: bool = False

    def first_place(self, job: Any) -> KeyPath | None:
        return next(iter(self.places(job)), None)


def _key(*place: str, test: Callable[[Any], object] = bool) -> Callable[[Any], Iterator[KeyPath]]:
    """Return the place of a section or setting, in jobs whose value passes a test: by default, that it is given."""

    def places(job: Any) -> Iterator[KeyPath]:
        value = job
        for key in place:
            value = getattr(value, key)
        if test(value):
            yield place

    return places


def _supports(job: Any, key: str) -> Iterator[KeyPath]:
    """Places of a key of supports, of the job or of a state."""
    lists: list[tuple[KeyPath, Any]] = [(("supports",), job.supports)]
    lists += [(("states", i, "supports"), state.supports or ()) for i, state in enumerate(job.states)]
    for place, supports in lists:
        yield from ((*place, i, key) for i, support in enumerate(supports) if getattr(support, key) is not None)


def _unknown_pressures(job: Any) -> Iterator[KeyPath]:
    yield from (("cavities", name) for name in job.controlled_cavities)
    yield from (("states", i, "volumes") for i, state in enumerate(job.states) if state.controlled)
    lists: list[tuple[KeyPath, Any]] = [(("effects",), job.effects)]
    lists += [(("states", i, "effects"), state.effects) for i, state in enumerate(job.states)]
    for place, effects in lists:
        yield from ((*place, i) for i, effect in enumerate(effects) if effect.is_unknown)


def _iterated_contact(job: Any) -> Iterator[KeyPath]:
    """Contacts of forward solves whose pressure or nearest points are found by iteration, and interfaces."""
    yield from (("interfaces", i) for i in range(len(job.interfaces)))
    for solve in job.plan:
        if solve.direction == "forward":
            effects = enumerate(solve.job.effects)
            yield from (("effects", i) for i, effect in effects if effect.is_paired or effect.functions(1))


def _friction(job: Any) -> Iterator[KeyPath]:
    yield from (("interfaces", i, "friction") for i, interface in enumerate(job.interfaces) if interface.friction)
    effects = enumerate(job.effects)
    yield from (("effects", i, "friction") for i, effect in effects if effect.is_paired and effect.friction)


def has_history(job: Any) -> bool:
    """Return whether the first solve has friction, whose slip depends on the load steps, and may take several."""
    solver = job.solver
    is_one_step = solver.strategy == "fixed" and solver.steps * job.case_count == 1
    return job.directions[0] == "forward" and not is_one_step and any(True for _ in _friction(job))


def _history(job: Any) -> Iterator[KeyPath]:
    yield from _friction(job) if has_history(job) else ()


def _paired_contact(job: Any) -> Iterator[KeyPath]:
    """Contacts with rigid obstacles with friction or a closure."""
    yield from (("effects", i) for i, effect in enumerate(job.effects) if effect.is_paired)
    for number, state in enumerate(job.states):
        yield from (("states", number, "effects", i) for i, effect in enumerate(state.effects) if effect.is_paired)


def _rigid_contact(job: Any) -> Iterator[KeyPath]:
    if not have_derivatives(job.effects, job.states):
        yield ("effects",)


def _sliding_supports(job: Any) -> Iterator[KeyPath]:
    yield from (("supports", i) for i, support in enumerate(job.supports) if support.slides)


def _solid_from_file(job: Any) -> Iterator[KeyPath]:
    if not job.mesh.kind.reads_surface and not is_generator(Path(job.mesh.file)):
        yield ("mesh", "file")


def _maximum_unknowns(job: Any) -> Iterator[KeyPath]:
    if "maximum_unknowns" in job.solver.model_fields_set:
        yield "solver", "maximum_unknowns"


def _partitioned(job: Any) -> Iterator[KeyPath]:
    if job.mesh.is_partitioned:
        yield ("mesh", "file")


def _observed_meshes(job: Any) -> Iterator[KeyPath]:
    for number, observation in enumerate(job.identify.observations if job.identify else ()):
        if observation.mesh:
            yield "identify", "observations", number, "mesh"


PARTS: Mapping[str, Part] = {
    "shell": Part("shell", _key("mesh", "shell")),
    "partitioned": Part("partitioned mesh", _partitioned),
    "mesh file": Part("solid from a mesh file", _solid_from_file),
    "surface error": Part("`mesh.surface_error`", _key("mesh", "surface_error")),
    "states": Part("`states`", _key("states")),
    "load cases": Part("`load_cases`", _key("load_cases")),
    "motion": Part("`motion` of a support", lambda job: _supports(job, "motion")),
    "remote loads": Part("remote loads", lambda job: _supports(job, "remote")),
    "unknown pressures": Part("cavities of unknown pressure", _unknown_pressures),
    "iterated contact": Part("contact by iteration", _iterated_contact),
    "rigid contact": Part("contact with a rigid obstacle", _rigid_contact),
    "interfaces": Part("`interfaces`", _key("interfaces")),
    "paired contact": Part("contact with a rigid obstacle, with `friction` or a `closure`", _paired_contact),
    "friction": Part("`friction`", _friction),
    "slip history": Part("`friction` over several load steps", _history),
    "sliding supports": Part("supports that slide", _sliding_supports),
    "high degree": Part(
        "`displacement` above 2", _key("discretisation", "displacement", test=lambda degree: degree > 2)
    ),
    "fixed point": Part("fixed-point methods", _key("method", test=lambda name: name != "direct")),
    "other strategies": Part(
        "strategies `fixed` and `arc-length`", _key("solver", "strategy", test=lambda name: name != "adaptive")
    ),
    "arc length": Part("`strategy: arc-length`", _key("solver", "strategy", test=lambda name: name == "arc-length")),
    "series": Part("`continuation: series`", _key("solver", "continuation", test=lambda name: name == "series")),
    "nested iteration": Part(
        "`nested_iteration: on`", _key("solver", "nested_iteration", test=lambda name: name == "on"), True
    ),
    "iterative": Part("`linear: iterative`", _key("solver", "linear", test=lambda name: name == "iterative")),
    "start": Part("`solver.start`", _key("solver", "start")),
    "start shape": Part("`solver.start_shape`", _key("solver", "start_shape")),
    "accuracy": Part("`accuracy`", _key("accuracy")),
    "one mesh": Part("one mesh, without `accuracy`", _key("accuracy", test=lambda demands: not demands)),
    "maximum unknowns": Part("`maximum_unknowns`", _maximum_unknowns),
    "expected shape": Part("`expected_shape`", _key("expected_shape")),
    "sensitivities": Part("`sensitivities`", _key("sensitivities")),
    "identify": Part("`identify`", _key("identify")),
    "observed meshes": Part("meshes of observations in `identify`", _observed_meshes),
}

_PRESSURE = "is not possible with a pressure or another number of a load that the solve finds: give it"
_FORWARD_PRESSURE = (
    "is not possible with a pressure or another number of a load that the solve finds: forward solves cannot determine"
    " it"
)
_FORWARD_LOAD = "is not possible with a remote load, whose reference point in the body of a forward solve is unknown"
_REMOTE = "is not possible with a remote load: give a 'motion', or a traction"
_NO_ESTIMATE = "needs an estimate of the discretisation error, which "
_DIRECT = "needs 'method: direct'"
_CONTACT = "is not possible with a contact whose pressure or nearest points are found by iteration"
_RIGID = (
    "not possible with contact with a rigid obstacle, whose pressure is found by iteration; give it the 'stiffness' of"
    " an elastic layer"
)


def _of_surfaces(are: str, need: str) -> dict[str, str]:
    """Return the reasons of interfaces, and of obstacles that take the part of one."""
    return {
        "partitioned": f"{are} not possible with a partitioned mesh: use its original file",
        "surface error": (
            f"{are} not possible with 'surface_error': its derivatives by the given nodes would move the facets that"
            " are searched for"
        ),
        "states": f"{are} not possible with 'states': give an 'analysis'",
        "unknown pressures": f"{are} {_PRESSURE.removeprefix('is ')}",
        "remote loads": f"{are} {_REMOTE.removeprefix('is ')}",
        "sliding supports": f"{are} not possible with supports that slide: hold axes ('fix: [x]') instead",
        "high degree": f"{need} 'displacement: 1' or 2",
        "fixed point": f"{need} {_DIRECT.removeprefix('needs ')}",
        "iterative": f"{are} too stiff for 'linear: iterative': leave it out",
        "accuracy": f"{are} not possible with 'accuracy', whose estimate does not see contact: choose the mesh",
        "identify": (
            f"{are} not possible with 'identify': derivatives hold the set of nodes in contact, which steps change"
        ),
    }


HISTORY = (
    "is not possible with derivatives, since its slip depends on the load steps: take one step ('strategy: fixed',"
    " 'steps: 1')"
)
_SOLID = ": leave that out, or mesh a solid"

REFUSED: Mapping[str, Mapping[str, str]] = {
    "shell": {
        "expected shape": f"is not possible together with expected_shape{_SOLID}",
        "observed meshes": f"is not possible together with meshes of observations{_SOLID}",
        "iterative": f"is not possible together with solver.linear{_SOLID}",
    },
    "remote loads": {
        "states": "is not possible with 'states': give a traction",
        "shell": "is not possible with a shell",
    },
    "interfaces": {"shell": "are not possible with a shell", **_of_surfaces("are", "need")},
    "paired contact": {
        **_of_surfaces("is", "needs"),
        "sensitivities": "is not possible with 'sensitivities', which do not follow a rigid obstacle",
    },
    "slip history": {"sensitivities": HISTORY},
    "friction": {
        "arc length": "is not possible with 'strategy: arc-length', which may return to smaller loads: leave it out"
    },
    "motion": {"states": "is not possible with 'states': give formulas as 'displacement'"},
    "surface error": {"remote loads": _REMOTE, "shell": "is not valid with a shell"},
    "fixed point": {"unknown pressures": _FORWARD_PRESSURE, "remote loads": _FORWARD_LOAD},
    "nested iteration": {
        "shell": "is not possible with a shell",
        "mesh file": (
            "needs a mesh that a generator makes (.py, .geo) by sizes of cells, since a mesh file has no coarser cells;"
            " leave it out"
        ),
        "other strategies": "needs 'strategy: adaptive': other strategies are chosen for the path that they take",
        "fixed point": _DIRECT,
        "accuracy": "cannot be combined with 'accuracy', whose search begins with the solution on the mesh before",
        "iterated contact": _CONTACT,
    },
    "start shape": {
        "start": "cannot be combined with 'start'",
        "partitioned": "is not possible with a partitioned mesh",
        "fixed point": _DIRECT,
        "accuracy": "cannot be combined with 'accuracy', which chooses another mesh",
        "iterated contact": _CONTACT,
    },
    "start": {
        "fixed point": _DIRECT,
        "accuracy": "cannot be combined with 'accuracy', which chooses another mesh",
        "iterated contact": _CONTACT,
    },
    "accuracy": {
        "unknown pressures": _NO_ESTIMATE + _PRESSURE,
        "remote loads": _NO_ESTIMATE + _REMOTE,
        "identify": "cannot be combined with 'identify', which needs one mesh for all evaluations",
        "states": "is not possible with 'states': find mesh and degree for the given state by itself",
        "expected shape": "cannot be combined with 'expected_shape', which needs the mesh of the job; remove one",
        "fixed point": _DIRECT,
        "partitioned": "needs a mesh that can be refined, not a partitioned one: use its original file",
    },
    "maximum unknowns": {"one mesh": "is not valid without 'accuracy', whose search it limits: add that, or remove it"},
    "sensitivities": {"rigid contact": f"are {_RIGID}"},
    "identify": {"rigid contact": f"is {_RIGID}"},
}
"""by the part that a message blames, then by the part that does not allow it"""


def refused_combinations(job: Any) -> Faults:
    """Faults of parts of a job that it cannot have together, with their places; the first of each part."""
    for name in REFUSED:
        place = PARTS[name].first_place(job)
        if place is not None and (text := refusal(job, name)):
            yield place, text


def refusal(job: Any, name: str) -> str:
    """Return the reason why a job cannot have a part; empty if its other parts allow it."""
    solved = job.plan[0].job if PARTS[name].is_of_first_solve else job
    reasons = (text for other, text in REFUSED[name].items() if PARTS[other].first_place(solved) is not None)
    return next(reasons, "")
