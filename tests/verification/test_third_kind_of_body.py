"""A kind of body from outside the package: all that asks what a body is asks the classes of its kind."""

from __future__ import annotations

import dataclasses
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv import on_demand
from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.job import body_kinds, kind_rules
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.kind_source import KindSource
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.output.result import Result

FACTOR, ASKED = 1.5, list[str]()


class Section:
    """Section of a mesh whose body is stretched along x."""

    layers = ()

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def numbers(self) -> dict[tuple[str, ...], Number]:
        return {("factor",): Number(self.factor, None)}


class StretchedSource(KindSource):
    """The mesh in the file, stretched."""

    def body(self, source: MeshSource, spec: Any) -> MeshSource:
        points = source.points * [spec.stretched.factor, 1, 1]
        return dataclasses.replace(source, points=points, body_kind="stretched")

    def quadrature(self, body: MeshSource, degree: int) -> int:
        ASKED.append("quadrature")
        return super().quadrature(body, degree)

    def corrects_shear(self, body: MeshSource, degree: int) -> bool:
        ASKED.append("shear")
        return super().corrects_shear(body, degree)

    def node_rates(self, body: MeshSource, place: Any, value: float) -> Floats:
        ASKED.append(".".join(place))
        return np.asarray(body.points * [1, 0, 0] / value)


@pytest.fixture(autouse=True)
def kind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kind, registered as a plugin would."""
    kind = dataclasses.replace(body_kinds.SOLID, name="stretched")
    monkeypatch.setitem(body_kinds.KINDS, kind.name, kind)
    monkeypatch.setitem(kind_rules.KIND_RULES, kind.name, kind_rules.KindRules())
    monkeypatch.setitem(on_demand.FUNCTIONS, f"mesh of a {kind.name}", f"{__name__}:StretchedSource")
    monkeypatch.setitem(sys.modules, __name__, SimpleNamespace(StretchedSource=StretchedSource))
    ASKED.clear()


def run(**changes: Any) -> Result:
    given = {
        "mesh": box((2, 1, 1)),
        "material": {"law": "neo-hookean", "mu": 1e4, "lam": 4e4},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 100}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "quantities": [{"name": "end", "of": "uz", "on": "x1", "reduce": "mean"}],
        "solver": {"tolerance": 1e-13},
    }
    return hpcinv.run(job(**given | changes))


def stretched(monkeypatch: pytest.MonkeyPatch, factor: float, **changes: Any) -> Result:
    with monkeypatch.context() as patch:
        patch.setattr(MeshSpec, "stretched", Section(factor), raising=False)
        return run(**changes)


def test_body_of_a_third_kind_is_solved_checked_and_differentiated(monkeypatch: pytest.MonkeyPatch) -> None:
    key, h = "mesh.stretched.factor", 1e-4
    found = stretched(monkeypatch, FACTOR, certificate="standard", sensitivities=[key])
    assert {*ASKED} == {"quadrature", "shear", "factor"}
    solid = run(mesh=box((2, 1, 1), lx=FACTOR), certificate="standard")
    assert found.solutions[0].u == pytest.approx(solid.solutions[0].u, abs=1e-11)
    lines, of_solid = ([line.name for line in result.certificate.lines] for result in (found, solid))
    assert lines == of_solid
    assert found.estimate is not None
    assert solid.estimate is not None
    assert found.sensitivities is not None
    assert found.estimate.shape == pytest.approx(solid.estimate.shape, rel=1e-6)
    ahead, behind = (stretched(monkeypatch, FACTOR + d).quantities["end"] for d in (h, -h))
    assert found.sensitivities.slopes["end"][key] == pytest.approx((ahead - behind) / (2 * h), rel=1e-5)


def test_hinge_of_a_body_without_a_midsurface_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kind_rules.KindRules, "unsuited", lambda self, job: iter(()))
    hinged = [{"region": "x0", "fix": ["x", "y", "z"], "hinge": True}]
    with pytest.raises(hpcinv.errors.MeshError, match=r"supports\[0\].hinge: 'x0' has no nodes of the midsurface"):
        stretched(monkeypatch, FACTOR, supports=hinged)
