"""Partitioned meshes: what is in them, jobs on them against those on whole ones, and that no rank has it all."""

from __future__ import annotations

import dataclasses
import json
import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import PROBLEM, fields
from helpers.command_line import BLOCK, NO_CERTIFICATE, write_job
from helpers.mesh_cases import TETRAHEDRON, conditions, spec, write_msh22
from helpers.mesh_data_files import ARRAYS, block, linear, values
from helpers.partitions import input_vertex_sets, owners, slow_edge_cut
from helpers.solutions import SOLVES

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.mesh_formats.partitioned import HEADER
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import JobError, MeshError, OutputError
from hpcinv.job.fingerprint import fingerprint
from hpcinv.mesh import Body, MeshSource, build_body, read_source, reorder_to_source, write_mesh
from hpcinv.mesh.data import distribute
from hpcinv.mesh.distributed.partition import partitioned
from hpcinv.mesh.distributed.partitioned import cells_of, read_partitioned, write_partitioned
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.io.gmsh_model import metis
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.parts import parts_of
from hpcinv.mesh.source import DataArray, Group
from hpcinv.output.checkpoint import Checkpoints, Position

CLOSE = 1e-12
MOVE = np.array([3.0, 2.0, 1.0])


def with_data(meshes: Path, *, hexahedra: bool, degree: int) -> MeshSource:
    """A block with groups, and with linear functions of position as data."""
    source = block(meshes, hexahedra, degree)
    corners = source.points[source.cells[:, : 8 if hexahedra else 4]]
    arrays = values(source.points, corners.mean(axis=1))
    data = {name: DataArray(name, on, arrays[name]) for name, (on, _) in ARRAYS.items()}
    return dataclasses.replace(source, data=data)


@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("degree", [1, 2])
def test_a_mesh_is_cut_as_metis_says_and_can_be_put_together_again(
    hexahedra: bool, degree: int, meshes: Path, tmp_path: Path
) -> None:
    source = with_data(meshes, hexahedra=hexahedra, degree=degree)
    cut, facets = partitioned(source, 3)
    part = metis(source.cells[:, : 8 if hexahedra else 4], source.kind, 3)
    assert facets == slow_edge_cut(source, part.tolist())
    assert cut.parts == (0, *np.cumsum([np.count_nonzero(part == p) for p in range(3)]))
    for p in range(3):
        tags = cut.cell_tags[cut.parts[p] : cut.parts[p + 1]]
        assert set(tags) == set(source.cell_tags[part == p])
        # Its nodes that no earlier part has stand together, behind the nodes of the earlier ones.
        before = set(cut.cells[: cut.parts[p]].ravel().tolist())
        here = set(cut.cells[cut.parts[p] : cut.parts[p + 1]].ravel().tolist())
        assert here - before == set(range(len(before), len(before | here)))

    path = tmp_path / "block.bp"
    write_partitioned(path, MPI.COMM_SELF, cut)
    for again, expected in ((read_partitioned(path, MPI.COMM_SELF), cut), (read_source(spec(path), path), source)):
        for name in ("points", "node_tags", "cells", "cell_tags"):
            assert np.array_equal(getattr(again, name), getattr(expected, name)), name
        assert [(g.name, g.dim, g.tag) for g in again.groups] == [(g.name, g.dim, g.tag) for g in expected.groups]
        for i, group in enumerate(again.groups):
            assert members(again, group) == members(expected, expected.groups[i])
        assert again.data.keys() == ARRAYS.keys()
        for name, array in again.data.items():
            assert array.place == expected.data[name].place
            assert np.array_equal(array.values, expected.data[name].values)


def members(source: MeshSource, group: Group) -> list[list[int]]:
    """Nodes of the entities of a group, in no order of their own."""
    rows: list[list[int]] = (source.cells if group.dim == 3 else source.facets)[group.members].tolist()
    return sorted(rows)


@pytest.mark.parallel(3)
def test_distributed_rows_are_fetched_from_any_rank(comm: MPI.Intracomm) -> None:
    random = np.random.default_rng(comm.rank)
    for counts in ((4, 0, 7), (0, 5, 1), (0, 0, 3)):
        rows = Rows.distributed(comm, counts[comm.rank])
        whole = np.arange(3.0 * rows.total).reshape(-1, 3) ** 2
        mine = slice(rows.first, rows.first + counts[comm.rank])
        wanted = random.integers(0, max(rows.total, 1), 9 if rows.total else 0)
        assert np.array_equal(rows.fetch(whole[mine], wanted), whole[wanted])
        # Each rank knows another third of them.
        known = np.arange(comm.rank, rows.total, comm.size)[::-1]
        assert np.array_equal(rows.deliver(whole[known], known), whole[mine])
        alone = Rows.distributed(MPI.COMM_SELF, rows.total).checksum(whole)
        assert rows.checksum(whole[mine]) == alone
        if rows.total:
            swapped = whole.copy()
            swapped[[0, -1]] = swapped[[-1, 0]]
            assert rows.total == 1 or rows.checksum(swapped[mine]) != alone


def on_disk(comm: MPI.Intracomm, directory: Path, make: Callable[[], MeshSource], parts: int) -> Path:
    """A partitioned mesh that rank 0 writes."""
    path = directory / f"of-{parts}.bp"
    on_root(comm, lambda: write_partitioned(path, MPI.COMM_SELF, partitioned(make(), parts)[0]))
    return path


@pytest.mark.parallel([2, 3])
def test_a_partitioned_body_is_the_whole_one(comm: MPI.Intracomm, meshes: Path, run_directory: Path) -> None:
    for hexahedra, degree, parts in ((False, 2, 6), (True, 1, 2)):
        make = partial(with_data, meshes, hexahedra=hexahedra, degree=degree)
        path = on_disk(comm, run_directory, make, parts)
        body = build_body(spec(path), conditions(corner="x <= 1 m and y < 1 mm"), comm)
        whole = read_partitioned(path, MPI.COMM_SELF)
        fits = parts % comm.size == 0
        assert body.partition.method == ("parts" if fits else "scotch")
        assert body.partition.edge_cut == slow_edge_cut(whole, owners(body))
        if fits:
            share = whole.parts[:: parts // comm.size]
            assert np.array_equal(owners(body), np.searchsorted(share, np.arange(len(whole.cells)), side="right") - 1)
        assert sum(body.partition.cells) == len(whole.cells)
        corners = {2: 4, 3: 8} if hexahedra else {2: 3, 3: 4}
        for group in whole.groups:
            entities = (Body.cells if group.dim == 3 else Body.facets)(body, group.name)
            expected = {frozenset(row[: corners[group.dim]]) for row in members(whole, group)}
            assert input_vertex_sets(body, group.dim, entities) == expected
        assert body.regions["corner"].facet_count > 0
        x = body.mesh.geometry.x * body.length_scale
        centres = x[body.mesh.geometry.dofmaps[0][:, : corners[3]]].mean(axis=1)
        for name, (on, components) in ARRAYS.items():
            at = x if on == "nodes" else centres
            assert np.abs(distribute(body, name).values - linear(at, components)).max() < 1e-11
        # Moved, written by all ranks, and read by one.
        write_mesh(run_directory / "moved.bp", body, x + MOVE)
        again = read_partitioned(run_directory / "moved.bp", MPI.COMM_SELF)
        assert np.array_equal(again.points, whole.points + MOVE)
        assert again.parts == whole.parts
        assert np.array_equal(again.facets, whole.facets)
        comm.Barrier()


def cube(meshes: Path, divisions: int = 3) -> MeshSource:
    """A unit cube."""
    parameters = dict.fromkeys(("nx", "ny", "nz"), divisions)
    return read_source(spec(meshes / "box.py", parameters=parameters), meshes / "box.py")


@pytest.mark.release
@pytest.mark.parallel([1, 3])
def test_a_job_has_the_answers_of_the_whole_mesh_and_its_shape_goes_back(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    bp, job = on_disk(comm, run_directory, lambda: cube(meshes), 6), run_directory / "job.yaml"
    data = BLOCK | {
        "quantities": [*BLOCK["quantities"], {"name": "height", "of": "Z", "on": "z1", "reduce": "mean"}],
        "certificate": NO_CERTIFICATE | {"overlap": True},
    }

    def solved(name: str, file: Path, **changes: Any) -> hpcinv.Result:
        on_root(comm, lambda: write_job(job, data | {"mesh": {"file": str(file)}}, **changes) and None)
        return hpcinv.run(on_root(comm, lambda: hpcinv.load(job)), comm, directory=run_directory / name)

    msh, put_together = run_directory / "whole.msh", read_source(spec(bp), bp)
    on_root(comm, lambda: save(msh, put_together, put_together.points))
    whole, parted = solved("whole", msh), solved("parted", bp)
    for name, value in whole.quantities.items():
        assert parted.quantities[name] == pytest.approx(value, rel=CLOSE)
    assert [(line.name, line.verdict) for line in parted.certificate.lines] == [
        (line.name, line.verdict) for line in whole.certificate.lines
    ]
    assert parted.statistics["partition"]["method"] == "parts"
    assert sorted(p.name for p in (run_directory / "parted").glob("shape*")) == ["shape.bp"]
    shapes = [read_source(spec(run_directory / p), run_directory / p) for p in ("whole/shape.msh", "parted/shape.bp")]
    assert np.abs(shapes[0].points - shapes[1].points).max() < CLOSE
    assert np.array_equal(shapes[0].cells, shapes[1].cells)
    comm.Barrier()

    # The undeformed shape sags into what was given. With straight cells only its nodes come back exactly, if they
    # are nodes of the displacement.
    back = solved("back", run_directory / "parted" / "shape.bp", analysis="forward", expected_shape={"file": str(bp)})
    there = reorder_to_source(parted.body, parted.solutions[0].mesh_nodes)
    again = reorder_to_source(back.body, back.solutions[0].other_nodes)
    gap = comm.allreduce(float(((there - again) ** 2).sum(axis=1).max(initial=0.0)), op=MPI.MAX) ** 0.5
    assert back.errors["expected_shape"]["max"] == pytest.approx(gap, rel=1e-6)
    assert back.quantities["top"] == pytest.approx(parted.quantities["top"], rel=0.02)
    other = on_disk(comm, run_directory, lambda: cube(meshes), 3)
    with pytest.raises(MeshError, match="join other nodes"):
        solved("other", other, analysis="forward", expected_shape={"file": str(bp)})


@pytest.mark.release
@pytest.mark.parallel(3)
def test_a_checkpoint_of_two_ranks_is_read_by_one_and_three(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    path = on_disk(comm, run_directory, lambda: cube(meshes), 6)
    two = comm.Split(0 if comm.rank < 2 else 1)
    directory = run_directory / "checkpoints"
    if comm.rank < 2:
        written = fields(build_body(spec(path), {}, two), 2, filled=True)
        Checkpoints(directory, two, PROBLEM, keep=2).write(Position(0, 0.375, (SOLVES,)), written)
    comm.Barrier()
    for some in (comm, MPI.COMM_SELF):
        body = build_body(spec(path), {}, some)
        restart = Checkpoints(directory, some, PROBLEM, keep=2).latest()
        assert restart is not None
        expected = fields(body, 2, filled=True)
        for name, function in fields(body, 2, filled=False).items():
            restart.read(name, function)
            np.testing.assert_allclose(function.x.array, expected[name].x.array, rtol=0, atol=1e-13)


@pytest.mark.release
@pytest.mark.parallel(3)
def test_parts_without_shared_nodes_are_distinguished_on_any_ranks(comm: MPI.Intracomm, run_directory: Path) -> None:
    """Seven rows of tetrahedra, each joined to the next at single nodes, from 1 to 7 of them."""
    nodes, elements, row_of = [], [], []
    for row in range(7):
        for i in range(row + 1):
            on = []
            for corner in (np.array(TETRAHEDRON) + np.array([i, 3 * row, 0])).tolist():
                if corner not in nodes:
                    nodes.append(corner)
                on.append(nodes.index(corner) + 1)
            elements.append((4, 1, row + 1, on))
            row_of.append(row)
    path = run_directory / "rows.msh"
    on_root(comm, lambda: write_msh22(path, nodes, elements) and None)
    for method in ("metis", "scotch"):
        body = build_body(spec(path, partition=method), {}, comm)
        count, label = parts_of(body)
        assert count == 7
        assert np.array_equal(label, np.array(row_of)[body.mesh.topology.original_cell_index])


@pytest.mark.release
@pytest.mark.parallel(3)
def test_no_rank_holds_the_whole(comm: MPI.Intracomm, meshes: Path, run_directory: Path) -> None:
    path = on_disk(comm, run_directory, lambda: cube(meshes, 16), 6)

    def most(ranks: MPI.Intracomm, name: str) -> int:
        """Peak of what Python and NumPy allocate on this rank, from reading the mesh to writing another shape of it."""
        tracemalloc.start()
        body = build_body(spec(path), conditions(half="x < 0.5"), ranks)
        parts_of(body)
        write_mesh(run_directory / name, body, body.mesh.geometry.x * 2.0)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    alone = most(MPI.COMM_SELF, f"alone-{comm.rank}.bp")
    shared = most(comm, "shared.bp")
    print(f"rank {comm.rank}: {alone} bytes alone, {shared} on {comm.size} ranks")
    assert alone > 5e6
    assert shared < 1.25 * alone / comm.size


@pytest.mark.parallel(2)
def test_damaged_and_foreign_meshes_are_refused_on_all_ranks(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    path = on_disk(comm, run_directory, lambda: cube(meshes), 2)

    def refused(message: str) -> None:
        comm.Barrier()
        with pytest.raises(MeshError, match=message):
            build_body(spec(path), {}, comm)
        comm.Barrier()

    content = (path / "data.0").read_bytes()
    points = read_partitioned(path, MPI.COMM_SELF).points.tobytes()
    comm.Barrier()
    if comm.rank == 0:  # the last bit of the last node's height
        at = content.index(points) + len(points) - 8
        (path / "data.0").write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    refused("the array 'points' is damaged")
    if comm.rank == 0:
        (path / "data.0").write_bytes(content[:100])
    refused("data.0 in it is damaged")
    if comm.rank == 0:
        (path / "data.0").unlink()
    refused("incomplete")
    if comm.rank == 0:
        (path / "data.0").write_bytes(content)
    header = json.loads((path / HEADER).read_text())
    comm.Barrier()
    for text, message in (
        (json.dumps(header | {"format": 99}), "has format 99"),
        ("{}", "incomplete"),
        ("[", "incomplete"),
    ):
        if comm.rank == 0:
            (path / HEADER).write_text(text)
        refused(message)


@pytest.mark.parallel(2)
def test_a_mesh_that_cannot_be_written_leaves_nothing(comm: MPI.Intracomm, meshes: Path, run_directory: Path) -> None:
    body = build_body(spec(meshes / "single_tetrahedron.msh"), {}, comm)
    with pytest.raises(OutputError, match="there is not a directory"):
        write_mesh(run_directory / "none" / "mesh.bp", body, body.mesh.geometry.x)
    in_the_way = run_directory / "mesh.bp"
    on_root(comm, in_the_way.mkdir)
    with pytest.raises(OutputError, match="already exists, and is not a partitioned mesh"):
        write_mesh(in_the_way, body, body.mesh.geometry.x)
    assert list(run_directory.iterdir()) == [in_the_way]
    # A whole mesh is written as one part, which more ranks distribute themselves.
    write_mesh(run_directory / "one.bp", body, body.mesh.geometry.x)
    assert build_body(spec(run_directory / "one.bp"), {}, MPI.COMM_SELF).partition.method == "parts"


def test_limits_of_partitioned_meshes_are_reported_when_the_job_is_read(meshes: Path, tmp_path: Path) -> None:
    assert main(["mesh", "partition", str(meshes / "box.py"), str(tmp_path / "box.bp"), "--parts", "2"]) == 0
    mesh = {"file": "box.bp"}
    other = {"file": str(meshes / "box.py")}
    cases = (
        ({"mesh": mesh | {"geometry_degree": 2}}, "mesh.geometry_degree: is the degree of the partitioned mesh"),
        ({"mesh": mesh | {"unit": "mm"}}, "mesh.unit: is not valid with a partitioned mesh"),
        ({"mesh": mesh | {"parameters": {"nx": 2}}}, "mesh.parameters: only generators have parameters"),
        ({"mesh": mesh, "output": {"mesh": ["msh"]}}, "output.mesh: of a partitioned mesh must be bp"),
        ({"mesh": mesh, "expected_shape": other}, "expected_shape.file: must be a partitioned mesh"),
        ({"mesh": mesh, "accuracy": {"top": "1 mm"}}, "accuracy: needs a mesh that can be refined"),
        ({"mesh": {"file": "."}}, "mesh.file: '.' is not a readable mesh"),
        ({"mesh": {"file": "empty.bp"}}, "is not of the kind of its suffix"),
    )
    (tmp_path / "empty.bp").mkdir()
    for changes, message in cases:
        with pytest.raises(JobError) as refused:
            hpcinv.load(write_job(tmp_path / "job.yaml", BLOCK, **changes))
        assert message in str(refused.value)
    job = hpcinv.load(write_job(tmp_path / "job.yaml", BLOCK, mesh=mesh))
    assert job.shape_formats == ("bp",)
    before = fingerprint(job)
    assert main(["mesh", "partition", str(meshes / "box.py"), str(tmp_path / "box.bp"), "--parts", "3"]) == 0
    assert fingerprint(job) != before  # functions are saved in the order of cells


def test_the_command_takes_a_mesh_a_generator_or_a_job(
    meshes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parameters = {"lx": 0.5, "nx": 3}
    job = write_job(
        tmp_path / "job.yaml",
        BLOCK,
        mesh={"file": str(meshes / "box.py"), "parameters": parameters, "geometry_degree": 2},
    )
    options = [f"--parameter={name}={value}" for name, value in parameters.items()]
    asked: dict[str, list[object]] = {
        "generator.bp": [meshes / "box.py", "--geometry-degree", 2, *options],
        "job.bp": [job],
        "again.bp": [tmp_path / "job.bp"],
    }
    for name, arguments in asked.items():
        words = ["mesh", "partition", *map(str, arguments), "--parts", "4", str(tmp_path / name)]
        assert main(words) == 0
        assert "cells and" in capsys.readouterr().out
    whole = read_source(spec(meshes / "box.py", parameters=parameters, geometry_degree=2), meshes / "box.py")
    for name in asked:
        assert main(["mesh", "gather", str(tmp_path / name), str(tmp_path / "whole.vtu")]) == 0
        mesh_read = read_source(spec(tmp_path / "whole.vtu"), tmp_path / "whole.vtu")
        assert np.array_equal(mesh_read.points, whole.points)
        assert np.array_equal(mesh_read.cells, whole.cells)

    capsys.readouterr()
    wrong = (
        ([meshes / "box.py", tmp_path / "a.bp", "--parts", 9999], "has 384 cells, too few for 9999 parts"),
        ([meshes / "box.py", tmp_path / "a.msh", "--parts", 2], "a partitioned mesh ends in .bp"),
        ([meshes / "box.py", tmp_path / "a.bp", "--parts", 2, "--parameter=n=2"], "box.py has no such parameter"),
        ([job, tmp_path / "a.bp", "--parts", 2, "--unit=mm"], "says itself which"),
        ([meshes / "none.msh", tmp_path / "a.bp", "--parts", 2], "there is no file"),
    )
    for arguments, message in wrong:
        assert main(["mesh", "partition", *map(str, arguments)]) == 2
        assert message in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["mesh", "partition", str(meshes / "box.py"), str(tmp_path / "a.bp"), "--parts", "0"])
    assert "--parts: must be 1 or more" in capsys.readouterr().err
    assert not (tmp_path / "a.bp").exists()


def test_ranks_read_whole_parts_or_equal_shares() -> None:
    parts = (0, 4, 6, 16)
    assert [cells_of(parts, 2, rank) for rank in range(2)] == [(0, 4), (4, 16)]
    assert [cells_of(parts, 3, rank) for rank in range(3)] == [(0, 4), (4, 6), (6, 16)]
    assert [cells_of(parts, 4, rank) for rank in range(4)] == [(0, 4), (4, 8), (8, 12), (12, 16)]
