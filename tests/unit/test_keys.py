"""Keys of jobs: every leaf of the schema counts in each, or stands in its table of what does not, with a reason."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import pytest
from helpers.schema_leaves import Place, variations
from helpers.sheets import flat, save_sheet

from hpcinv.base.files.names import NamesFile
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.docstrings import meanings
from hpcinv.base.quantity.schema import Spec, metadata_in
from hpcinv.errors import CheckpointError
from hpcinv.job.fingerprint import NOT_CONTENT, NOT_PHYSICS, check_same_problem, content_key, fingerprint
from hpcinv.job.job import Job, load
from hpcinv.job.mesh_file import ExpectedShape
from hpcinv.job.resolved_job import SectionData
from hpcinv.job.reuse_key import NOT_BODY, body_key, numbers_of, reuse_group_of
from hpcinv.physics.effects.contact import Contact
from hpcinv.physics.effects.obstacles import SurfaceObstacle
from hpcinv.solver.workspace import Workspace

HERE = Path(__file__).parents[2]
BASE: Mapping[str, Any] = {
    "mesh": {"file": "meshes/box.py"},
    "material": {"law": "neo-hookean", "mu": "1 kPa", "lam": "4 kPa"},
    "fibres": {"f": {"direction": ["q*X", 1, 0], "given_on": "reference", "constants": {"q": 2}}},
    "supports": [{"region": "x0", "displacement": ["q*x", 0, 0], "constants": {"q": 1}}],
    "cavities": {"name": {"surface": "x1"}},
    "discretisation": {"formulation": "displacement"},
}
STATES = [
    {"name": "given", "given": True, "effects": [{"effect": "pressure", "region": "x0", "pressure": "1 Pa"}]},
    {"name": "full", "effects": [{"effect": "pressure", "region": "x0", "pressure": "2 Pa"}]},
]


def equations_key(job: Job, known: SectionData) -> object:
    return reuse_group_of(job, known), numbers_of(job, known)


KEYS: Mapping[str, tuple[Callable[[Job, SectionData], object], Mapping[str, str]]] = {
    "content": (content_key, NOT_CONTENT),
    "fingerprint": (lambda job, known: json.dumps(fingerprint(job, known)), NOT_PHYSICS),
    "body": (body_key, NOT_BODY),
    "equations": (equations_key, NOT_PHYSICS),
}
ALIKE = {
    "discretisation.formulation": "auto counts as the form that it chooses",
    "discretisation.pressure": "a default counts as the degree that it is",
    "constants": "numbers of formulas are in the order of their names in the constant of the forms",
}
"""Leaves of which some values, but not all, are the same."""


def jobs() -> Iterator[tuple[Place, list[Job]]]:
    """Jobs that differ in one leaf; states are walked in a job that has some, spaces in one with pressures."""
    further: dict[str, dict[str, Any]] = {
        "states": {"states": STATES},
        "discretisation": {"discretisation": {"formulation": "mixed"}},
    }
    bases = {name: load({**BASE, **further.get(name, {})}, directory=HERE) for name in ("", *further)}
    for name, field in Job.model_fields.items():
        base = bases[name if name in bases else ""]
        whole = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
        for place, values in variations(whole, getattr(base, name)):
            yield (name, *place), [base.model_copy(update={name: value}) for value in values]


def is_left_out(place: Place, table: Mapping[str, str]) -> bool:
    return place[0] in table or ".".join(place[:2]) in table


def test_every_leaf_of_the_schema_counts_in_each_key_or_has_a_reason_not_to() -> None:
    """Sections that are the same in several jobs are read once, as in a sweep."""
    wrong, places, known = [], set[str](), SectionData(str)
    for place, variants in jobs():
        where = ".".join(place)
        places |= {place[0], ".".join(place[:2])}
        has_like = any(where == like or place[-1] == like for like in ALIKE)
        for name, (key, table) in KEYS.items():
            count = len({key(variant, known) for variant in variants})
            if not is_left_out(place, table):
                expected = 2 if has_like else len(variants)
                wrong += [f"{name}: {where}: {count} of {len(variants)}"] if count < expected else []
            elif count > 1 and name != "equations":  # which have settings of their solvers
                wrong.append(f"{name}: {where}: counts, though it is in the table")
    assert not wrong
    derived = {"directions", "inputs_of_plugins", "discretisation.layers", "discretisation.recovered_geometry"}
    assert {*NOT_CONTENT, *NOT_PHYSICS, *NOT_BODY} - derived <= places


def specs(annotation: Any, known: set[type[Spec]]) -> set[type[Spec]]:
    """All parts of which a job can be made."""
    for kind in (annotation, *get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, Spec) and kind not in known:
            for one in (kind, *kind.__subclasses__()):
                known.add(one)
                for field in one.model_fields.values():
                    specs(field.annotation, known)
        elif kind is not annotation:
            specs(kind, known)
    return known


def test_every_field_with_a_path_is_marked_as_a_file() -> None:
    """Keys have the content of marked files; the directory of a start counts by its path."""
    unmarked = {
        name
        for kind in specs(Job, set())
        for name, field in kind.model_fields.items()
        if re.search(r"\bpaths? (from the job|relative to|to (a|points))\b", meanings(kind).get(name, ""))
        and metadata_in(NamesFile, field.annotation, *field.metadata) is None
    }
    assert not unmarked


def test_files_count_by_their_content_and_not_by_their_path() -> None:
    plain = load(BASE, directory=HERE)

    def with_(section: str, part: Spec | None, **values: Any) -> Job:
        changed = values[section] if part is None else part.model_copy(update=values)
        return plain.model_copy(update={section: changed})

    def with_files(a: str) -> list[Job]:
        contact = Contact.model_construct(
            region="x1", obstacle=SurfaceObstacle.model_construct(shape="surface", file=a), stiffness=1.0
        )
        return [
            with_("mesh", plain.mesh, file=a),
            with_("mesh", plain.mesh, surfaces={"body": (a,)}),
            with_("mesh", plain.mesh, faces={"inlet": (a,)}),
            with_("solver", plain.solver, start_shape=a),
            with_("plugins", None, plugins=(a,)),
            with_("files", None, files=(a,)),
            with_("effects", None, effects=(contact,)),
            with_("expected_shape", None, expected_shape=ExpectedShape.model_construct(file=a)),
        ]

    for job, moved in zip(with_files("a.stl"), with_files("other/a.stl"), strict=True):
        assert content_key(moved, SectionData(lambda path: "a")) == content_key(job, SectionData(lambda path: "a"))
        assert content_key(moved, SectionData(lambda path: "a")) != content_key(job, SectionData(lambda path: "b"))
    [*_, contact, _] = with_files("a.stl")
    assert equations_key(contact, SectionData(lambda path: "a")) != equations_key(
        contact, SectionData(lambda path: "b")
    )


def test_a_kept_body_is_that_of_the_job(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """A name in the thickness of a shell, and places of regions that are not conditions."""
    save_sheet(tmp_path / "sheet.msh", 1, 1, flat(1.0, 1.0))
    sheet = {**BASE, "fibres": {}, "cavities": {}, "discretisation": {}, "mesh": {"file": "sheet.msh"}}

    def shell(t: str, corner: float) -> Job:
        thickness = {"thickness": "t*(1 + y/(1 m))"}
        return load(
            sheet
            | {"let": {"t": t}, "mesh": {"file": "sheet.msh", "shell": thickness}}
            | {"regions": {"corner": {"vertices": [[corner, 0, "-1 mm"]]}, "face": {"smooth": [corner, 0, "-1 mm"]}}},
            directory=tmp_path,
        )

    with Workspace(comm) as workspace:
        bodies = [workspace.body(shell(t, corner)) for t, corner in (("1 mm", 0), ("2 mm", 0), ("2 mm", 1))]
    heights = [np.ptp(body.given_nodes[:, 2]) for body in bodies]
    assert heights == pytest.approx([2e-3, 4e-3, 4e-3])
    assert bodies[1] is not bodies[2]


def test_results_of_a_version_that_compared_less_are_refused_by_one_message() -> None:
    new = fingerprint(load(BASE, directory=HERE), SectionData(str))
    old = {name: part for name, part in new.items() if name not in ("format", "cavities")}
    with pytest.raises(CheckpointError, match=r"^summary\.json: was written by a version of hpcinv that compares"):
        check_same_problem(Path("summary.json"), old, new)


def test_another_order_of_layers_is_another_problem() -> None:
    layers = {"core": 3.0, "coat": 1.0}
    one, other = ({"format": 2, "layers": dict(entries)} for entries in (layers.items(), reversed(layers.items())))
    check_same_problem(Path("summary.json"), one, one)
    with pytest.raises(CheckpointError, match="layers: has another order"):
        check_same_problem(Path("summary.json"), one, other)
