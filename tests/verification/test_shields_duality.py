"""Shield's duality: the inverse of a law W is the forward solve of its dual, ``W*(F) = det F · W(F⁻¹)``.

It holds without body force, where the whole boundary is moved. Both weak forms have one solution, but other errors of
the discretisation. Only a solution that the elements contain is found alike to the last digits.

Source: Shield (1967), "Inverse deformation results in finite elasticity", doi:10.1007/BF01601719.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from helpers.verification import Solved, box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.physics.materials import laws

_DUAL = {"I1": "(I2/J**2)", "I2": "(I1/J**2)", "J": "(1/J)", "I1_bar": "I2_bar", "I2_bar": "I1_bar"}
"""invariants of the inverse of a deformation"""
_INVARIANTS = re.compile(r"\b(I1_bar|I2_bar|I1|I2|J)\b")
OF_STRETCHES = ("ogden", "hencky")
OF_INVARIANTS = [
    name for name, kind in laws().items() if name not in OF_STRETCHES and not kind.model_validate(kind.example).families
]
"""isotropic laws whose energy can be written as a formula"""
QUADRATICALLY = {"displacement": 2, "quadrature": 6}
LINEARLY = {"displacement": 1}
QUADRATIC = ["0", "0", "0.3*(x**2 - y**2) + 0.2*x*y"]
A, B, C = 1.3, 0.8, 1.1
"""stretches along x, y and z"""
SHEAR = [f"{1 - 1 / A}*x", f"{1 - 1 / B}*y", f"{1 - 1 / C}*z + {0.2 / C}*(x**2/{A**2} - y**2/{B**2})"]
"""displacement to the loaded body, at its points, of stretches and a harmonic shear along z"""


def dual(name: str) -> dict[str, Any]:
    """The dual of the example of a law, as a formula."""
    law = laws()[name].model_validate(laws()[name].example)
    energy = _INVARIANTS.sub(lambda match: _DUAL[match[0]], law.energy_formula)
    values: dict[str, Any] = {name: f"{v!r} Pa" if d.mass else v for name, (v, d) in law.quantities().items()}
    values |= laws()[name].example.get("parameters", {})  # with units, of a formula
    energy, values["bulk"] = re.sub(r"\bkappa\b", "bulk", energy), values.pop("kappa", None)
    parameters = {key: value for key, value in values.items() if re.search(rf"\b{key}\b", energy)}
    return {"law": "formula", "energy": f"J*({energy})", "parameters": parameters}


def displacement(
    material: Mapping[str, Any],
    analysis: str,
    moved: Sequence[str],
    divisions: int,
    comm: MPI.Intracomm,
    discretisation: Mapping[str, int] = QUADRATICALLY,
) -> np.ndarray:
    """Displacement of the nodes of a cube whose boundary is moved, over its diagonal."""
    solved = Solved(
        job(
            analysis=analysis,
            mesh=box((divisions, divisions, divisions)),
            material=material,
            supports=[{"region": "boundary", "displacement": moved}],
            discretisation={"formulation": "displacement", **discretisation},
            solver={"tolerance": 1e-12},
        ),
        comm,
    )
    unknowns = solved.model.unknowns
    return np.asarray(unknowns.geometry_values(unknowns.displacement()))


def difference(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.abs(first + second).max() / np.abs(first).max())


def back(moved: Sequence[str]) -> list[str]:
    return [f"-({formula})" for formula in moved]


def test_the_inverse_of_a_law_is_the_forward_solve_of_its_dual(comm: MPI.Intracomm) -> None:
    """Stretches and a harmonic shear are a solution of the neo-Hookean law; quadratic elements contain it."""
    law = laws()["neo-hookean"].example
    inverse = displacement(law, "inverse", SHEAR, 2, comm)
    by_dual, by_law = (displacement(m, "forward", back(SHEAR), 2, comm) for m in (dual("neo-hookean"), law))
    assert np.abs(inverse).max() > 0.1  # of the diagonal
    assert difference(inverse, by_dual) < 1e-8
    assert difference(inverse, by_law) > 1e-3  # the law is not its own dual


def check_convergence(
    name: str, dual_displacement: Any, comm: MPI.Intracomm, divisions: int = 4, **options: Any
) -> tuple[float, float]:
    """Return the difference of inverse and dual solves over the differences by the law itself and on coarse cells.

    Args:
        divisions: of the finer mesh.
        options: of `displacement`.
    """
    law = laws()[name].example
    by_inverse = [displacement(law, "inverse", QUADRATIC, n, comm, **options) for n in (divisions // 2, divisions)]
    coarse, fine = (
        difference(u, dual_displacement(n)) for u, n in zip(by_inverse, (divisions // 2, divisions), strict=True)
    )
    of_law = difference(by_inverse[1], displacement(law, "forward", back(QUADRATIC), divisions, comm, **options))
    print(f"{name}: {coarse:.1e}, {fine:.1e}; of the law itself {of_law:.1e}")
    return fine / max(of_law, 40e-8), fine / max(coarse, 2e-8)


@pytest.mark.everyday("gent")
@pytest.mark.parametrize("name", OF_INVARIANTS)
def test_laws_and_their_duals_converge(name: str, comm: MPI.Intracomm) -> None:
    shares = check_convergence(name, lambda n: displacement(dual(name), "forward", back(QUADRATIC), n, comm), comm)
    assert shares[0] < 1 / 40
    assert shares[1] < 0.7


@pytest.mark.release
@pytest.mark.parametrize("name", OF_STRETCHES)
def test_laws_of_stretches_and_their_duals_converge(
    name: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sums of powers of stretches are not formulas: the law adds what its dual has more than the law."""
    kind, given = laws()[name], laws()[name].example
    original = kind.isochoric_energy
    if name == "ogden":  # λ → 1/λ
        given = given | {"alpha": [-a for a in given["alpha"]], "mu": ["-0.63 MPa", "-1.2 kPa", "10 kPa"]}

    def energy(law: Any, k: Any, par: Any) -> Any:
        volumetric = par.kappa / 2 * law.dilatation(k) ** 2
        share = 1 / k.J if name == "ogden" else k.J  # J U(1/J) over U(J), of (J - 1)² and (ln J)²
        return k.J * original(law, k, par) + (share - 1) * volumetric

    def solved(divisions: int) -> np.ndarray:
        with monkeypatch.context() as patch:
            patch.setattr(kind, "isochoric_energy", energy)
            return displacement(given, "forward", back(QUADRATIC), divisions, comm, LINEARLY)

    shares = check_convergence(name, solved, comm, 8, discretisation=LINEARLY)
    assert shares[0] < 1 / 40
    assert shares[1] < 0.7
