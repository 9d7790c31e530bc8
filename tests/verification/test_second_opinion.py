"""CalculiX loads rest shapes of ours into the given bodies; decks say each part of a job or refuse it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mesh_data_files import block
from helpers.verification import job

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import OutputError
from hpcinv.job.job import load
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws
from hpcinv.studies.second_opinion.calculix import version
from hpcinv.studies.second_opinion.calculix_deck import LOADS, expected_path, write_deck
from hpcinv.studies.second_opinion.loaded_body import LoadedBody, add_loads, loaded_body
from hpcinv.studies.second_opinion.nodal_forces import cell_forces, facet_forces
from hpcinv.studies.second_opinion.opinion import FOLDER, second_opinion
from hpcinv.studies.second_opinion.program_run import NoOpinion
from hpcinv.studies.second_opinion.units import Units
from hpcinv.trust.certificate import Verdict

needs_calculix = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
SIZE = {"lx": 0.1, "ly": 0.1, "lz": 0.2, "nx": 1, "ny": 1, "nz": 2}
BODY: dict[str, Any] = {
    "mesh": {"file": "../meshes/box.py", "parameters": SIZE},
    "material": {"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e4},
    "discretisation": {"displacement": 1, "formulation": "displacement"},
    "effects": [
        {"effect": "gravity", "acceleration": [1, 0, -2], "density": 1000},
        {"effect": "pressure", "region": "x0", "pressure": 100},
        {"effect": "traction", "region": "z1", "traction": [10, 50, 0], "area_in": "reference"},
    ],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "output": {"mesh": ["msh"], "fields": False},
}


def solved(directory: Path, **data: Any) -> Path:
    """Solve a job, and return the directory of its run."""
    hpcinv.run(job(**BODY | data), MPI.COMM_SELF, directory=directory / "run", progress=False)
    return directory / "run"


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return solved(tmp_path_factory.mktemp("first"))


@pytest.fixture
def plain_run(first_run: Path, tmp_path: Path) -> Path:
    """A copy of the run of `BODY`."""
    return Path(shutil.copytree(first_run, tmp_path / "run"))


def written(path: Path, script: str) -> str:
    """Write a program that is called as CalculiX is, and return its command."""
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(path)


def summary_lines(run: Path) -> list[dict[str, Any]]:
    lines: list[dict[str, Any]] = json.loads((run / "summary.json").read_text())["certificate"]["lines"]
    return lines


def certificate(run: Path) -> list[tuple[str, str]]:
    """Return names and verdicts of the lines."""
    return [(line["name"], line["verdict"]) for line in summary_lines(run)]


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_nodal_forces_have_resultant_and_moment(hexahedra: bool, degree: int) -> None:
    mesh = block(Path(__file__).parents[2] / "meshes", hexahedra, degree)
    load = np.array([3.0, -1.0, 2.0])
    size = np.ptp(mesh.points, axis=0)
    [top] = [group for group in mesh.groups if group.name == "z1"]
    forces = facet_forces(mesh, mesh.points, mesh.facets[top.members], load)
    middle = mesh.points.min(axis=0) + size * [0.5, 0.5, 1.0]
    assert forces.sum(axis=0) == pytest.approx(load * size[0] * size[1], rel=1e-12)
    assert np.cross(mesh.points, forces).sum(axis=0) == pytest.approx(np.cross(middle, forces.sum(axis=0)), rel=1e-10)
    weight = cell_forces(mesh, mesh.points, load)
    middle = mesh.points.min(axis=0) + size / 2
    assert weight.sum(axis=0) == pytest.approx(load * size.prod(), rel=1e-12)
    assert np.cross(mesh.points, weight).sum(axis=0) == pytest.approx(np.cross(middle, weight.sum(axis=0)), rel=1e-10)


def test_every_effect_is_written_or_refused_by_its_name() -> None:
    mesh = block(Path(__file__).parents[2] / "meshes", False, 1)
    for name, kind in effects().items():
        body = LoadedBody(name="a", rest=mesh, loaded=mesh.points, laws={}, forces=np.zeros_like(mesh.points))
        refused = list(add_loads(body, [kind.model_validate(kind.example)], LOADS)) if kind not in LOADS else []
        assert kind in LOADS or refused == [f"effects[0]: '{name}' has no counterpart"], name


@pytest.mark.everyday("True")
@needs_calculix
@pytest.mark.parametrize("hexahedra", [False, True])
def test_calculix_loads_the_rest_shape_into_the_given_body(hexahedra: bool, tmp_path: Path) -> None:
    run = solved(tmp_path, mesh=BODY["mesh"] | {"parameters": SIZE | {"hexahedra": hexahedra}})
    opinion = second_opinion(run, None, 60)
    assert opinion.displacement > 0.005
    assert opinion.largest < 1e-4 * opinion.displacement  # its file has 7 digits; residuals end at 1e-6
    assert opinion.by_elements == 0.0
    assert certificate(run)[-1] == ("second opinion", "pass")
    assert main(["second-opinion", str(run)]) == 0
    assert [name for name, _ in certificate(run)].count("second opinion") == 1


@needs_calculix
def test_linear_displacements_of_cells_with_middle_nodes_are_not_decided(tmp_path: Path) -> None:
    opinion = second_opinion(solved(tmp_path, mesh=BODY["mesh"] | {"geometry_degree": 2}), None, 60)
    assert opinion.element == "C3D10"
    assert opinion.largest > 1e-2 * opinion.displacement
    assert opinion.verdict is Verdict.UNDECIDED
    assert "our displacements are linear" in opinion.reason


@needs_calculix
def test_a_job_asks_for_a_second_opinion(plain_run: Path, tmp_path: Path) -> None:
    run = solved(tmp_path / "asked", second_opinion="calculix")
    assert certificate(run)[-1] == ("second opinion", "pass")
    alone = second_opinion(plain_run, None, 60)
    [line] = [line for line in summary_lines(run) if line["name"] == "second opinion"]
    assert line["value"] == pytest.approx(alone.largest, rel=1e-6)


def test_a_job_keeps_its_results_where_no_program_can_be_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    result = hpcinv.run(
        job(**BODY | {"second_opinion": "calculix"}), MPI.COMM_SELF, directory=tmp_path / "run", progress=False
    )
    assert result.certificate.verdict is Verdict.UNDECIDED
    assert certificate(tmp_path / "run")[-1] == ("second opinion", "not decided")
    assert "is not installed" in summary_lines(tmp_path / "run")[-1]["note"]
    without = hpcinv.run(job(**BODY | {"second_opinion": "calculix"}), MPI.COMM_SELF, progress=False)
    assert "needs the directory of a run" in without.certificate.lines[-1].note


@needs_calculix
def test_stiff_elements_explain_the_difference_of_a_body_with_unknown_pressure(tmp_path: Path) -> None:
    """With a rigid face, whose point our forward run has at another place than the given body."""
    spaces = {"displacement": 2, "formulation": "mixed"}
    law = BODY["material"] | {"kappa": 1e6}
    remote = {"force": [0.02, 0, 0], "moment": [0, 1e-3, 0], "about": [0.05, 0.05, 0.25]}
    loads = [*BODY["effects"], {"effect": "pressure", "region": "side", "pressure": 50}]
    run = solved(
        tmp_path,
        mesh=BODY["mesh"] | {"geometry_degree": 2},
        regions={"side": "x < 1e-6 m"},  # not on the rest shape
        discretisation=spaces,
        material=law,
        effects=loads,
        supports=[*BODY["supports"], {"region": "z1", "remote": remote}],
    )
    opinion = second_opinion(run, None, 120)
    assert opinion.by_elements is not None
    assert opinion.apart is not None
    assert opinion.largest > 1e-2 * opinion.displacement
    assert opinion.by_elements == pytest.approx(opinion.largest, rel=1e-2)
    assert opinion.apart < 1e-4 * opinion.displacement


@needs_calculix
def test_hexahedra_with_20_nodes_explain_the_difference_to_ours_with_27(tmp_path: Path) -> None:
    cells = BODY["mesh"] | {"parameters": SIZE | {"hexahedra": True}, "geometry_degree": 2}
    spaces = {"displacement": 2, "formulation": "displacement"}
    supports = [*BODY["supports"], {"region": "x0", "fix": ["normal"], "normal": [2, 1, 0]}]  # an oblique plane
    opinion = second_opinion(solved(tmp_path, mesh=cells, discretisation=spaces, supports=supports), None, 60)
    assert opinion.by_elements is not None
    assert opinion.apart is not None
    assert opinion.by_elements == pytest.approx(opinion.largest, rel=1e-2)
    assert opinion.largest > 5e-3 * opinion.displacement
    assert opinion.apart < 2e-4 * opinion.displacement


@needs_calculix
def test_terms_of_the_volume_that_a_law_has_not_are_not_added(tmp_path: Path) -> None:
    cards = {
        "low": {"law": "yeoh", "c1": 5e3, "c2": -200.0, "c3": 100.0, "kappa": 4e4},
        "elsewhere": {"law": "ogden", "mu": [6e3, 1e3], "alpha": [1.5, 4], "kappa": 4e4},
    }
    opinion = second_opinion(solved(tmp_path, regions={"low": "z <= 0.1001 m"}, material=cards), None, 60)
    assert opinion.largest < 1e-4 * opinion.displacement


@needs_calculix
def test_another_load_is_a_warning(plain_run: Path, tmp_path: Path) -> None:
    heavier = written(tmp_path / "heavier", 'sed -i "s/GRAV, 2/GRAV, 3/" $1.inp; exec ccx "$@"')
    assert second_opinion(plain_run, heavier, 60).verdict.value == "warning"
    assert certificate(plain_run)[-1] == ("second opinion", "warning")


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("echo begun; sleep 60", "was stopped after 1 s; its last lines:\n  begun"),
        ("echo 'no convergence'", "reached no load; its last lines:\n  no convergence"),
        (
            'printf "\\n displacements (vx,vy,vz) for set A and time  0.4E+00\\n\\n 1 0.0 0.0 0.0\\n" > $1.dat',
            "ended at 0.4 of the load",
        ),
        (
            'printf "\n displacements for set A and time  1.0\n\n" > $1.dat; '
            'for n in $(seq 99); do echo "$n 0.0 ****** 1.0-101" >> $1.dat; done',
            "printed displacements that are not finite",
        ),
    ],
)
def test_a_program_that_fails_is_not_decided_and_its_words_are_shown(
    script: str, message: str, plain_run: Path, tmp_path: Path
) -> None:
    with pytest.raises(NoOpinion) as error:
        second_opinion(plain_run, written(tmp_path / "program", script), 1)
    assert message in str(error.value)
    assert str(plain_run / FOLDER) in str(error.value)
    assert certificate(plain_run)[-1] == ("second opinion", "not decided")


def test_a_missing_program_is_one_message(plain_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["second-opinion", str(plain_run), "--command", "no-such-program"]) == 5
    assert "no-such-program: is not installed" in capsys.readouterr().err


@needs_calculix
def test_a_program_without_memory_is_not_decided(plain_run: Path) -> None:
    with pytest.raises(NoOpinion, match="reached no load"):
        second_opinion(plain_run, None, 60, memory=10_000_000)


@pytest.mark.parametrize(("option", "value"), [("--limit", "3 m"), ("--limit", "0 s"), ("--memory", "0")])
def test_limits_are_positive(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["second-opinion", "anywhere", option, value]) == 2
    assert f"{option} {value}: must be" in capsys.readouterr().err


def test_what_a_deck_cannot_say_is_refused_with_its_places(tmp_path: Path) -> None:
    springs = {"effect": "elastic-foundation", "region": "x1", "normal": 1e3, "tangential": 0, "area_in": "reference"}
    supports = [*BODY["supports"], {"region": "y0", "fix": ["normal"], "normal": [0, 1, 1]}]
    run = solved(tmp_path, effects=[*BODY["effects"], springs], supports=supports)
    with pytest.raises(OutputError) as error:
        loaded_body(run)
    assert "supports[1]: 'fix: [normal]' holds a direction" in str(error.value)
    assert "effects[3]: 'elastic-foundation' has no counterpart" in str(error.value)


@needs_calculix
def test_regions_by_conditions_are_those_of_the_given_body(tmp_path: Path) -> None:
    """The bodies hang aslant: on the rest shape the conditions choose other facets or none.

    A modulus, the density and a pressure have one value in each region.
    """
    gravity, *others = BODY["effects"]
    regions = {"low": "z <= 0.1001 m", "held": "nz < -0.99", "side": "x < 1e-6 m"}
    heavy = gravity | {"density": {"low": 700, "elsewhere": 1200}}
    loads = [heavy, *others, {"effect": "pressure", "region": "side", "pressure": {"low": 100, "elsewhere": 300}}]
    supports = [{"region": "held", "fix": ["x", "y", "z"]}]
    law = BODY["material"] | {"mu": {"low": BODY["material"]["mu"], "elsewhere": 2e4}}
    run = solved(tmp_path, regions=regions, material=law, effects=loads, supports=supports)
    opinion = second_opinion(run, None, 60)
    assert opinion.displacement > 0.005
    assert opinion.largest < 1e-4 * opinion.displacement


def test_a_program_that_says_no_version_has_none(tmp_path: Path) -> None:
    assert version(written(tmp_path / "program", "cat; echo done")) == ""


def test_a_deck_has_the_places_of_its_nodes_in_its_unit(plain_run: Path, tmp_path: Path) -> None:
    assert main(["export", str(plain_run), "--deck", str(tmp_path / "part.inp"), "--unit", "cm"]) == 0
    table = np.loadtxt(expected_path(tmp_path / "part.inp"), delimiter=",", skiprows=1)
    body = loaded_body(plain_run)
    assert table[:, 1:4] == pytest.approx(100 * body.rest.points, abs=1e-12)
    assert table[:, 4:] == pytest.approx(100 * body.loaded, abs=1e-12)
    text = (tmp_path / "part.inp").read_text()
    assert "*DENSITY\n1e-05\n" in text  # N s²/cm⁴
    assert all(len(word.strip()) <= 20 for line in text.splitlines() for word in line.split(",") if word[:1] != "*")


@pytest.mark.parametrize(("force", "stress"), [("N", "MPa"), ("mN", "kPa")])
def test_a_deck_is_read_back_as_the_loads_of_the_job(plain_run: Path, tmp_path: Path, force: str, stress: str) -> None:
    deck, path = tmp_path / "part.inp", tmp_path / "part.yaml"
    assert main(["export", str(plain_run), "--deck", str(deck), "--unit", "mm", "--force-unit", force]) == 0
    assert main(["new", "job", "--from", str(deck), "--unit", "mm", "--stress-unit", stress, str(path)]) == 0
    given = load(path)
    [law] = given.laws.values()
    numbers = {name: value for name, (value, _) in law.quantities().items()}
    assert (numbers["mu"], numbers["kappa"]) == pytest.approx((1e4, 4e4))
    loads = {effect.effect: effect for effect in given.effects}
    assert loads["gravity"].density == pytest.approx(1000)
    assert loads["gravity"].acceleration == pytest.approx((1, 0, -2))
    assert loads["pressure"].pressure == pytest.approx(100)
    [support] = given.supports
    assert support.held == {"x", "y", "z"}


def test_a_law_without_a_card_is_refused(plain_run: Path, tmp_path: Path) -> None:
    law = laws()["neo-hookean"].model_validate({"law": "neo-hookean", "mu": 1e4, "lam": 4e4})
    body = replace(loaded_body(plain_run), laws={"": law})
    with pytest.raises(OutputError, match="law 'neo-hookean' has no counterpart in Abaqus"):
        write_deck(tmp_path / "part.inp", body, Units(1.0))
    assert not (tmp_path / "part.inp").exists()


@needs_calculix
def test_a_body_without_load_has_an_opinion(tmp_path: Path) -> None:
    opinion = second_opinion(solved(tmp_path, effects=[]), None, 60)
    assert opinion.displacement == 0.0
    assert opinion.verdict is Verdict.PASS
    assert "of the largest displacement" not in opinion.lines()[0]


STIFF = {"law": "isochoric-neo-hookean", "young": 200e9, "poisson": 0.3}


@needs_calculix
def test_a_body_of_steel_has_an_opinion(tmp_path: Path) -> None:
    """CalculiX takes compliances below 1e-10 for 0; a deck in mm has larger ones."""
    load = {"effect": "pressure", "region": "z1", "pressure": -26e9}
    opinion = second_opinion(solved(tmp_path, material=STIFF, effects=[load]), None, 60)
    assert opinion.displacement > 0.01
    assert opinion.largest < 1e-4 * opinion.displacement


def test_a_deck_of_steel_in_metres_is_refused_for_calculix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = solved(tmp_path, material=STIFF)
    deck = ["export", str(run), "--deck", str(tmp_path / "part.inp")]
    assert main([*deck, "--unit", "m"]) != 0
    assert "CalculiX takes compliances of a law below 1e-10 for 0" in capsys.readouterr().err
    assert main([*deck, "--unit", "m", "--for", "abaqus"]) == 0
    assert main([*deck, "--unit", "mm"]) == 0


@needs_calculix
def test_a_body_of_micrometres_has_an_opinion(tmp_path: Path) -> None:
    """CalculiX refuses cells below 1e-20 cubed units of its deck."""
    parameters = {key: 1e-6 * value if key[0] == "l" else value for key, value in SIZE.items()}
    weight = {"effect": "gravity", "acceleration": [1, 0, -2], "density": 1e9}
    run = solved(tmp_path, mesh=BODY["mesh"] | {"parameters": parameters, "unit": "um"}, effects=[weight])
    opinion = second_opinion(run, None, 60)
    assert opinion.displacement > 1e-9
    assert opinion.largest < 1e-4 * opinion.displacement


@needs_calculix
def test_size_of_a_body_does_not_change_its_opinion(tmp_path: Path) -> None:
    """CalculiX takes residual forces below 1e-6 units for 0: with forces in N, a body of 2 mm was never solved well."""
    weight = {"effect": "gravity", "acceleration": [4000, 0, -4000], "density": 1000}
    mesh = BODY["mesh"] | {"parameters": {key: 0.01 * value if key[0] == "l" else value for key, value in SIZE.items()}}
    opinion = second_opinion(solved(tmp_path, mesh=mesh, effects=[weight]), None, 60)
    assert opinion.displacement > 1e-4
    assert opinion.largest < 1e-5 * opinion.displacement  # 1e-6 by the digits of its file; 7e-5 with forces in N


def test_forces_too_small_for_calculix_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = solved(
        tmp_path,
        mesh=BODY["mesh"] | {"parameters": {key: value if key[0] == "n" else 1e-3 for key, value in SIZE.items()}},
    )
    deck = ["export", str(run), "--deck", str(tmp_path / "part.inp")]
    assert main(deck) == 0
    assert "residual forces below 1e-06 units of force for 0" in capsys.readouterr().out
    for more in (["--force-unit", "nN"], ["--for", "abaqus"]):
        assert main([*deck, *more]) == 0
        assert "residual forces" not in capsys.readouterr().out
    assert main([*deck, "--force-unit", "mm"]) == 2
    assert "--force-unit mm: is not a unit of force" in capsys.readouterr().err


@needs_calculix
@pytest.mark.parametrize("form", ["displacement", "mixed"])
def test_supports_on_vertices_and_the_edges_between_them_are_written(form: str, tmp_path: Path) -> None:
    """Three corners of the block are held, and the nodes of the edges between two of them."""
    corners = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]
    run = solved(
        tmp_path,
        mesh=BODY["mesh"] | {"geometry_degree": 2},
        regions={"corners": {"vertices": corners}},
        supports=[{"region": "corners", "fix": ["x", "y", "z"]}],
        effects=[{"effect": "pressure", "region": name, "pressure": 50} for name in ("z0", "z1")],
        material=BODY["material"] | {"kappa": 1e6 if form == "mixed" else 4e4},
        discretisation={"displacement": 2, "formulation": form},
    )
    opinion = second_opinion(run, None, 60)
    assert opinion.apart is not None
    assert opinion.apart < 1e-4 * opinion.displacement


@needs_calculix
def test_another_equilibrium_is_said_to_be_one(tmp_path: Path) -> None:
    """A column that we bend beyond Euler's load stays straight in CalculiX."""
    size = {"lx": 0.02, "ly": 0.03, "lz": 0.2, "nx": 1, "ny": 1, "nz": 4, "hexahedra": True}
    run = solved(
        tmp_path,
        analysis="forward",
        mesh=BODY["mesh"] | {"parameters": size, "geometry_degree": 2},
        effects=[
            {"effect": "traction", "region": "z1", "traction": [0, 0, -120], "area_in": "reference"},
            {"effect": "gravity", "acceleration": [1e-13, 0, 0], "density": 1000},
        ],
        discretisation={"displacement": 2, "formulation": "displacement"},
        solver={"continuation": "series", "branch": "positive", "linear": "direct"},
    )
    opinion = second_opinion(run, None, 60)
    assert opinion.largest > 0.1 * opinion.displacement
    assert opinion.verdict is Verdict.WARN
    assert "is in equilibrium by our equations, too" in opinion.line().note
