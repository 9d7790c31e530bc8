"""Names for parts of formulas ('let'): what they may be, where they work, and that they cost no more than they are."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv as package
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.functions import FUNCTIONS
from hpcinv.cli.formula_guide import PLACES
from hpcinv.errors import JobError
from hpcinv.job.fingerprint import content_key, fingerprint
from hpcinv.job.job import Job
from hpcinv.job.reuse_key import reuse_group_of

FIXED = [{"region": "x0", "fix": ["x", "y", "z"]}]


def elastic(**parts: Any) -> Job:
    """A job with a small mesh; ``parts`` replace sections of it."""
    sections: dict[str, Any] = {
        "mesh": box((2, 1, 1)),
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "supports": FIXED,
        "discretisation": {"formulation": "displacement", "displacement": 1},
    }
    return job(**sections | parts)


def refusal(**parts: Any) -> str:
    with pytest.raises(JobError) as caught:
        elastic(**parts)
    return str(caught.value)


def test_definitions_may_stand_in_any_order_and_have_units() -> None:
    done = elastic(
        let={"stiff": "2*base", "base": "5 kPa", "r": "norm(x, y)", "R": "500 mm"},
        material={"law": "neo-hookean", "mu": "stiff*(1 + r/R)", "lam": "stiff"},
    )
    assert done.material.lam == 1e4  # type: ignore[union-attr]
    mu = done.material.mu.formula  # type: ignore[union-attr]
    assert mu.names == {"x", "y"}
    assert mu.evaluate(x=0.3, y=0.4) == pytest.approx(2e4, rel=1e-14)


@pytest.mark.parametrize(
    ("let", "message"),
    [
        ({"a": "b", "b": "c", "c": "a"}, "let.a: is defined by itself: a -> b -> c -> a"),
        ({"a": "a + 1"}, "let.a: is defined by itself: a -> a"),
        ({"sin": "1"}, "let.sin: is already the name of something else"),
        ({"pi": "3"}, "let.pi: is already"),
        ({"x": "1"}, "let.x: is already"),
        ({"von_mises": "1"}, "let.von_mises: is already"),
        ({"I4_f": "1"}, "let.I4_f: is already"),
        ({"two-words": "1"}, "let.two-words: cannot be a name in a formula"),
        ({"and": "1"}, "let.and: cannot be a name in a formula"),
        ({"r": "norm(x, y"}, "let.r: 'norm(x, y' is not a formula"),
        ({f"a{i}": f"sin(a{i + 1})" if i < 300 else "1" for i in range(301)}, "nested operations"),
    ],
)
def test_definitions_without_sense_are_refused(let: dict[str, Any], message: str) -> None:
    assert message in refusal(let=let)


def test_faults_name_the_definition_that_they_are_in() -> None:
    law = {"law": "neo-hookean", "mu": "10 kPa*s", "lam": "1 kPa"}
    assert "unknown name 'q' in 'q/2' ('s' of 'let')" in refusal(let={"s": "q/2"}, material=law)
    assert "'x + 1 s' ('s' of 'let') adds or compares a length and" in refusal(let={"s": "x + 1 s"}, material=law)
    assert "must be a stress, but '10 kPa*s'" in refusal(let={"s": "x"}, material=law)
    assert "unknown name 'X' in 'X/2' ('s' of 'let')" in refusal(let={"s": "X/2"}, regions={"part": "s < 1 mm"})
    moved = [{"region": "x0", "displacement": ["k*y", 0, 0], "constants": {"k": 1}}]
    assert "supports[0].constants.k: is already the name of a formula (let.k)" in refusal(
        let={"k": "2"}, supports=moved
    )
    energy = {"law": "formula", "energy": "m*(I1_bar - 3)", "parameters": {"m": "1 Pa"}, "kappa": "9 Pa"}
    assert "'m' is a parameter of this law and a formula (let.m)" in refusal(let={"m": "2 Pa"}, material=energy)


def test_repeated_definitions_are_evaluated_once() -> None:
    """Put into each other, sixty definitions would be 2^59 operations."""
    let = {f"a{i}": f"a{i - 1} + a{i - 1}" if i else "x" for i in range(60)}
    done = elastic(let=let, material={"law": "neo-hookean", "mu": "1 kPa*(2 + a59/(1 m))", "lam": "1 kPa"})
    assert done.material.mu.formula.evaluate(x=2.0**-59) == 3e3  # type: ignore[union-attr]


def test_long_formulas_are_formulas(comm: MPI.Intracomm) -> None:
    """A rule fitted to data: 600 terms, also as a form."""
    terms = [f"{1 / (k + 1):.6e}*(x/(1 m))**{k % 7}" for k in range(600)]
    text = " + ".join(terms)
    assert len(text) > 10_000
    x = np.linspace(0.1, 0.9, 5)
    expected = sum(float(f"{1 / (k + 1):.6e}") * x ** (k % 7) for k in range(600))
    np.testing.assert_allclose(Expression(text).evaluate(x=x), expected, rtol=1e-13)
    with pytest.raises(ValueError, match=r"a formula may have 20000 characters, not 33597"):
        Expression(" + ".join([*terms, *terms]))
    with pytest.raises(ValueError, match="too many operations; write it in parts"):
        Expression("+".join(["x"] * 9000))
    with pytest.raises(ValueError, match="is not a formula") as caught:
        Expression(text + " +")
    assert len(str(caught.value)) < 300
    mu = f"1 kPa*({' + '.join(terms[:120])})"
    result = package.run(elastic(material={"law": "neo-hookean", "mu": mu, "lam": "1 kPa"}, effects=[WEIGHT]), comm)
    assert result.solutions[0].solves[-1].outcome.accepted


WEIGHT = {"effect": "gravity", "acceleration": ["9.81 m/s^2", 0, 0], "density": "100 kg/m^3"}
NAMES = {"r": "norm(y, z)", "wide": "0.2 m", "t": "r/wide", "angle": "pi/3*(1 - 2*t)", "low": "x < 0.51 m"}
WRITTEN_OUT = {"r": "norm(y, z)", "t": "norm(y, z)/(0.2 m)", "angle": "(pi/3*(1 - 2*norm(y, z)/(0.2 m)))"}


def everywhere(names: dict[str, str], *, let: bool) -> Job:
    """A job that uses the names in each of the places that know them, or has what they stand for instead."""
    r, t, angle = (names[name] for name in ("r", "t", "angle"))
    low = "low" if let else "x < 0.51 m"
    bottom = "weak" if let else "0.5*(I1_bar - 3)"
    return elastic(
        mesh=box((2, 2, 2)),
        **({"let": NAMES | {"weak": "0.5*(I1_bar - 3)"}} if let else {}),
        regions={"lower": low},
        fibres={"f": {"direction": [f"sin({angle})", f"-z*cos({angle})/(1 m)", f"y*cos({angle})/(1 m)"],
                      "given_on": "current"}},
        material={
            "lower": {"law": "formula", "energy": f"mu*({bottom} + (I4_f - 1)**2)", "parameters": {"mu": "10 kPa"},
                      "kappa": "40 kPa"},
            "block": {"law": "neo-hookean", "mu": f"10 kPa*(1 + {t})", "lam": "40 kPa"},
        },
        effects=[WEIGHT],
        supports=[
            {"region": "x0", "fix": ["x", "y", "z"]},
            {"region": "x1", "displacement": [f"0.01*{r}", None, None]},
        ],
        discretisation={"formulation": "displacement", "displacement": 1},
        quantities=[{"name": "q", "of": f"ux*{t}", "on": "lower", "reduce": "mean", "over": "current"}],
    )  # fmt: skip


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_names_mean_the_same_as_what_they_stand_for(comm: MPI.Intracomm) -> None:
    named = package.run(everywhere({name: name for name in WRITTEN_OUT}, let=True), comm)
    plain = package.run(everywhere(WRITTEN_OUT, let=False), comm)
    assert np.abs(named.solutions[0].u).max(initial=0) > 1e-4
    assert np.abs(named.solutions[0].u - plain.solutions[0].u).max(initial=0) < 1e-11
    assert named.quantities["q"] == pytest.approx(plain.quantities["q"], rel=1e-9)


def test_jobs_with_other_definitions_are_other_problems() -> None:
    """A checkpoint, or a case of a sweep, belongs to what its names stand for; those that none uses do not matter."""

    def of(let: dict[str, str], **parts: Any) -> Job:
        law = {"law": "neo-hookean", "mu": "stiff*(1 + x/(1 m))", "lam": "1 kPa"}
        return elastic(let={"stiff": "10 kPa", "base": "1 m", "idle": "3"} | let, material=law, **parts)

    plain, other, idle = of({}), of({"stiff": "20 kPa"}), of({"idle": "4"})
    assert fingerprint(plain) != fingerprint(other)
    assert reuse_group_of(plain) != reuse_group_of(other)
    assert fingerprint(plain) == fingerprint(idle)
    asked = [{"name": "q", "of": "x/base", "on": "x1", "reduce": "mean"}]
    long, short = of({}, quantities=asked), of({"base": "2 m"}, quantities=asked)
    assert fingerprint(long) == fingerprint(short)
    assert content_key(long) != content_key(short)
    again = of({}).model_dump(mode="json", exclude_unset=True)
    assert again["let"] == {"stiff": "10 kPa", "base": "1 m", "idle": "3"}
    assert again["material"]["mu"] == "stiff*(1 + x/(1 m))"


def test_formulas_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["formulas"]) == 0
    printed = capsys.readouterr().out
    assert all(f"{name}()" in printed for name in FUNCTIONS)
    for place in PLACES:
        assert place.field.split()[0] in printed
    assert all(name in printed for name in ("von_mises", "cavity", "nz"))
    assert "pi = 3.14159" in printed


@pytest.mark.release
def test_every_field_that_takes_formulas_is_a_place_that_is_listed() -> None:
    """Places in laws and effects are found by their kind."""
    listed = " ".join(place.field for place in PLACES)
    root = Path(package.__file__).parent
    for file in root.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                kind = ast.unparse(node.annotation)
                if "Expression" in kind and (file.parent.name == "job" or file.name == "formula.py"):
                    assert node.target.id in listed, f"{file.name}: {node.target.id}"
