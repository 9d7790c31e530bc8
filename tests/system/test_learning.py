"""Jobs as differentiable functions: of numbers and data arrays, in PyTorch and in JAX."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.learning import LOAD, MODULI, PACKAGES, check_products, posed
from helpers.other_packages import run_with

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import HpcinvError, JobError
from hpcinv.studies.learning.differentiable_job import DifferentiableJob


@pytest.mark.parallel([1, 2])
def test_a_job_is_a_function_of_numbers_and_arrays(comm: MPI.Intracomm, run_directory: Path) -> None:
    """A job whose file has the arrays gives the same values; gradients are central differences."""
    random = np.random.default_rng(5)
    with DifferentiableJob(posed(comm, run_directory), [MODULI, LOAD], ["shape", "tip"], comm) as model:
        assert [a.tolist() for a in model.start] == [[20.0] * 72, 900.0]
        assert model.input_shapes == ((72,), ())
        assert model.output_shapes == ((36, 3), (3,))
        values = [random.uniform(15, 30, 72), np.array(700.0)]
        model.evaluate(model.start)
        found = model.evaluate(values)
        check_products(model, values, [random.normal(size=72), np.array(40.0)])
    fresh = hpcinv.run(posed(comm, run_directory, values[0]).with_({LOAD: 700}), comm, progress=False)
    np.testing.assert_allclose(found[0], fresh.shape_in_file, rtol=0, atol=1e-11)


def test_wrong_inputs_are_one_message(comm: MPI.Intracomm, run_directory: Path) -> None:
    block = posed(comm, run_directory)
    with pytest.raises(JobError, match=r"unknown input 'material\.my': an input is a number under 'sensitivities', a"):
        DifferentiableJob(block, ["material.my"], comm=comm)
    with pytest.raises(JobError, match=r"unknown output 'top'\. Did you mean 'tip'\?"):
        DifferentiableJob(block, [LOAD], ["top"], comm)
    with DifferentiableJob(block, [MODULI, LOAD], ["tip"], comm) as model:
        with pytest.raises(JobError, match=r"'material\.mu' must have the shape \(72,\), not \(3,\)"):
            model.evaluate([np.ones(3), 900.0])
        with pytest.raises(JobError, match=r"2 arrays are needed \(material\.mu, effects\[0\]\.pressure\), not 1"):
            model.evaluate([np.full(72, 20.0)])
        with pytest.raises(HpcinvError, match="the shear modulus must be positive, but is -1000"):
            model.evaluate([np.full(72, -1.0), 900.0])
        assert np.isfinite(model.evaluate(model.start)[0]).all()
        with pytest.raises(JobError, match=r"'tip' must have the shape \(3,\), not \(\)"):
            model.gradient(model.start, [1.0])
    force = {"name": "force", "of": "reaction", "on": "x0"}
    with DifferentiableJob(block.with_({"quantities": [force]}), [LOAD], ["force"], comm) as model:
        with pytest.raises(JobError, match="vjp: 'force' is a reaction or a result of contact, which has no derivat"):
            model.gradient(model.start, [np.ones(3)])
        with pytest.raises(JobError, match="'force' has no derivative along a direction"):
            model.along(model.start, [1.0])


@pytest.mark.parametrize(
    ("package", "title", "remedy"),
    [
        ("torch", "PyTorch", "torch"),
        ("jax", "JAX", "jax"),
        ("tesseract_core", "Tesseract", r"'tesseract-core\[runtime\]'"),
    ],
)
def test_a_package_that_is_not_installed_is_one_message(
    package: str, title: str, remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = f"hpcinv.{package.removesuffix('_core')}"
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, module, raising=False)
    expected = rf"^{module} needs {title}, which is not installed\. Install it by: pip install {remedy}$"
    with pytest.raises(ModuleNotFoundError, match=expected):
        importlib.import_module(module)


HEAD = """
import sys
import hpcinv.base.parallel.runtime as runtime
sys.path += [{tests!r}]
from pathlib import Path
from helpers.learning import posed
block = posed(runtime.MPI.COMM_WORLD, Path({directory!r}))
"""
PROGRAMS = {
    "torch": """
import torch
from hpcinv.torch import function

torch.set_default_dtype(torch.float64)
solve = function(block, ["material.mu", "effects[0].pressure"], ["tip"])
moduli = torch.linspace(15, 30, 72, requires_grad=True)
load = torch.tensor(700.0, requires_grad=True)
assert torch.autograd.gradcheck(lambda m, p: solve(m, 700 * p)[0], (moduli, load / 700), eps=1e-4, atol=1e-8)
wanted = solve(torch.linspace(15, 30, 72), torch.tensor(700.0))[0].detach()
guess = torch.full((72,), 20.0, requires_grad=True)
optimiser = torch.optim.LBFGS([guess], max_iter=10, line_search_fn="strong_wolfe")

def loss():
    optimiser.zero_grad()
    value = 1e6 * ((solve(guess, torch.tensor(700.0))[0] - wanted) ** 2).sum()
    value.backward()
    return value

first = float(loss())
optimiser.step(loss)
assert float(loss()) < 1e-3 * first
""",
    "jax": """
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
from hpcinv.jax import function

solve = function(block, ["material.mu", "effects[0].pressure"], ["tip"])

@jax.jit
def total(moduli, load):
    return 1e3 * jnp.sum(solve(moduli, load)[0] ** 2)

moduli, load = jnp.linspace(15, 30, 72), 700.0
gradient = jax.grad(total, argnums=(0, 1))(moduli, load)
direction = jnp.sin(jnp.arange(72.0))
for by, ends in (
    (gradient[0] @ direction, [total(moduli + s * 1e-3 * direction, load) for s in (1, -1)]),
    (gradient[1], [total(moduli, load + s * 1e-3) for s in (1, -1)]),
):
    slope = (ends[0] - ends[1]) / 2e-3
    assert abs(by - slope) < 1e-5 * abs(slope), (by, slope)
""",
}


@pytest.mark.release
@pytest.mark.parametrize("package", PROGRAMS)
def test_gradients_in_other_packages(package: str, tmp_path: Path) -> None:
    """With the real packages, which uv adds to this environment: 0.1 GB for JAX, 3 GB for PyTorch."""
    program = tmp_path / "program.py"
    head = HEAD.format(tests=str(ROOT / "tests"), directory=str(tmp_path))
    program.write_text(head + PROGRAMS[package])
    run_with([PACKAGES[package]], "python", str(program))
