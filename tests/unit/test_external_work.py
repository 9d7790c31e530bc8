"""Effects whose text is wrong end in one message with file and line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import basix.ufl
import pytest
import ufl

from hpcinv.errors import JobError
from hpcinv.model.external_work import external_work
from hpcinv.physics.effects import Effect

MESH = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
V = ufl.TestFunction(ufl.FunctionSpace(MESH, basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))))


class Area:
    """Stands for the kinematics: an integral over a region of the boundary."""

    def da(self, integrand: Any, region: str) -> Any:
        return integrand * ufl.ds(domain=MESH, metadata={"region": region})


def work_of(function: Callable[[Any, Any], Any]) -> Any:
    class Written(Effect):
        def virtual_work(self, k: Any, v: Any, load: Any, par: Any) -> Any:
            return function(k, v)

    return external_work("effects[0]", Written(), Area(), V, 1.0, None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        pytest.param(lambda k, v: k.da(v[0]), r"line \d+: virtual_work fails: TypeError: .*'region'", id="no region"),
        pytest.param(lambda k, v: v[0] * k.da, r"line \d+: virtual_work fails: TypeError", id="as a measure"),
        pytest.param(lambda k, v: v[0] + k.surface, "virtual_work fails: AttributeError: .*'surface'", id="unknown"),
        pytest.param(lambda k, v: v[0], "virtual_work returns no integral, but Indexed", id="no integral"),
        pytest.param(lambda k, v: k.da(v[0] ** 2, "x1"), "virtual_work is not linear in v", id="square"),
        pytest.param(lambda k, v: k.da(1.0, "x1"), "virtual_work is not linear in v", id="without v"),
    ],
)
def test_wrong_texts_are_named(function: Callable[[Any, Any], Any], message: str) -> None:
    with pytest.raises(JobError, match=rf"^effects\[0\]: \S*test_external_work\.py.*{message}") as caught:
        work_of(function)
    assert "k.da(f, region)" in str(caught.value).splitlines()[1]


def test_integrals_linear_in_v_are_taken() -> None:
    assert isinstance(work_of(lambda k, v: k.da(v[0], "x1")), ufl.Form)
    assert work_of(lambda k, v: None) is None
