"""Every law, effect and configuration of fibres has moduli, which make up the tangent of a large mesh.

Large meshes take another path than small ones (`hpcinv.model.assembly.tangent`); here small ones take both. Residual
and tangent must agree with the forms that FFCx compiles. All laws are in one weak form, each in a slab of a bar, and
all effects in another one.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from dolfinx import fem
from helpers.command_line import NO_CERTIFICATE
from helpers.reference_kernels import kernels_of_ffcx
from helpers.verification import BOX, box, job
from helpers.without_compiler import without_compiler
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.driver import run
from hpcinv.errors import SystemPartMissing
from hpcinv.job.job import Job, parse
from hpcinv.mesh import build_body
from hpcinv.model.assembly.csr_tangent import FilledTangent
from hpcinv.model.assembly.moduli_at_points import moduli_at_points
from hpcinv.model.assembly.tangent import FormTangent, tangent_of, tangents_for
from hpcinv.output.progress import Progress
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws
from hpcinv.physics.points import ffcx_fallback
from hpcinv.solver.equations import Equations

HERE = Path(__file__).parents[1]
FIBRES = {
    "fibre": {"direction": [1, 0.5, 0], "given_on": "current"},
    "fibre1": {"direction": ["1 + y/(3 m)", "-0.2", "Z/(2 m)"], "given_on": "current"},
    "fibre2": {"direction": [0.3, 1, "x/(2 m)"], "given_on": "reference"},
    "sheet": {"direction": [0, 0.2, 1], "given_on": "reference"},
}
CONFIGURATIONS = ("reference", "current")
KINDS = [(direction, form) for direction in ("forward", "inverse") for form in ("displacement", "mixed")]
# As they are before a test registers one of its own.
LAWS = sorted(laws())
EFFECTS = [(name, kind) for name, kind in sorted(effects().items()) if not kind.only_of_kind]


def job_of_laws(**data: Any) -> Job:
    """A bar with a slab for each law of the registry, incompressible every second one where the form allows it."""
    regions, materials = {}, {}
    for number, name in enumerate(LAWS):
        regions[f"slab{number}"] = f"x > {number / len(LAWS) - 1e-6} and x < {(number + 1) / len(LAWS) + 1e-6}"
        example = dict(laws()[name].example)
        if data["discretisation"]["formulation"] == "mixed" and number % 2 == 0 and "kappa" in example:
            example["kappa"] = "incompressible"
        if name == "ogden":  # one term has all that several have, and compiles in a third of the time
            example |= {"mu": ["0.63 MPa"], "alpha": [1.3]}
        materials[f"slab{number}"] = example
    return job(mesh=box((len(LAWS), 1, 1)), regions=regions, material=materials, **data)


def job_of_effects(**data: Any) -> Job:
    """A cube under every effect of the registry, in each configuration that it knows."""
    return job_of_effects_in(lambda _: CONFIGURATIONS, **data)


def job_of_effects_once(**data: Any) -> Job:
    """Each effect in one configuration, in turn."""
    return job_of_effects_in(lambda number: (CONFIGURATIONS[number % 2],), **data)


def job_of_effects_in(chosen: Callable[[int], tuple[str, ...]], **data: Any) -> Job:
    """A cube under every effect, each in the configurations that are chosen by its number."""
    listed: list[dict[str, Any]] = []
    for number, (name, kind) in enumerate(EFFECTS):
        key = next((key for key in ("density_in", "area_in") if key in kind.model_fields), None)
        configurations = chosen(number) if key else (None,)
        listed += [kind.example | {"effect": name} | ({key: of} if key else {}) for of in configurations]
    listed.append({"effect": "growth", "fibre": "fibre2", "along": 1.1, "across": 0.95})
    shear = "20 kPa*(1 + X/(10 m) + y/(5 m))"
    law = {"law": "isochoric-neo-hookean", "mu": shear, "kappa": "100 kPa*(1 + Z/(9 m))"}
    return job(mesh=box((1, 1, 1)), material=law, effects=listed, **data)


def job_of_prestrain(**data: Any) -> Job:
    """A cube with a stress-free stretch of the current body."""
    effect = effects()["prestrain"].example | {"given_on": "current"}
    return job(
        mesh=box((1, 1, 1)), material={"law": "neo-hookean", "mu": "20 kPa", "lam": "50 kPa"}, effects=[effect], **data
    )


def common(direction: str, formulation: str) -> dict[str, Any]:
    return {
        "analysis": direction,
        "fibres": FIBRES,
        "discretisation": {"formulation": formulation, "quadrature": 2},
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    }


def model_of(given: Job, comm: MPI.Intracomm) -> Equations:
    return Equations(given, build_body(given.mesh, given.regions, comm, resolve=given.resolve), Timings())


@pytest.mark.everyday("job_of_effects_once-inverse-mixed")
@pytest.mark.parametrize(
    ("of", "direction", "formulation"),
    [
        (job_of_laws, "inverse", "mixed"),  # the one with most in it; of the others, moduli are made below
        (job_of_effects, "inverse", "mixed"),
        (job_of_effects_once, "inverse", "mixed"),
        (job_of_effects, "forward", "displacement"),
        (job_of_prestrain, "forward", "displacement"),
    ],
)
def test_programs_of_the_registry_are_what_ffcx_compiles(
    of: Any, direction: str, formulation: str, comm: MPI.Intracomm
) -> None:
    model = model_of(of(**common(direction, formulation)), comm)
    weak_form, state = model.weak_form(model.job.directions[0]), model.unknowns.state
    model.put_load(0.7)
    parts = [state] if model.unknowns.p is None else [state.sub(0), state.sub(1)]
    parts[0].interpolate(lambda x: 0.04 * np.stack([np.sin(2 * x[1]), x[0] * x[2], np.cos(x[0] + x[1])]))
    for pressure in parts[1:]:
        pressure.interpolate(lambda x: 0.3 * np.cos(x[0] - 2 * x[2]))
    with tangents_for(cells=1_000_000):
        filled = tangent_of(weak_form)
    assert isinstance(filled, FilledTangent), filled.note
    with kernels_of_ffcx("-O0"):  # they are called once: most of their time would be the compiler's
        reference, residual = FormTangent(weak_form), vector(weak_form.residual)
    with without_compiler(), tangents_for(cells=1_000_000):
        arrays, own_residual = tangent_of(weak_form), vector(weak_form.residual)
    assert isinstance(arrays, FilledTangent), arrays.note
    matrices = []
    for tangent in (reference, filled, FormTangent(weak_form), arrays):
        matrix, assemble = tangent.create_matrix(model.supports.conditions)
        assemble()
        matrices.append(matrix)
    theirs, *own_matrices = matrices
    size = theirs.norm(PETSc.NormType.INFINITY)
    errors = [
        float(np.abs(ours - residual).max() / np.abs(residual).max())
        for ours in (vector(weak_form.residual), own_residual)
    ]
    for matrix in own_matrices:
        matrix.axpy(-1.0, theirs, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        errors.append(matrix.norm(PETSc.NormType.INFINITY) / size)
    print("residuals of C and NumPy, moduli, form, moduli in NumPy:", *(f"{error:.1e}" for error in errors))
    assert max(errors[:2]) < 1e-12  # forces of neighbouring cells cancel in it
    assert max(errors[2:]) < 1e-13


def vector(form: Any) -> np.ndarray:
    return np.asarray(fem.assemble_vector(fem.form(form)).array)


@pytest.mark.everyday("forward-displacement-job_of_laws")
@pytest.mark.parametrize("of", [job_of_laws, job_of_effects])
@pytest.mark.parametrize(("direction", "formulation"), [kind for kind in KINDS if kind != ("inverse", "mixed")])
def test_every_part_of_a_weak_form_has_moduli(of: Any, direction: str, formulation: str, comm: MPI.Intracomm) -> None:
    model = model_of(of(**common(direction, formulation)), comm)
    part_moduli = moduli_at_points(model.weak_form(model.job.directions[0]).residual, model.unknowns)
    assert len(part_moduli) == len(model.job.laws)
    assert all(len(moduli.pairs) >= (1 if formulation == "displacement" else 3) for moduli in part_moduli)


SECOND_GRADIENT = '''
from typing import Any, Literal

import ufl
from hpcinv.physics.effects import Effect
from hpcinv.base.quantity import Stress


class SecondGradient(Effect):
    """Resists bending of fibres, by second derivatives of the displacement."""

    example = {"effect": "second-gradient", "stiffness": "1 Pa"}
    effect: Literal["second-gradient"]
    stiffness: Stress
    """per square of the length of the body"""

    def virtual_work(self, k: Any, v: Any, load: Any, par: Any) -> Any:
        return k.dV(-par.stiffness * ufl.inner(ufl.grad(ufl.grad(k.u)), ufl.grad(ufl.grad(v))))
'''


def job_of_second_gradient(directory: Path, effect: str = "second-gradient") -> Job:
    """A cube whose plugin has an operator that programs do not have, in an effect of a given name."""
    (directory / "bending.py").write_text(SECOND_GRADIENT.replace("second-gradient", effect))
    given = {
        "mesh": box((1, 1, 1)) | {"file": str(HERE / BOX)},
        "plugins": ["bending.py"],
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "effects": [
            {"effect": effect, "stiffness": "100 Pa"},
            {"effect": "traction", "region": "x1", "traction": [0, 0, "500 Pa"], "area_in": "reference"},
        ],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "certificate": NO_CERTIFICATE,
        "analysis": "forward",
    }
    return parse(given, directory / "job.yaml")


@pytest.mark.usefixtures("ffcx_compiles")
@pytest.mark.parametrize(
    ("fault", "remedy"),
    [
        (
            TimeoutError("JIT compilation timed out, probably due to a failed previous compile."),
            "remove libffcx_* there",
        ),
        (PermissionError(13, "Permission denied"), "writable"),
        (RuntimeError("Failed JIT compilation of form: command 'gcc' failed with exit code 1"), "Install a C compiler"),
    ],
)
def test_the_remedy_is_for_what_kept_ffcx_from_compiling(
    fault: Exception, remedy: str, tmp_path: Path, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ffcx_fallback, "jit_of_dolfinx", Mock(side_effect=fault))
    with pytest.raises(SystemPartMissing, match="second derivatives of a function, which FFCx cannot compile") as found:
        run(job_of_second_gradient(tmp_path, f"gradient-{len(remedy)}"), comm)
    assert remedy in str(found.value)


@pytest.mark.usefixtures("ffcx_compiles")
def test_an_operator_of_a_plugin_is_named_where_nothing_compiles_it(
    tmp_path: Path, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise RuntimeError("Failed JIT compilation of form: cc")

    monkeypatch.setenv("CC", "no-such-cc")
    monkeypatch.setattr(ffcx_fallback, "jit_of_dolfinx", fail)
    place = re.escape(f"effects[0]: {tmp_path / 'bending.py'}, line 18: it has second derivatives of a function")
    with pytest.raises(SystemPartMissing, match=rf"no C compiler 'no-such-cc' on .* needed for {place}"):
        run(job_of_second_gradient(tmp_path, "third-gradient"), comm)


@pytest.mark.usefixtures("ffcx_compiles")
def test_a_residual_without_moduli_has_the_compiled_tangent_and_says_so(tmp_path: Path, comm: MPI.Intracomm) -> None:
    """On a large mesh an effect of a plugin, of whatever form, is solved as on a small one, and the log says how."""
    given = job_of_second_gradient(tmp_path)
    logs = io.StringIO(), io.StringIO()
    small = run(given, comm, progress=Progress(comm, logs[0]))
    with tangents_for(cells=1_000_000):
        large = run(given, comm, progress=Progress(comm, logs[1]))
    place = f"effects[0]: {tmp_path / 'bending.py'}, line 18: it has second derivatives of a function"
    assert f"{place}, which programs do not have: FFCx compiles it" in logs[0].getvalue().replace("\n", "")
    note = "the tangent is assembled by DOLFINx, which takes two to three times as long: it has second derivatives"
    assert note in logs[1].getvalue()
    assert large.statistics["solutions"][0]["linear"]["note"].startswith(note)
    assert small.statistics["solutions"][0]["linear"]["note"] == ""
    assert np.array_equal(small.solutions[0].u, large.solutions[0].u)
    assert large.solutions[0].largest_displacement > 1e-3
