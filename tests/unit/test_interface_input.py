"""Interfaces in jobs that are refused: by the job, or by the mesh before the solve."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.verification import job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError, MeshError
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations

CLAMP = {"region": "z0", "fix": ["x", "y", "z"]}


def two_blocks(between: list[str], **data: Any) -> Any:
    mesh = {"file": "../meshes/two_blocks.py", "parameters": {"lower": 1, "upper": 1, **data.pop("parameters", {})}}
    law = {"law": "neo-hookean", "mu": 1.0, "lam": 2.0}
    interfaces = [{"between": between, "kind": "tied"}]
    return job(**{"mesh": mesh, "material": law, "supports": [CLAMP], "interfaces": interfaces} | data)


def build(posed: Any) -> None:
    body = build_body(posed.mesh, posed.regions, MPI.COMM_SELF, resolve=posed.resolve, degree=2)
    equations = Equations(posed, body, Timings())
    equations.weak_form("inverse")
    equations.check_supports()


def test_bodies_that_are_apart_cannot_be_tied() -> None:
    with pytest.raises(MeshError, match=r"interfaces\[0\].between: 'bottom' and 'top' are 0.4 m apart: they cannot be"):
        build(two_blocks(["bottom", "top"], parameters={"gap": 0.4}))


def test_surfaces_must_face_each_other() -> None:
    with pytest.raises(MeshError, match="'z1' and 'top' do not face each other"):
        build(two_blocks(["z1", "top"]))


def test_one_region_is_not_an_interface() -> None:
    with pytest.raises(JobError, match=r"interfaces\[0\].between: names one region twice"):
        two_blocks(["top", "top"])


def test_unknown_regions_of_interfaces_are_named() -> None:
    with pytest.raises(MeshError, match="no region 'lid'"):
        build(two_blocks(["bottom", "lid"]))


def test_nodes_may_coincide_only_with_interfaces() -> None:
    build(two_blocks(["bottom", "top"]))
    with pytest.raises(MeshError, match="4 nodes coincide with another"):
        build(two_blocks(["bottom", "top"], interfaces=[]))


def test_without_an_interface_both_parts_must_be_held() -> None:
    with pytest.raises(MeshError, match="leave its part of"):
        build(two_blocks(["bottom", "top"], parameters={"gap": 0.1}, interfaces=[]))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"method": "anderson"}, "interfaces: need 'method: direct'"),
        ({"solver": {"linear": "iterative"}}, "interfaces: are too stiff for 'linear: iterative'"),
        ({"discretisation": {"displacement": 3}}, "interfaces: need 'displacement: 1' or 2"),
        ({"supports": [{"region": "z0", "fix": ["normal"]}, CLAMP]}, "interfaces: are not possible with supports that"),
    ],
)
def test_what_interfaces_do_not_meet_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(JobError, match=text):
        two_blocks(["bottom", "top"], **changes)


@pytest.mark.parametrize("analysis", ["inverse", "round_trip"])
def test_contact_of_bodies_needs_a_forward_analysis(analysis: str) -> None:
    with pytest.raises(JobError, match=r"interfaces\[0\].closure: is missing"):
        two_blocks(["bottom", "top"], analysis=analysis, interfaces=[{"between": ["bottom", "top"], "kind": "contact"}])


def test_bodies_in_contact_must_not_overlap_at_first() -> None:
    given = {"analysis": "forward", "interfaces": [{"between": ["bottom", "top"], "kind": "contact"}]}
    posed = two_blocks(["bottom", "top"], parameters={"gap": -0.1}, **given)
    body = build_body(posed.mesh, posed.regions, MPI.COMM_SELF, resolve=posed.resolve, degree=2)
    weak_form = Equations(posed, body, Timings()).weak_form("forward")
    with pytest.raises(MeshError, match=r"'bottom' and 'top' of the unloaded bodies overlap by 0.1 m at \("):
        weak_form.contacts.check_start()


def test_closures_that_fit_friction_are_named() -> None:
    with pytest.raises(
        JobError, match=r"closure: is missing.* assume 'coulomb', 'least-energy', 'stick' or 'touching'"
    ):
        two_blocks(["bottom", "top"], interfaces=[{"between": ["bottom", "top"], "kind": "contact", "friction": 0.2}])
