"""Runs that hand on what they have made must find what each finds alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.sweeps import write_sweep
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.driver import run
from hpcinv.errors import MeshError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import Job, load
from hpcinv.job.reuse_key import body_key, numbers_of, reuse_group_of
from hpcinv.output.result import Result
from hpcinv.solver.methods.method import Guess
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.sweep.sweep_interface import sweep

CLAMPED = [{"region": "x0", "fix": ["x", "y", "z"]}]


def block(mu: float = 10e3, g: float = -9.81, **changes: Any) -> Job:
    given: dict[str, Any] = {
        "mesh": box((2, 1, 1), lx=2.0),
        "material": {"law": "neo-hookean", "mu": mu, "lam": 4 * mu},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, g], "density": 100.0}],
        "supports": CLAMPED,
        "quantities": [{"name": "sag", "of": "uz", "at": [2, 0.5, 0.5]}],
    }
    return job(**(given | changes))


def by_region(inner: float, outer: float, displacement: str) -> Job:
    """Fields of all kinds: by region, by formula with constants; springs, and a support that moves."""
    return block(
        regions={"left": "x < 1"},
        material={
            "left": {"law": "neo-hookean", "mu": {"left": inner, "elsewhere": outer}, "lam": "2e4 + 1e3*X"},
            "elsewhere": {"law": "gent", "mu": outer, "jm": 50, "kappa": 8 * outer},
        },
        effects=[
            {"effect": "gravity", "acceleration": [0, 0, -2], "density": {"left": 100, "elsewhere": 200}},
            {"effect": "elastic-foundation", "region": "x1", "normal": inner},
        ],
        supports=[{"region": "x0", "displacement": [displacement, 0, 0]}],
        discretisation={"formulation": "displacement"},
    )


def by_name(**sections: Any) -> tuple[Job, Job]:
    """Jobs that differ in the value of a name, which some of their sections use."""
    before, after = (block(let={"c": c}, **sections) for c in ("0.9", "1.9"))
    return before, after


def layered(c: float) -> Job:
    """A formula of which the number is a factor, or no term at all."""
    law = {"law": "formula", "energy": "mu/2*(I1_bar - 3) + c*(I1_bar - 3)^2", "kappa": "40 kPa"}
    return block(material=law | {"parameters": {"mu": "10 kPa", "c": f"{c} kPa"}})


def pressed(**numbers: Any) -> Job:
    """A block that rests on a rigid ball."""
    ball = {"shape": "sphere", "centre": [1, 0.5, -3], "radius": 3}
    contact = {"effect": "contact", "region": "z0", "obstacle": ball}
    return block(
        analysis="forward",
        effects=[
            {"effect": "gravity", "acceleration": [0, 0, -30], "density": 100.0},
            {**contact, **numbers},
        ],
        quantities=[{"name": "depth", "of": "contact_penetration", "on": "z0"}],
    )


PAIRS = {
    "name in a region": by_name(
        regions={"left": "x < c"},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -2], "density": {"left": 100, "elsewhere": 200}}],
        mesh=box((4, 1, 1), lx=2.0),
    ),
    "term of a law": (layered(0), layered(20)),
    "penetration": (pressed(penetration="10 mm"), pressed(penetration="0.1 mm")),
    "numbers": (block(), block(3.3e3, -5.0)),
    "scales": (block(), block(1e7, -5e3)),
    "fields": (by_region(1e4, 2e4, "0.05"), by_region(5e4, 1e4, "0.1")),
    "round trip": (block(analysis="round_trip"), block(7e3, analysis="round_trip", first="forward")),
    "law": (block(), block(material={"law": "gent", "mu": 1e4, "jm": 50, "kappa": 5e4})),
    "mesh": (block(), block(mesh=box((1, 1, 2)), quantities=[])),
    "nearly incompressible": (
        block(material={"law": "neo-hookean", "mu": 1e4, "lam": 1e6}),
        block(material={"law": "neo-hookean", "mu": 2e4, "lam": 1e7}),
    ),
}


@pytest.mark.everyday("down")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("names", [("0.066 m", "0.133 m"), ("0.133 m", "0.066 m")], ids=["up", "down"])
def test_a_region_moves_with_a_name_that_is_swept(
    names: tuple[str, str], run_directory: Path, comm: MPI.Intracomm
) -> None:
    content: dict[str, Any] = {
        "mesh": box((6, 2, 2), lx=0.2, ly=0.1, lz=0.1),
        "let": {"c": names[0]},
        "regions": {"soft": "x > c"},
        "material": {
            "soft": {"law": "neo-hookean", "mu": "30 kPa", "lam": "60 kPa"},
            "elsewhere": {"law": "neo-hookean", "mu": "60 kPa", "lam": "60 kPa"},
        },
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        "supports": CLAMPED,
        "quantities": [{"name": "V", "of": "1", "on": "soft", "reduce": "integral", "over": "current"}],
        "certificate": "off",
    }
    content["mesh"] = content["mesh"] | {"file": str(ROOT / "meshes" / "box.py")}
    if comm.rank == 0:
        write_sweep(run_directory, [{"grid": {"let.c": list(names)}}], job=content)
    result = sweep(run_directory / "sweep.yaml", comm, ranks_per_case=comm.size)
    lengths = {"0.066 m": 2 / 15, "0.133 m": 1 / 15}  # of whole cells, each 1/30 m long, beyond the plane
    assert result["V"] == pytest.approx([1e-2 * lengths[name] for name in names], rel=1e-12)


def differs(first: Result, other: Result) -> float:
    """Largest difference of shapes, relative to the displacement."""
    solution = first.solutions[-1]
    gap = float(np.abs(solution.other_nodes - other.solutions[-1].other_nodes).max(initial=0.0))
    return solution.displacement.function_space.mesh.comm.allreduce(gap, op=MPI.MAX) / solution.largest_displacement


@pytest.mark.everyday("name in a region", "term of a law")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("pair", PAIRS)
def test_a_second_run_in_a_process_gives_the_same_results_as_alone(pair: str, comm: MPI.Intracomm) -> None:
    check_as_alone(*PAIRS[pair], comm)


@pytest.mark.parallel([2])
def test_a_second_run_on_two_ranks_gives_the_same_results_as_alone(comm: MPI.Intracomm) -> None:
    check_as_alone(*PAIRS["numbers"], comm)


def check_as_alone(before: Job, after: Job, comm: MPI.Intracomm) -> None:
    alone = run(after, comm)
    with Workspace(comm) as workspace:
        run(before, comm, workspace=workspace)
        result = run(after, comm, workspace=workspace)
        again = run(before, comm, workspace=workspace)
    assert differs(alone, result) < 1e-11
    assert differs(run(before, comm), again) < 1e-11
    assert result.solutions[0].strain_energy == pytest.approx(alone.solutions[0].strain_energy, rel=1e-10)
    assert result.quantities == pytest.approx(alone.quantities, rel=1e-10)
    assert np.abs(
        result.solutions[0].cauchy_stress.x.array - alone.solutions[0].cauchy_stress.x.array
    ).max() < 1e-8 * np.abs(alone.solutions[0].cauchy_stress.x.array).max(initial=1.0)


def test_objects_shared_by_two_runs_are_built_once(comm: MPI.Intracomm) -> None:
    with Workspace(comm) as workspace:
        run(block(), comm, workspace=workspace)
        body, (model,) = workspace._body, workspace._equations.values()
        assert body is not None
        matrix = next(iter(model._idle.values())).system.matrix
        run(block(2e4), comm, workspace=workspace)
        assert list(workspace._equations.values()) == [model]
        assert next(iter(model._idle.values())).system.matrix is matrix
        run(PAIRS["law"][1], comm, workspace=workspace)
        assert workspace._body is not None
        assert workspace._body[1] is body[1]
        assert model not in workspace._equations.values()


def test_a_job_that_is_refused_leaves_nothing_behind(comm: MPI.Intracomm) -> None:
    def moved(k: float) -> Job:
        return block(supports=[{"region": "x0", "displacement": ["0.05*k/k", 0, 0], "constants": {"k": k}}])

    alone = run(moved(2.0), comm)
    with Workspace(comm) as workspace:
        run(moved(1.0), comm, workspace=workspace)
        with pytest.raises(MeshError, match="is not finite"):
            run(moved(0.0), comm, workspace=workspace)
        assert differs(alone, run(moved(2.0), comm, workspace=workspace)) < 1e-11


OBSTACLE = {"shape": "level-set", "formula": "z + 0.02*c"}
FIBRES = {"fibre": {"direction": [1, "c*X", 0], "given_on": "reference"}}
NAMED: dict[str, dict[str, Any]] = {
    "law": {
        "material": {"law": "neo-hookean", "mu": "1e4*(c + X)", "lam": 4e4},
        "discretisation": {"formulation": "displacement"},
    },
    "support": {"supports": [{"region": "x0", "displacement": ["0.05*c", "0.02*c*y", 0]}]},
    "load": {"effects": [{"effect": "pressure", "region": "x1", "pressure": "300*c*(1 + z)"}]},
    "inelastic strain": {"effects": [{"effect": "growth", "stretch": "1 + 0.1*c*X"}]},
    "fibres": {
        "fibres": FIBRES,
        "material": {"law": "transversely-isotropic", "mu": 1e4, "k": 2e4, "kappa": 3e4},
    },
    "obstacle": {
        "analysis": "forward",
        "effects": [{"effect": "contact", "region": "z0", "obstacle": OBSTACLE, "stiffness": "60 kPa/m"}],
    },
    "definition": {"let": {"r": "c*norm(y, z)"}, "supports": [{"region": "x0", "displacement": [0, "r", 0]}]},
}


@pytest.mark.parametrize("section", NAMED)
def test_a_name_in_a_formula_counts_by_its_value(section: str) -> None:
    sections = NAMED[section]
    first, other = (block(**sections | {"let": {"c": c} | sections.get("let", {})}) for c in ("0.9", "1.9"))
    assert (reuse_group_of(first), numbers_of(first)) != (reuse_group_of(other), numbers_of(other))
    assert content_key(first) != content_key(other)


def test_settings_of_mesh_and_checks_are_part_of_the_key(tmp_path: Path) -> None:
    """The unit of an image that is left out is mm; surfaces have names; an assumed error changes a certificate."""
    (tmp_path / "a.stl").write_text("solid a")
    (tmp_path / "b.stl").write_text("solid b")
    (tmp_path / "scan.nrrd").write_bytes(b"NRRD0004")

    def with_mesh(**mesh: Any) -> Job:
        common = {"material": {"law": "neo-hookean", "mu": 1e4, "lam": 4e4}, "supports": CLAMPED}
        return load({**common, "mesh": {"size": "5 mm", **mesh}}, directory=tmp_path)

    scan = {"image": "scan.nrrd", "labels": {"body": 1}}
    jobs = [
        with_mesh(**scan),
        with_mesh(**scan, unit="m"),
        with_mesh(surfaces={"in": ["a.stl"], "out": ["b.stl"]}, unit="mm"),
        with_mesh(surfaces={"out": ["a.stl"], "in": ["b.stl"]}, unit="mm"),
        with_mesh(surfaces={"in": ["a.stl", "b.stl"]}, unit="mm"),
        with_mesh(surface="a.stl", unit="mm"),
        with_mesh(surface="a.stl", unit="mm", surface_error={"sd": "1 mm"}),
        with_mesh(surface="a.stl", unit="mm", surface_error={"sd": "2 mm"}),
    ]
    assert len({content_key(variant) for variant in jobs}) == len(jobs)
    assert len({body_key(variant) for variant in jobs}) == len(jobs)
    assert content_key(with_mesh(**scan, unit="mm")) == content_key(jobs[0])


def test_only_numbers_may_differ_within_a_reuse_group() -> None:
    same = [block(), block(2e4, -1.0), block(effects=[{"effect": "gravity", "acceleration": [1, 2, 3], "density": 5}])]
    other = [
        block(material={"law": "neo-hookean", "mu": 1e4, "lam": "incompressible"}, discretisation={"displacement": 2}),
        block(
            material={"law": "neo-hookean", "mu": {"boundary": 1e4}, "lam": 4e4},
            discretisation={"formulation": "displacement"},
        ),
        block(effects=[]),
        block(mesh=box((2, 1, 1), lx=2.5)),
        block(supports=[{"region": "x1", "fix": ["x", "y", "z"]}]),
        block(discretisation={"displacement": 3}),
        block(analysis="forward"),
    ]
    assert len({reuse_group_of(j) for j in same}) == 1
    assert len({reuse_group_of(j) for j in (same[0], *other)}) == 1 + len(other)
    assert [numbers_of(j) for j in same[:2]] == [
        (10e3, 40e3, 0.0, 0.0, -9.81, 100.0),
        (20e3, 80e3, 0.0, 0.0, -1.0, 100.0),
    ]


@pytest.mark.parallel([2, 1])
def test_a_run_from_a_guess_ends_where_it_ends_without(comm: MPI.Intracomm) -> None:
    near, wanted = block(9.8e3), block()
    alone, there = run(wanted, comm), run(near, comm).solutions[0]
    u = there.displacement.x.array
    warm = run(wanted, comm, guesses=[Guess(u, None)])
    assert [s.strategy for s in warm.solutions[0].solves] == ["guess"]
    assert differs(alone, warm) < 1e-11
    # Far from any solution it is given up, and the run begins with the unloaded body; so where the sign is another.
    for guess in (Guess(-40 * u, None), Guess(u, None, sign=-there.solves[-1].signs[-1])):
        cold = run(wanted, comm, guesses=[guess])
        assert [s.strategy for s in cold.solutions[0].solves][:2] == ["guess", "load steps"]
        assert not cold.solutions[0].solves[0].outcome.accepted
        assert differs(alone, cold) < 1e-13  # on two ranks MUMPS adds up in the order in which messages arrive
