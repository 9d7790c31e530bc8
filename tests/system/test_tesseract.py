"""A job as a component of Tesseract."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.learning import LOAD, MODULI, posed
from helpers.other_packages import run_with

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.studies.learning.differentiable_job import DifferentiableJob

PACKAGES = ["tesseract-core[runtime]==1.15.0", "pydantic==2.14.1"]
"""which allows no newer pydantic"""
PROGRAM = """
import json
import numpy as np
from tesseract_core import Tesseract

component = Tesseract.from_tesseract_api("tesseract_api.py")
given = {"material_mu": np.linspace(15, 30, 72), "effects_0_pressure": np.array(700.0)}
tip = component.apply(given)["tip"]
weights = np.array([1.0, -2.0, 3.0])
gradient = component.vector_jacobian_product(given, ["material_mu"], ["tip"], {"tip": weights})["material_mu"]
rates = np.sin(np.arange(72.0))
ends = [component.apply(given | {"material_mu": given["material_mu"] + s * 1e-3 * rates})["tip"] for s in (1, -1)]
change = component.jacobian_vector_product(given, ["material_mu"], ["tip"], {"material_mu": rates})["tip"]
np.testing.assert_allclose(change, (ends[0] - ends[1]) / 2e-3, rtol=1e-5)
np.testing.assert_allclose(gradient @ rates, weights @ change, rtol=1e-8)
try:
    component.apply(given | {"material_mu": np.ones(3)})
except ValueError as error:
    assert "incompatible with expected shape (72,)" in str(error)
with open("given.json", "w") as file:
    json.dump({"inputs": {name: value.tolist() for name, value in given.items()}}, file)
"""


def stand_in() -> ModuleType:
    """The names of the package that schemas are made of; arrays may be anything."""

    class Anything:
        def __class_getitem__(cls, _: Any) -> Any:
            return Any

    module = ModuleType("tesseract_core.runtime")
    vars(module).update(Array=Anything, Differentiable=Anything, Float64=None, ShapeDType=SimpleNamespace)
    return module


def test_endpoints_are_those_of_a_differentiable_job(
    comm: MPI.Intracomm, run_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "tesseract_core", ModuleType("tesseract_core"))
    monkeypatch.setitem(sys.modules, "tesseract_core.runtime", stand_in())
    monkeypatch.delitem(sys.modules, "hpcinv.tesseract", raising=False)
    from hpcinv.tesseract import Component

    with DifferentiableJob(posed(comm, run_directory), [MODULI, LOAD], ["shape", "tip"], comm) as model:
        component = Component(model)
        assert list(component.start) == ["material_mu", "effects_0_pressure"]
        values = [np.linspace(15, 30, 72), np.array(700.0)]
        given = component.InputSchema(material_mu=values[0], effects_0_pressure=values[1])
        found = component.apply(given)
        np.testing.assert_array_equal(found["tip"], model.evaluate(values)[1])
        weight = np.array([1.0, -2.0, 3.0])
        gradient = component.vector_jacobian_product(given, {"material_mu"}, {"tip"}, {"tip": weight})
        assert list(gradient) == ["material_mu"]
        expected = model.gradient(values, [np.zeros((36, 3)), weight])[0]
        np.testing.assert_allclose(gradient["material_mu"], expected, rtol=1e-12)
        change = component.jacobian_vector_product(
            given, {"effects_0_pressure"}, {"tip"}, {"effects_0_pressure": np.array(2.0)}
        )
        assert list(change) == ["tip"]
        np.testing.assert_allclose(change["tip"], model.along(values, [np.zeros(72), 2.0])[1], rtol=1e-12)
        assert component.abstract_eval(given)["shape"].shape == (36, 3)
    twice = {"name": "shape_", "of": "Z", "on": "x1", "reduce": "mean"}
    with (
        DifferentiableJob(
            posed(comm, run_directory).with_({"quantities": [twice]}), [LOAD], ["shape", "shape_"]
        ) as same,
        pytest.raises(JobError, match="'shape' and 'shape_' have the same name 'shape'"),
    ):
        Component(same)


@pytest.mark.release
def test_the_component_of_the_page_passes_the_checks_of_the_package(tmp_path: Path) -> None:
    """Without containers: `Tesseract.from_tesseract_api`, `tesseract-runtime check` and `check-gradients`."""
    page = (ROOT / "docs" / "how-to" / "learning.md").read_text("utf-8")
    (text,) = re.findall(r"```python\n(from typing import Any\n\nfrom hpcinv\.tesseract.*?)```", page, re.S)
    posed(MPI.COMM_SELF, tmp_path)
    block = f"""
import sys
sys.path += [{str(ROOT / "tests")!r}]
import hpcinv.base.parallel.runtime as runtime
from pathlib import Path
from helpers.learning import posed
block = posed(runtime.MPI.COMM_WORLD, Path({str(tmp_path)!r}))
"""
    api = text.replace(
        '"block.yaml", ["material.mu"], ["shape"]', 'block, ["material.mu", "effects[0].pressure"], ["tip"]'
    )
    assert api != text
    (tmp_path / "tesseract_api.py").write_text(block + api)
    run_with(PACKAGES, "python", "-c", PROGRAM, cwd=tmp_path)
    settings = {"TESSERACT_API_PATH": str(tmp_path / "tesseract_api.py")}
    assert "successful" in run_with(PACKAGES, "tesseract-runtime", "check", cwd=tmp_path, **settings)
    checks = ("--max-evals", "10", "--eps", "0.01", "--rtol", "1e-4", f"@{tmp_path / 'given.json'}")
    printed = run_with(PACKAGES, "tesseract-runtime", "check-gradients", *checks, cwd=tmp_path, **settings)
    assert printed.count("0 failures") == 2
    assert json.loads((tmp_path / "given.json").read_text())["inputs"]["effects_0_pressure"] == 700.0
