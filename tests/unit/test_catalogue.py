"""What the command line shows of laws and effects: complete, with examples that work as printed."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest
import yaml

from hpcinv.__main__ import main
from hpcinv.base.quantity.docstrings import meanings
from hpcinv.base.quantity.expressions import Expression
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws

EVERYTHING = [("laws", name, kind) for name, kind in laws().items()]
EVERYTHING += [("effects", name, kind) for name, kind in effects().items()]


@pytest.mark.parametrize(("command", "known"), [("laws", laws()), ("effects", effects())])
def test_all_are_listed_with_a_line(command: str, known: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command]) == 0
    printed = capsys.readouterr().out
    assert all(f"{name} " in printed for name in known)
    assert "``" not in printed


@pytest.mark.parametrize(("command", "name", "kind"), EVERYTHING, ids=lambda v: v if isinstance(v, str) else "")
def test_each_is_shown_with_its_parameters_and_an_example(
    command: str, name: str, kind: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, name]) == 0
    printed = capsys.readouterr().out
    table, example = printed.split("\nmaterial:" if command == "laws" else "\neffects:")
    for key in kind.model_fields.keys() - {"law", "effect"}:
        assert f"\n{key} " in table
        assert meanings(kind).get(key), f"{key} has no meaning"
    section = yaml.safe_load(f"section:{example}")["section"]
    assert kind.model_validate(section if command == "laws" else section[0])
    if command == "laws":
        assert "energy: " in table


def test_a_misspelt_name_is_refused_with_a_proposal() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hpcinv", "laws", "gentt"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.strip() == "unknown law 'gentt'. Did you mean 'gent'?"
    assert done.stdout == ""


STARTING_VALUES = [(name, kind) for name, law in laws().items() for kind in law.starting_values]


@pytest.mark.parametrize(("name", "kind"), STARTING_VALUES)
def test_starting_values_are_a_material_as_they_are_printed(
    name: str, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert kind in ("rubber", "tissue")
    assert "doi:" in laws()[name].starting_values[kind].source
    assert main(["laws", name]) == 0
    _, _, below = capsys.readouterr().out.partition(f"Starting values for {kind} (")
    section = yaml.safe_load(below[below.index("\n  material:") :].split("\n\n")[0])
    assert laws()[name].model_validate(section["material"]).is_incompressible


def test_laws_of_rubber_and_of_tissue_have_starting_values() -> None:
    rubber = {"neo-hookean", "isochoric-neo-hookean", "mooney-rivlin", "yeoh", "gent", "arruda-boyce", "ogden"}
    tissue = {"neo-hookean", "fung-demiray", "holzapfel-gasser-ogden", "holzapfel-ogden", "guccione"}
    assert rubber <= {name for name, kind in STARTING_VALUES if kind == "rubber"}
    assert tissue <= {name for name, kind in STARTING_VALUES if kind == "tissue"}


@pytest.mark.parametrize("name", [name for name, kind in STARTING_VALUES if kind == "rubber"])
def test_starting_values_of_rubber_follow_the_test_they_come_from(name: str) -> None:
    """Nominal stress in uniaxial tension against points of Treloar's curve, to what such laws can do: 30 %."""
    law = laws()[name].model_validate({"law": name, **laws()[name].starting_values["rubber"].parameters})
    (par,) = law.cases()
    parameters = {key: value for key, value in vars(par).items() if isinstance(value, float)}
    if name == "ogden":
        parameters = {f"{key}{i + 1}": v for key in ("mu", "alpha") for i, v in enumerate(getattr(par, key))}
    formula = Expression(law.energy_formula.rpartition(" + ")[0])

    def energy(stretch: float) -> float:
        across = stretch**-0.5
        I1, I2 = stretch**2 + 2 * across**2, 2 * stretch + stretch**-2
        known = parameters | {"I1": I1, "I1_bar": I1, "I2_bar": I2, "J": 1.0}
        known |= {"lambda1_bar": stretch, "lambda2_bar": across, "lambda3_bar": across}
        return float(formula.evaluate(**{key: value for key, value in known.items() if key in formula.names}))

    for stretch, stress in ((1.24, 2.30), (1.9, 5.10), (3.02, 8.80)):
        derivative = (energy(stretch + 1e-5) - energy(stretch - 1e-5)) / 2e-5
        assert derivative == pytest.approx(stress * 98066.5, rel=0.3)
