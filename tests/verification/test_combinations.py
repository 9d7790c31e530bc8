"""Each two parts of a job on a few cells: they are refused with the sentence of the table, or they solve.

A part that says only how to solve does not change the shape.
"""

from __future__ import annotations

import itertools
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.sheets import save_sheet
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError
from hpcinv.job import combinations
from hpcinv.job.combinations import PARTS, REFUSED
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import Start
from hpcinv.solver.observer import SILENT

CLAMP = {"region": "x0", "fix": ["x", "y", "z"]}
PULL = {"effect": "traction", "region": "x1", "traction": [0.05, 0.0, 0.02], "area_in": "reference"}
LIDDED = {"surface": "y1", "lid": {"apex": [0.5, 3.0, 0.5]}, "unloaded_volume": 0.68}
BASE: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": box((2, 1, 1), hexahedra=True),
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "effects": [PULL],
    "supports": [CLAMP],
    "solver": {"tolerance": 1e-10},
    "quantities": [{"name": "end", "of": "norm(ux, uy, uz)", "on": "x1", "reduce": "mean"}],
    "certificate": {"estimate": False, "overlap": False, "round_trip": "off", "stability": False},
}

type Data = dict[str, Any]


def _with(**changes: Any) -> Callable[[Data, Path], Data]:
    return lambda data, _: data | changes


def _solver(**changes: Any) -> Callable[[Data, Path], Data]:
    return lambda data, _: data | {"solver": data["solver"] | changes}


def _shell(data: Data, directory: Path) -> Data:
    file = save_sheet(directory / "sheet.msh", 2, 1, lambda s, t: np.column_stack([s, 0.3 * s * (1 - s), t]))
    weak = {**PULL, "traction": [0.01, 0.0, 0.002]}
    return data | {"mesh": {"file": str(file), "shell": {"thickness": 0.1}}, "effects": [weak]}


def _mesh_file(data: Data, directory: Path) -> Data:
    file = directory.parent / "unloaded" / "shape.msh"  # shared by the tests of a process
    if not file.exists():
        hpcinv.run(job(**BASE | {"effects": []}), MPI.COMM_SELF, directory=file.parent)
    return data | {"mesh": {"file": str(file)}}


def _in_states(data: Data, _: Path) -> Data:
    contacts = [effect for effect in data["effects"] if effect["effect"] == "contact"]
    given = {"name": "given", "given": True, "effects": [PULL]}
    kept = {key: value for key, value in data.items() if key not in ("analysis", "first", "effects")}
    if "cavities" in data:
        hole = {key: data["cavities"]["hole"][key] for key in ("surface", "lid")}
        kept |= {"cavities": {"hole": hole}}
        given |= {"unloaded_volumes": {"hole": LIDDED["unloaded_volume"]}}
    if "accuracy" in data:
        kept |= {"accuracy": {"end-given": 1.0}}
    if "identify" in data:
        kept |= _seen("end-given")
    for contact in contacts:  # the body at rest is lower than the given one
        contact["obstacle"]["point"] = [0, 0, -0.05]
    other = {"name": "other", "effects": [{**PULL, "traction": [0.0, 0.01, -0.06]}, *contacts]}
    return kept | {"states": [given, {"name": "rest"}, other]}


def _remote(data: Data, _: Path) -> Data:
    load = {"about": [1.0, 0.5, 0.5], "force": [0.05, 0.0, -0.01]}
    return data | {"supports": [*data["supports"], {"region": "x1", "remote": load}], "effects": []}


def _begin_at_a_shape(data: Data, directory: Path) -> Data:
    """Begin at the shape for half of the traction."""
    half = [e | {"traction": [0.5 * t for t in e["traction"]]} for e in data["effects"] if "traction" in e]
    kept = {key: value for key, value in data.items() if key not in ("accuracy", "cavities", "identify", "load_cases")}
    posed = job(**kept | {"supports": [CLAMP], "effects": half})
    if not (directory / "start").exists():
        hpcinv.run(posed, MPI.COMM_SELF, directory=directory / "start")
    return data | {"solver": data["solver"] | {"start_shape": str(directory / "start" / "shape.msh")}}


def _lidded(data: Data, _: Path) -> Data:
    surface = {"surface": "outer", "lid": {"apex": [0.5, -3.0, 0.5]}} if "shell" in data["mesh"] else {}
    return data | {"cavities": {"hole": LIDDED | surface}}


def _on_a_plate(data: Data, _: Path) -> Data:
    plate = {"shape": "plane", "point": [0, 0, -0.02], "normal": [0, 0, 1]}
    push = {**PULL, "traction": [0.0, 0.0, -0.01 if data["analysis"] == "forward" else -0.03]}
    region = "inner" if "shell" in data["mesh"] else "z0"
    effects = [push, {"effect": "contact", "region": region, "obstacle": plate}]
    changed: Data = {"effects": effects}
    if data["analysis"] == "inverse":
        changed |= {"analysis": "round_trip", "first": "forward"}
    if "cavities" in data:
        hole = {key: value for key, value in data["cavities"]["hole"].items() if key != "unloaded_volume"}
        changed |= {"cavities": {"hole": hole | {"volume": 0.7}}}
    return data | changed


def _on_a_rough_plate(data: Data, _: Path) -> Data:
    plate = {"shape": "plane", "point": [0, -0.02, 0], "normal": [0, 1, 0]}
    contacts = [effect for effect in data["effects"] if effect["effect"] == "contact"]
    region = "inner" if "shell" in data["mesh"] else "y0"
    push = {**PULL, "traction": [0.0, -0.01, -0.01 if contacts else 0.0]}
    rough = {"effect": "contact", "region": region, "obstacle": plate, "friction": 0.3}
    kept = {key: value for key, value in data.items() if key != "first"}
    return kept | {"effects": [push, *contacts, rough], "analysis": "forward"}


def _in_two_blocks(data: Data, _: Path) -> Data:
    file = {} if "shell" in data["mesh"] else {"file": "../meshes/two_blocks.py", "parameters": {"hexahedra": True}}
    return data | {"mesh": data["mesh"] | file, "interfaces": [{"between": ["bottom", "top"], "kind": "tied"}]}


def _rubbing(data: Data, directory: Path) -> Data:
    blocks = _in_two_blocks(data, directory)
    pressed = {"between": ["bottom", "top"], "kind": "contact", "friction": 0.3}
    return blocks | {"interfaces": [pressed], "analysis": "forward"}


def _sliding(data: Data, _: Path) -> Data:
    if any("remote" in support for support in data["supports"]):  # its region shares nodes with all sides
        return data | {"supports": [{"region": "x0", "fix": ["normal", "y", "z"]}, *data["supports"][1:]]}
    region = "inner" if "shell" in data["mesh"] else "y0"
    return data | {"supports": [*data["supports"], {"region": region, "fix": ["normal"]}]}


def _seen(quantity: str) -> Data:
    seen = [{"name": "seen", "quantity": quantity, "value": 0.1, "sd": 1e-3}]
    return {"identify": {"parameters": {"material.mu": None}, "observations": seen}}


CHANGES: dict[str, Callable[[Data, Path], Data]] = {
    "shell": _shell,
    "mesh file": _mesh_file,
    "surface error": lambda data, _: data | {"mesh": data["mesh"] | {"surface_error": {"sd": 1e-3}}},
    "motion": _with(supports=[{"region": "x0", "motion": {"move": [0.05, 0.0, 0.0]}}]),
    "remote loads": _remote,
    "unknown pressures": _lidded,
    "interfaces": _in_two_blocks,
    "friction": _rubbing,
    "sliding supports": _sliding,
    "high degree": lambda data, _: data | {"discretisation": {"displacement": 3}},
    "rigid contact": _on_a_plate,
    "paired contact": _on_a_rough_plate,
    "load cases": _with(load_cases=["first", "second"]),
    # By default 1e-10: a shell is so stiff along its surface that the residual of that is 1e-7 of the load.
    "fixed point": _with(method="anderson", fixed_point={"tolerance": 1e-12}),
    "other strategies": _solver(strategy="arc-length"),
    "series": _solver(continuation="series"),
    "nested iteration": _solver(nested_iteration="on"),
    "start shape": _begin_at_a_shape,
    "iterative": _solver(linear="iterative"),
    "sensitivities": _with(sensitivities={"material.mu": {}}),
    "accuracy": _with(accuracy={"end": 1.0}),
    "identify": _with(**_seen("end")),
    "states": _in_states,  # last: it moves the effects of the others
}
ONLY_READ = {"accuracy", "identify"}
"""parts that take another command, or many solves"""
HOW = {
    "fixed point",
    "other strategies",
    "series",
    "nested iteration",
    "start shape",
    "iterative",
    "sensitivities",
    "load cases",
}
"""parts that change no shape"""
PAIRS = list(itertools.combinations(CHANGES, 2))
BY_SCHEMA = {
    ("other strategies", "series"): "is not valid with 'strategy: arc-length'",
    ("shell", "high degree"): "must be 2 in a shell",
}
"""pairs that a section or the kind of the body refuses"""
IMPLIED = {
    "interfaces": {"iterated contact"},
    "friction": {"interfaces", "iterated contact", "slip history"},
    "rigid contact": {"iterated contact"},
    "paired contact": {"iterated contact", "friction"},
    "other strategies": {"arc length"},
}
"""further parts of the table that a part has"""
MENDED = itertools.product(("unknown pressures", "remote loads"), ("rigid contact", "start shape"))
"""pairs that once lost the contact pressures of a solution, or were refused"""
REFUSALS = {
    ("interfaces", "sliding supports"),
    ("interfaces", "high degree"),
    ("friction", "other strategies"),
    ("paired contact", "sensitivities"),
    ("shell", "paired contact"),
}
_SAMPLED = [pair for pair in PAIRS if not {"friction", "paired contact", "sliding supports", "high degree"} & {*pair}]
DAILY = {*random.Random(64).sample(_SAMPLED, len(_SAMPLED) // 10), *MENDED, *REFUSALS}
ELSEWHERE = {"partitioned", "start", "one mesh", "maximum unknowns", "expected shape", "observed meshes"}
"""parts whose rows other tests have: they need further files, or only say what a search or a comparison may do"""


def made(*names: str, directory: Path) -> Data:
    data = dict(BASE)
    for name in CHANGES:
        if name in names:
            data = CHANGES[name](data, directory)
    return data


def text_for(first: str, second: str) -> str | None:
    """The sentence of the table on two parts."""
    if (first, second) in BY_SCHEMA:
        return BY_SCHEMA[first, second]
    names = {first, second}
    names |= set().union(*(IMPLIED[name] for name in names & set(IMPLIED)))
    rows = (REFUSED.get(one, {}).get(other) for one, other in itertools.permutations(sorted(names), 2))
    return next((text for text in rows if text is not None), None)


_ALONE: dict[str, np.ndarray] = {}


def shape_of(part: str, directory: Path) -> np.ndarray:
    """Displacement of the job with one part alone, which is solved once."""
    if part not in _ALONE:
        _ALONE[part] = hpcinv.run(job(**made(part, directory=directory)), MPI.COMM_SELF).solutions[0].u
    return _ALONE[part]


@pytest.mark.parametrize(
    ("first", "second"),
    [pytest.param(*pair, marks=() if pair in DAILY else pytest.mark.release) for pair in PAIRS],
)
def test_two_parts_solve_together_or_are_refused_by_the_table(first: str, second: str, tmp_path: Path) -> None:
    data, refusal = made(first, second, directory=tmp_path), text_for(first, second)
    if refusal is not None:
        with pytest.raises(JobError, match=re.escape(refusal)):
            job(**data)
        return
    posed = job(**data)
    if ONLY_READ & {first, second}:
        return
    result = hpcinv.run(posed, MPI.COMM_SELF)
    lines = {line.name: line for line in result.certificate.lines}
    assert lines["equilibrium residual, relative to the load"].verdict.value == "pass"
    for how, other in itertools.permutations((first, second)):
        if how in HOW and other != "states":
            u, expected = result.solutions[0].u, shape_of(other, tmp_path)
            assert np.abs(u - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.everyday("rigid contact", "unknown pressures")
@pytest.mark.parallel([3])
@pytest.mark.parametrize("part", [part for part in CHANGES if part not in ONLY_READ])
def test_a_rank_may_have_no_cells(part: str, comm: MPI.Intracomm, run_directory: Path) -> None:
    """Two cells, or a few, on three ranks give the values that they give on one rank."""

    def on_one_rank() -> tuple[Data, dict[str, Any]]:
        data = made(part, directory=run_directory)
        return data, dict(hpcinv.run(job(**data), MPI.COMM_SELF).quantities)

    data, expected = on_root(comm, on_one_rank)
    result = hpcinv.run(job(**data), comm)
    for name, value in expected.items():
        assert result.quantities[name] == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("names", [("shell", "mesh file"), ("mesh file", "shell")])
def test_reasons_do_not_depend_on_the_order_of_the_table(
    names: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = {name: REFUSED["nested iteration"][name] for name in names}
    monkeypatch.setitem(combinations.REFUSED, "nested iteration", row)
    with pytest.raises(JobError, match=re.escape(row["shell"])):
        job(**made("shell", "nested iteration", directory=tmp_path))


def test_volumes_may_begin_at_another_state(tmp_path: Path) -> None:
    data = made("unknown pressures", "states", directory=tmp_path)
    more: Data = {"name": "more", "effects": [{**PULL, "traction": [0.02, 0.0, -0.1]}], "volumes": {"hole": 0.7}}
    data["states"][2] |= {"volumes": {"hole": 0.6}}
    near, alone = (
        hpcinv.run(job(**data | {"states": [*data["states"], more | start]}), MPI.COMM_SELF).solutions[-1]
        for start in ({"start": "other"}, {})
    )
    assert near.start == "other"
    assert near.cavities[0].pressure == pytest.approx(alone.cavities[0].pressure, rel=1e-8)
    assert np.abs(near.u - alone.u).max() < 1e-8 * np.abs(alone.u).max()


def test_a_guess_has_the_unknown_pressures(tmp_path: Path) -> None:
    """A solution is a guess after which one correction is left."""
    data = made("unknown pressures", directory=tmp_path)
    solution = hpcinv.run(job(**data), MPI.COMM_SELF).solutions[0]
    body = build_body(solution.job.mesh, {}, MPI.COMM_SELF, resolve=solution.job.resolve, degree=2)
    equations = Equations(job(**data), body, Timings())
    solved = solve_direction(equations, "inverse", Start(guess=solution.as_guess()), SILENT)
    equations.destroy()
    assert [len(solve.iterations) for solve in solved.solves] == [1]
    assert solved.constraints[0].pressure == pytest.approx(solution.cavities[0].pressure, rel=1e-8)


def test_a_restart_with_contact_has_the_unknown_motion(tmp_path: Path) -> None:
    data = made("remote loads", "rigid contact", directory=tmp_path)
    data["effects"][-1]["obstacle"]["point"] = [0, 0, -10]  # it is not touched
    del data["first"]
    posed = job(**data | {"analysis": "forward"})
    solution = hpcinv.run(posed, MPI.COMM_SELF).solutions[0]
    body = build_body(posed.mesh, {}, MPI.COMM_SELF, resolve=posed.resolve, degree=2)
    equations = Equations(posed, body, Timings())
    start = Start(solution=solution.fields, load=1.0)
    first, *_ = solve_direction(equations, "forward", start, SILENT).solves
    equations.destroy()
    assert first.iterations[0].correction < 1e-6 * first.iterations[0].state


@pytest.mark.parametrize("unknown", ["unknown pressures", "remote loads"])
def test_a_damped_line_search_finds_unknown_numbers(unknown: str, tmp_path: Path) -> None:
    data = made(unknown, directory=tmp_path)
    options = {"petsc": {"snes_linesearch_damping": 0.7}, "tolerance": 1e-8, "maximum_iterations": 60}
    exact, damped = (
        hpcinv.run(job(**data | {"solver": data["solver"] | changes}), MPI.COMM_SELF).solutions[0]
        for changes in ({}, options)
    )
    assert len(damped.solves[0].iterations) > 10
    assert np.abs(damped.u - exact.u).max() < 1e-7 * np.abs(exact.u).max()


def test_parts_of_the_table_are_all_known() -> None:
    named = set(REFUSED) | {other for row in REFUSED.values() for other in row}
    assert named <= set(PARTS)
    assert {*CHANGES, *ELSEWHERE}.union(*IMPLIED.values()) == set(PARTS)
