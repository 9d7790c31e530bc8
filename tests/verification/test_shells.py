"""Shells through a job: shape files, states, laws, fibres, identification, and back to the unloaded surface."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.sheets import flat, save_sheet
from helpers.shell_cases import CLAMPED, LINEAR, YOUNG, cylinder, gap, job, solve, weight

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import MeshError
from hpcinv.job.job import parse
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.readers import read_surface
from hpcinv.output.result import Result
from hpcinv.physics.materials import laws
from hpcinv.solver.equations import Equations
from hpcinv.studies.identification.identification_run import identify

SIDES = {"region": "y0", "fix": ["y"]}
DIRECTIONS = [[2 / 3, -1 / 3, 2 / 3], [2 / 3, 2 / 3, -1 / 3], [-1 / 3, 2 / 3, 2 / 3]]


@pytest.mark.release
def test_rigid_rotation_strains_nothing(tmp_path: Path) -> None:
    path = save_sheet(tmp_path / "sheet.msh", 4, 1, cylinder(2, 1, 1.2))
    end = [2 * np.cos(1.2), 2 * np.sin(1.2), 0.5]
    result = solve(
        path,
        0.1,
        analysis="forward",
        effects=[{"effect": "gravity", "density": 0, "acceleration": [0, 0, -1], "density_in": "reference"}],
        supports=[{"region": "x0", "displacement": ["-x - y", "x - y", "0*z"]}],
        quantities=[{"name": "end", "of": "displacement", "at": end}],
    )
    assert result.solutions[0].strain_energy < 1e-9 * YOUNG * 0.1**3
    assert result.quantities["end"] == pytest.approx([-end[0] - end[1], end[0] - end[1], 0], abs=1e-9)


@pytest.mark.release
@pytest.mark.parallel([2])
def test_error_estimate_agrees_with_a_finer_mesh(tmp_path: Path, comm: MPI.Intracomm) -> None:
    """Of a tip and of the largest displacement, also of a state that is solved from the corrected rest shape."""

    def solved(count: int, **data: Any) -> Result:
        path = comm.bcast(tmp_path / f"{count}.msh")
        if comm.rank == 0:
            save_sheet(path, count, max(count // 2, 1), cylinder(1, 1, 1.2))
        comm.barrier()
        return solve(
            path,
            0.03,
            comm,
            material={"law": "neo-hookean", "mu": 4e5, "lam": 8e5},
            supports=[CLAMPED],
            quantities=[{"name": "tip", "of": "uy", "at": [np.cos(1.2), np.sin(1.2), 0.5]}],
            states=[{"name": "a", "given": True, "effects": [pushed(20)]}, {"name": "b", "effects": [pushed(-10)]}],
            certificate={"level": "quick", "round_trip": "off", "stability": False, "overlap": False} | data,
        )

    def pushed(pressure: float) -> dict[str, Any]:
        return {"effect": "pressure", "region": "inner", "pressure": pressure}

    exact, result = solved(12), solved(4, estimate=True)
    assert result.estimate is not None
    for tip in ("tip-a", "tip-b"):
        true = exact.quantities[tip] - result.quantities[tip]
        assert abs(true) > 1e-4
        assert 0.5 < result.estimate.quantities[tip] / true < 2
    largest = max(comm.allgather(abs(exact.quantities["tip-a"] - result.quantities["tip-a"])))
    assert result.estimate.shape == pytest.approx(largest, rel=0.8)


def test_without_memory_for_halved_cells_the_need_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The need of the finer problem: four times as many cells, not spaces of one degree more."""
    monkeypatch.setattr(hpcinv.solver.linear.selection, "available", lambda comm: 1e5)
    result = solve(
        save_sheet(tmp_path / "sheet.msh", 3, 2, flat(3, 2)),
        0.1,
        analysis="forward",
        certificate={"round_trip": "off", "stability": False},
        effects=[{"effect": "pressure", "region": "inner", "pressure": 1.0}],
        supports=[CLAMPED],
    )
    (line,) = (line for line in result.certificate.lines if line.name.startswith("discretisation error"))
    finer = Equations(result.job, result.body.halved, Timings()).chooser.forecast
    assert line.note == f"there is no memory for {finer.least / 1e9:.2g} GB on cells of half the size"


def test_error_estimate_of_a_ring_that_bends_far_has_the_right_sign(tmp_path: Path) -> None:
    """Newton's method comes near to a state that is too stiff by as much, and leaves it again."""

    def solved(cells: int, **certificate: Any) -> Result:
        path = save_sheet(
            tmp_path / f"{cells}.msh",
            cells,
            cells // 4,
            lambda s, t: np.column_stack([np.sin(np.pi / 2 * s), 0.2 * t, np.cos(np.pi / 2 * s)]),
        )
        return solve(
            path,
            0.01,
            analysis="forward",
            material={"law": "neo-hookean", "young": 1e6, "poisson": 0.3},
            effects=[{"effect": "traction", "region": "x0", "traction": [0, 0, -20], "area_in": "reference"}],
            supports=[{"region": edge, "fix": [axis]} for edge, axis in (("x0", "x"), ("x1", "z"), ("y0", "y"))],
            quantities=[{"name": "q", "of": "uz", "at": [0, 0, 1]}],
            certificate={"level": "quick", "overlap": False} | certificate,
        )

    coarse, fine = solved(4, estimate=True), solved(8)
    assert coarse.estimate is not None
    assert coarse.estimate.quantities["q"] == pytest.approx(fine.quantities["q"] - coarse.quantities["q"], rel=0.05)


@pytest.mark.release
@pytest.mark.parametrize(
    "name", [n if n == LINEAR["law"] else pytest.param(n, marks=pytest.mark.release) for n in laws()]
)
def test_laws_close_round_trips(tmp_path: Path, name: str) -> None:
    path = save_sheet(tmp_path / "sheet.msh", 4, 2, cylinder(1, 0.5, 1.0))
    kind = laws()[name]
    law = kind.model_validate(kind.example)
    fibres = {n: {"direction": d, "given_on": "reference"} for n, d in zip(law.families, DIRECTIONS, strict=False)}
    # in proportion to the stiffness: sheets that roll up may come from several unloaded ones
    pressure = 1e-5 * law.shear_modulus(law._parameters())
    result = solve(
        path,
        0.025,
        analysis="round_trip",
        material=kind.example,
        fibres=fibres,
        discretisation={"formulation": "displacement"},
        effects=[{"effect": "pressure", "region": "sheet|inner", "pressure": pressure}],
        supports=[CLAMPED],
    )
    assert np.abs(result.solutions[0].u).max() > 1e-4
    assert gap(result) < 1e-10


def test_shape_file_gives_the_flat_sheet_back(tmp_path: Path) -> None:
    """The loaded shape is a surface in the order of the given one; with its faces as data it determines the body."""
    path = save_sheet(tmp_path / "sheet.msh", 5, 1, flat(10, 1))
    base = job(
        path,
        0.1,
        effects=[{"effect": "gravity", "density": 1000, "acceleration": [0, 0, 0.05], "density_in": "reference"}],
        supports=[CLAMPED],
        output={"fields": False, "report": False, "mesh": ["msh"]},
    )
    there, back = tmp_path / "there", tmp_path / "back"
    hpcinv.run(base | {"analysis": "forward"}, progress=False, directory=there)
    mesh = {"file": str(there / "shape.msh"), "shell": {"director": "data"}}
    hpcinv.run(base | {"analysis": "inverse", "mesh": mesh}, progress=False, directory=back)
    flat_sheet, loaded, unloaded = (read_surface(p) for p in (path, there / "shape.msh", back / "shape.msh"))
    assert loaded.points[:, 2].max() > 3
    assert np.abs(unloaded.points - flat_sheet.points).max() < 1e-9
    assert (unloaded.cells == flat_sheet.cells).all()
    assert unloaded.data["thickness"].values == pytest.approx(0.1, abs=1e-10)


def test_arch_that_snapped_comes_back_from_a_rough_shape(tmp_path: Path) -> None:
    """Without a start, another unloaded body carries the weight in the same place."""

    def arch(rise: float) -> Path:
        def place(s: np.ndarray, t: np.ndarray) -> np.ndarray:
            return np.column_stack([s, 0.3 * t, rise * (1 - s**2)])

        return save_sheet(tmp_path / f"arch{rise}.msh", 6, 1, place)

    weight = {"effect": "gravity", "density": 1000, "acceleration": [0, 0, -3], "density_in": "reference"}
    base = {
        "material": LINEAR,
        "effects": [weight],
        "supports": [{"region": "x0", "fix": ["x"]}, {"region": "x1", "fix": ["x", "z"], "hinge": True}, SIDES],
        "certificate": {"level": "quick"},
        "output": {"fields": False, "report": False, "mesh": ["msh"]},
    }
    mesh = {"file": str(arch(0.1)), "shell": {"thickness": 0.02}}
    snapped = base | {"analysis": "forward", "mesh": mesh, "solver": {"start_shape": str(arch(-0.12))}}
    loaded = hpcinv.run(snapped, progress=False, directory=tmp_path / "loaded").solutions[0]
    assert loaded.u[:, 2].min() < -0.15

    def back(**solver: Any) -> Result:
        mesh = {"file": str(tmp_path / "loaded" / "shape.msh"), "shell": {"director": "data"}}
        return hpcinv.run(base | {"analysis": "inverse", "mesh": mesh, "solver": solver}, progress=False)

    shape = read_surface(arch(0.13))
    seen_from_below = replace(shape, cells=shape.cells[:, [1, 0, 3, 2, 4, 6, 5, 7, 8]])
    save_msh(arch(0.13), seen_from_below, shape.points)
    rough = back(start_shape=str(tmp_path / "arch0.13.msh"))
    assert np.abs(rough.solutions[0].other_nodes - loaded.mesh_nodes).max() < 1e-9
    line = next(line for line in rough.certificate.lines if line.name.startswith("limit points"))
    assert line.verdict.value == "not decided"
    assert "arch0.13.msh" in line.note
    assert "another body may carry the same load" in line.note
    assert np.abs(back().solutions[0].other_nodes - loaded.mesh_nodes).max() > 0.1

    with pytest.raises(MeshError, match=r"none\.msh: no such file\n.*solver\.start_shape is relative"):
        back(start_shape="none.msh")
    with pytest.raises(MeshError, match=r"the cells of solver\.start_shape are not"):
        back(start_shape=str(save_sheet(tmp_path / "other.msh", 5, 1, flat(1, 0.3))))


@pytest.mark.release
@pytest.mark.parametrize("suffix", [".vtu", ".inp"])
def test_exported_body_sags_as_the_shell(tmp_path: Path, suffix: str) -> None:
    """The thick body in hexahedra of 27 or 20 nodes is a solid, fully integrated: 1 % stiffer than the shell."""
    path = save_sheet(tmp_path / "sheet.msh", 8, 4, cylinder(10, 5, 1))
    gravity = {"effect": "gravity", "density": 1000, "acceleration": [-0.02, 0, 0], "density_in": "reference"}
    base = job(path, 0.4, analysis="forward", effects=[gravity], supports=[CLAMPED])
    base["quantities"] = [{"name": "tip", "of": "ux", "on": "x1", "reduce": "mean"}]
    shell = hpcinv.run(base, progress=False, directory=tmp_path / "run")
    solid = tmp_path / f"thick{suffix}"
    assert main(["export", str(tmp_path / "run"), "--shape", "undeformed", "--to", str(solid), "--unit", "m"]) == 0
    again = hpcinv.run(base | {"mesh": {"file": str(solid)}}, progress=False)
    assert shell.quantities["tip"] < -0.9
    assert 0.97 < again.quantities["tip"] / shell.quantities["tip"] < 1


@pytest.mark.release
def test_states_and_sensitivities_agree_with_a_solid(tmp_path: Path) -> None:
    """A second state begins at the shape of a round trip, and derivatives agree with central differences."""
    path = save_sheet(tmp_path / "sheet.msh", 4, 2, cylinder(1, 1, 1))
    law = {"law": "neo-hookean", "mu": 3e4, "lam": 1.2e5}
    tip = {"name": "tip", "of": "displacement", "at": [np.cos(1.0), np.sin(1.0), 0.5]}

    def case(mu: float = law["mu"], pressure: float = 30.0, **data: Any) -> Result:
        effects = {} if "states" in data else {"effects": [pushed(pressure)]}
        return solve(path, 0.1, material=law | {"mu": mu}, supports=[CLAMPED], quantities=[tip], **effects, **data)

    def pushed(pressure: float) -> dict[str, Any]:
        return {"effect": "pressure", "region": "inner", "pressure": pressure}

    alone = case(analysis="inverse", sensitivities={"material.mu": 300.0, "effects[0].pressure": 1.0})
    slopes = alone.sensitivities.slopes["tip"]
    for key, name, value in (("material.mu", "mu", 3e4), ("effects[0].pressure", "pressure", 30.0)):
        step = 1e-3 * value
        ends = [np.array(case(**{name: value + s * step}, analysis="inverse").quantities["tip"]) for s in (1, -1)]
        assert slopes[key] == pytest.approx((ends[0] - ends[1]) / 2 / step, rel=1e-4, abs=1e-12)
    both = case(states=[{"name": "a", "given": True, "effects": [pushed(30)]}, {"name": "b", "effects": [pushed(-30)]}])
    assert both.quantities["tip-a"] == pytest.approx(alone.quantities["tip"], abs=1e-13)
    assert both.quantities["tip-b"][1] * both.quantities["tip-a"][1] < 0


@pytest.mark.release
def test_fixed_points_find_the_direct_shape(tmp_path: Path) -> None:
    path = save_sheet(tmp_path / "sheet.msh", 4, 1, flat(10, 1))
    data: dict[str, Any] = {"analysis": "inverse", "effects": [weight(-3e-4)], "supports": [CLAMPED]}
    direct, fixed = (solve(path, 0.1, method=method, **data).solutions[0].u for method in ("direct", "anderson"))
    assert np.abs(direct).max() > 0.1
    assert np.abs(fixed - direct).max() < 1e-8


@pytest.mark.release
def test_modulus_is_identified_by_a_deflection(tmp_path: Path) -> None:
    """A sheet that hangs is given; the deflection of its end after it was turned over determines its modulus."""
    data = job(
        save_sheet(tmp_path / "sheet.msh", 4, 1, flat(10, 1)),
        0.1,
        supports=[CLAMPED],
        states=[
            {"name": "hanging", "given": True, "effects": [weight(-3e-4)]},
            {"name": "turned", "effects": [weight(3e-4)]},
        ],
        quantities=[{"name": "end", "of": "z", "at": [10, 0.5, 0], "state": "turned"}],
    )
    end = hpcinv.run(data, progress=False).quantities["end"]
    observed = {"name": "end", "quantity": "end", "value": float(end), "sd": 1e-3}
    unknown = {"material": LINEAR | {"young": 0.7 * YOUNG}}
    section = {"parameters": {"material.young": None}, "observations": [observed]}
    found = identify(parse(data | unknown | {"identify": section}, tmp_path / "job.yaml"), MPI.COMM_SELF).estimate
    assert found.values[0] == pytest.approx(YOUNG, rel=1e-4)


@pytest.mark.release
def test_accuracy_is_met_on_smaller_cells(tmp_path: Path) -> None:
    def tip(cells: int, **data: Any) -> Result:
        return solve(
            save_sheet(tmp_path / "sheet.msh", cells, max(cells // 4, 1), flat(10, 1)),
            0.1,
            analysis="inverse",
            effects=[weight(-3e-4)],
            supports=[CLAMPED],
            quantities=[{"name": "tip", "of": "uz", "at": [10, 0.5, 0]}],
            **data,
        )

    found, fine = tip(2, accuracy={"tip": "1 mm"}), tip(32)
    assert found.accuracy is not None
    assert len(found.accuracy.rows) > 1
    assert abs(found.quantities["tip"] - fine.quantities["tip"]) < found.accuracy.bounds["tip"] < 1e-3


@pytest.mark.release
def test_fibres_by_a_rule_are_helices(tmp_path: Path) -> None:
    """Fibres of a tube between the faces of a shell: as by a formula, and back."""
    path = save_sheet(tmp_path / "tube.msh", 6, 2, cylinder(1, 1, np.pi / 2))
    law = {"law": "holzapfel-gasser-ogden", "mu": 3e4, "k1": 2e4, "k2": 1.0, "dispersion": 0.1}
    rule = {"kind": "tube", "inner": "inner", "outer": "outer", "inlet": "y0", "outlet": "y1"}
    cosine, sine = np.cos(0.5), np.sin(0.5)
    formulas, rules = dict[str, Any](), dict[str, Any]()
    for number, sign in ((1, 1), (2, -1)):
        direction = [f"-{cosine}*y", f"{cosine}*x", f"{sign * sine}*norm(x, y)"]
        formulas[f"fibre{number}"] = {"direction": direction, "given_on": "current"}
        rules[f"fibre{number}"] = {"rule": rule | {"helix": 0.5 * sign}, "given_on": "current"}
    radii = []
    for fibres in (formulas, rules):
        result = solve(
            path,
            0.1,
            analysis="round_trip",
            material=law | {"kappa": "incompressible"},
            fibres=fibres,
            effects=[{"effect": "pressure", "region": "inner", "pressure": 3e3}],
            supports=[
                {"region": "x0", "fix": ["y"]},
                {"region": "x1", "fix": ["x"]},
                {"region": "y0", "fix": ["z"]},
                {"region": "y1", "fix": ["z"]},
            ],
            quantities=[{"name": "widening", "of": "ux", "at": [1, 0, 0.5]}],
        )
        radii.append(result.quantities["widening"])
        assert gap(result) < 1e-9
    assert radii[1] == pytest.approx(radii[0], rel=1e-3)
