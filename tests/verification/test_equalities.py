"""A few of the runs that theory makes equal; ``benchmarks/equalities.py`` draws many more."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.equalities import (
    TOLERANCE,
    Scene,
    Solution,
    block,
    compare,
    drawn,
    renumbered,
    rotation,
    scene_of,
    solved,
    transformed,
)

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.physics.effects import effects


@pytest.mark.everyday("1-0", "2-1", "3-2")
@pytest.mark.parametrize("part", [0, 1, 2])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_equal_runs_of_a_drawn_scene(seed: int, part: int, tmp_path: Path) -> None:
    """Two of the six equalities in each part."""
    rng = np.random.default_rng(seed)
    differences: list[tuple[str, float]] = []
    while not differences:  # a scene may be too soft for its loads
        scene = drawn(rng, degrees=(1,))
        print(scene.title)
        differences = list(compare(scene, rng, tmp_path, {part, part + 3}))
    print(*(f"  {name}: {difference:.1e}" for name, difference in differences), sep="\n")
    assert not [f"{name}: {d:.1e}" for name, d in differences if not d < TOLERANCE]


@pytest.mark.parallel(2)
def test_two_ranks_give_the_results_of_one(comm: MPI.Intracomm, run_directory: Path) -> None:
    rng = np.random.default_rng(4)
    scene = scene_of(block(rng, hexahedra=False), "neo-hookean", ["gravity", "traction"], "inverse", 1)
    alone = solved(scene, run_directory / f"alone-{comm.rank}.msh", MPI.COMM_SELF)
    together = solved(scene, run_directory / "together.msh", comm)
    assert alone is not None
    assert together is not None
    difference = alone.difference(together)
    assert difference < TOLERANCE


PAIRS = list(itertools.combinations((name for name, kind in effects().items() if not kind.only_of_kind), 2))
"""each two effects of solids"""


@pytest.mark.everyday("gravity and traction")
@pytest.mark.parametrize("pair", PAIRS, ids=" and ".join)
def test_pairs_of_effects_depend_neither_on_axes_nor_on_numbers(pair: tuple[str, str], tmp_path: Path) -> None:
    """Each two effects act together, or their load is not carried, in every frame and numbering."""
    rng = np.random.default_rng(PAIRS.index(pair))
    scene = scene_of(block(rng, hexahedra=False), "neo-hookean", list(pair), "inverse", 1)
    base = solved(scene, tmp_path / "base.msh", MPI.COMM_SELF)
    matrix = float(rng.uniform(0.3, 3)) * rotation(rng)
    turned = solved(transformed(scene, matrix), tmp_path / "turned.msh", MPI.COMM_SELF)
    other = solved(renumbered(scene, rng), tmp_path / "renumbered.msh", MPI.COMM_SELF)
    if base is None:
        assert turned is None
        assert other is None
        return
    assert turned is not None
    assert other is not None
    energy = np.linalg.det(matrix) * base.energy
    assert Solution(base.nodes @ matrix.T, base.u @ matrix.T, energy).difference(turned) < TOLERANCE
    assert base.difference(other) < TOLERANCE


@pytest.mark.release
@pytest.mark.parallel(2)
@pytest.mark.parametrize("seed", range(10, 20))
def test_two_ranks_find_what_one_finds_of_a_drawn_scene(seed: int, comm: MPI.Intracomm, run_directory: Path) -> None:
    scene = drawn(np.random.default_rng(seed), degrees=(1,))
    alone = solved(scene, run_directory / f"alone-{comm.rank}.msh", MPI.COMM_SELF)
    together = solved(scene, run_directory / "together.msh", comm)
    print(scene.title, "" if alone else "load not carried")
    assert (alone is None) == (together is None)
    assert alone is None or together is None or alone.difference(together) < TOLERANCE


def pressed(scene: Scene) -> Scene:
    """A block whose top a tilted rigid plane presses down, so that it touches along an edge."""
    plane = {"shape": "plane", "point": [0.5, 0.5, 1.06], "normal": [0.1, 0.05, -1]}
    contact = {"effect": "contact", "region": "z1", "obstacle": plane, "travel": [0, 0, -0.1]}
    return scene_of(scene, "neo-hookean", ["gravity"], "forward", 2).changed(effects=[contact])


@pytest.mark.everyday("1.4")
@pytest.mark.parametrize("scale", [1.0, 1.4])
def test_rigid_contact_depends_neither_on_axes_nor_on_units(scale: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    scene = pressed(block(rng, hexahedra=False))
    diagonal = np.array([1.0, 1, 1]) / np.sqrt(3)
    side = np.array([1.0, -1, 0]) / np.sqrt(2)
    turn = scale * np.stack([diagonal, side, np.cross(diagonal, side)])  # the box of the body has another diagonal
    base = solved(scene, tmp_path / "base.msh", MPI.COMM_SELF)
    turned = solved(transformed(scene, turn), tmp_path / "turned.msh", MPI.COMM_SELF)
    assert base is not None
    assert turned is not None
    expected = type(base)(base.nodes @ turn.T, base.u @ turn.T, scale**3 * base.energy)
    difference = expected.difference(turned)
    assert difference < TOLERANCE


def test_penetration_does_not_depend_on_axes(tmp_path: Path) -> None:
    """The line of the certificate compares lengths of vectors, and its iterations end at the same place."""
    rng = np.random.default_rng(5)
    scene = pressed(block(rng, hexahedra=False)).changed(certificate=NO_CERTIFICATE | {"stability": True})
    changes = []
    for name, turned in (("base", scene), ("turned", transformed(scene, rotation(rng)))):
        result = hpcinv.run(turned.job(tmp_path / f"{name}.msh"), MPI.COMM_SELF)
        lines = [line for line in result.certificate.lines if line.name.endswith("if the penalty is doubled")]
        changes += [line.value for line in lines]
    print(changes)
    assert len(changes) == 2
    assert changes[0] is not None
    assert changes[1] == pytest.approx(changes[0], rel=1e-5)
