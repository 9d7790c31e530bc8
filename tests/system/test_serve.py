"""``hpcinv serve`` as it is typed, with the client of UM-Bridge: values, derivatives, faults, tokens and its end."""

from __future__ import annotations

import json
import re
import signal
import statistics
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import umbridge
from helpers.command_line import BLOCK, COLUMN, NO_CERTIFICATE, Started, hpcinv_here, write_job
from helpers.moved_meshes import write_block

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import load
from hpcinv.mesh import read_source

DENSITY = 1000.0
JOB: Mapping[str, Any] = COLUMN | {
    "certificate": NO_CERTIFICATE,
    "sensitivities": ["effects[0].density", "material.mu"],
    "quantities": [*COLUMN["quantities"], {"name": "foot", "of": "reaction", "on": "z0"}],
}


@contextmanager
def served(tmp_path: Path, ranks: int, *options: str, data: Any = JOB) -> Iterator[tuple[Started, str]]:
    job = write_job(tmp_path / "column.yaml", data)
    with Started(ranks, "serve", job, "--port", "0", *options, cwd=tmp_path) as server:
        server.wait_for("stop with Ctrl-C")
        (address,) = re.findall(r"model 'column' at (\S+)", server.text)
        yield server, address


def post(address: str, data: object) -> tuple[int, dict[str, Any]]:
    body = data if isinstance(data, bytes) else json.dumps(data).encode()
    try:
        with urllib.request.urlopen(urllib.request.Request(address, body), timeout=60) as reply:
            return reply.status, json.load(reply)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)


@pytest.mark.everyday("2")
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_client_gets_values_derivatives_and_errors_and_the_port_is_taken(tmp_path: Path, ranks: int) -> None:
    with served(tmp_path, ranks) as (server, address):
        model = umbridge.HTTPModel(address, "column")
        assert (model.get_input_sizes(), model.get_output_sizes()) == ([2], [7])
        assert not model.supports_apply_hessian()
        point = [DENSITY, 10e3]
        [values] = model([point])
        assert values[0] == pytest.approx(1.0802799, abs=5e-6)  # closed form, and the error of four cells
        step = 1e-3
        for number in range(2):
            moved = [[x * (1 + sign * step * (i == number)) for i, x in enumerate(point)] for sign in (-1, 1)]
            below, above = (model([each], {"certificate": "quick"})[0][0] for each in moved)
            slope = model.gradient(0, 0, [point], [1.0, *[0.0] * 6])[number]
            assert slope == pytest.approx((above - below) / (2 * step * point[number]), rel=1e-4)
        draws = statistics.NormalDist(DENSITY, 30.0).samples(4, seed=1)
        heights = [model([[x, 10e3]])[0][0] for x in draws]
        assert statistics.stdev(heights) == pytest.approx(
            abs(model.gradient(0, 0, [point], [1.0, *[0.0] * 6])[0]) * statistics.stdev(draws), rel=0.05
        )
        with pytest.raises(Exception, match=r"UnsupportedFeature: output 'foot\.x' has no derivative"):
            model.apply_jacobian(0, 0, [point], [1.0, 0.0])
        with pytest.raises(Exception, match=r"InvalidInput: .*column\.yaml: material: the shear modulus"):
            model([[DENSITY, -1.0]])
        with pytest.raises(Exception, match=r"InvalidInput: .*material\.mu: must be 0 or at least 2\.2e-308"):
            model([[DENSITY, 1e-320]])
        with pytest.raises(Exception, match=r"ModelError: stopped at load factor 0"):
            model([[DENSITY, 3e-308]])
        port = address.rpartition(":")[2]
        ended = hpcinv_here("serve", tmp_path / "column.yaml", "--port", port, cwd=tmp_path)
        assert ended.returncode == 2
        assert f"--port {port}: cannot be used: Address already in use" in ended.stderr
        assert model([point])[0][0] == pytest.approx(values[0], rel=1e-9)  # it goes on
        server.send(signal.SIGTERM, [server.mpirun.pid, *server.ranks()])
        assert server.exit_code() == 0, server.text
    assert "stopped after" in server.text
    assert "Traceback" not in server.text


@pytest.mark.release  # each day: the client above, a quantity of which is not reached either
def test_a_load_that_is_not_reached_is_an_error_of_the_model(tmp_path: Path) -> None:
    with served(tmp_path, 1, data=BLOCK | {"sensitivities": ["material.mu"]}) as (_, address):
        model = umbridge.HTTPModel(address, "column")
        values = model([[10e3]])
        with pytest.raises(Exception, match="ModelError: stopped at load factor"):
            model([[10.0]])
        assert model([[10e3]])[0] == pytest.approx(values[0], rel=1e-9)


def test_invalid_requests_and_missing_tokens_are_refused(tmp_path: Path) -> None:
    with served(tmp_path, 1, "--host", "0.0.0.0") as (_, address):
        open_address, _, token = address.rpartition("/")
        assert len(token) >= 32
        for wrong in (f"{open_address}/Info", f"{open_address}/x/Evaluate"):
            assert post(wrong, {})[0] == 404
        good = {"name": "column", "input": [[DENSITY, 10e3]], "config": {}}
        for change, message in (
            ({"name": "beam"}, "there is no model 'beam'"),
            ({"input": [[1.0]]}, "'input' must have 2 numbers"),
            ({"input": [[float("nan"), 1.0]]}, "finite numbers"),
            ({"input": [["1", True]]}, "finite numbers"),
            ({"input": 3}, "must be one list of 2 numbers"),
            ({"config": {"certificate": "best"}}, "'config' may have 'certificate'"),
            ({"config": {"level": 3}}, "'config' may have 'certificate'"),
        ):
            code, answer = post(f"{address}/Evaluate", good | change)
            assert code == 400
            assert message in answer["error"]["message"]
        assert post(f"{address}/Gradient", good | {"outWrt": 1, "inWrt": 0, "sens": [1]})[0] == 400
        for body in (b"[1", b"[]", b"[" * 100_000, b"\xff", b" " * 1_000_001):
            assert post(f"{address}/Evaluate", body)[0] == 400
        assert post(f"{address}/Evaluate", good)[1]["output"][0][0] == pytest.approx(1.0802799, abs=5e-6)


def test_arrays_and_the_shape_are_lists(tmp_path: Path) -> None:
    """The moduli of cells and the nodes as inputs, the shape as an output: derivatives are central differences.

    On several ranks: `test_learning_nodes.py`, and the client above.
    """
    posed = tmp_path / "column.yaml"
    write_block(MPI.COMM_SELF, tmp_path / "block.vtu", arrays={"mu": np.full(72, 20.0)})
    data = {
        "mesh": {"file": "block.vtu"},
        "material": {"law": "neo-hookean", "mu": {"data": "mu", "unit": "kPa"}, "lam": "30 kPa"},
        "effects": [{"effect": "pressure", "region": "x1", "pressure": 900}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "discretisation": {"displacement": 1, "formulation": "displacement"},
        "solver": {"tolerance": 1e-13},
        "quantities": [{"name": "tip", "of": "displacement", "at": [2, 1, 1]}],
        "sensitivities": ["effects[0].pressure"],
    }
    with served(tmp_path, 1, "--shape", "--arrays", "material.mu", "mesh.nodes", data=data) as (server, address):
        assert "input list 1: material.mu, 72 numbers\ninput list 2: mesh.nodes, 36 × 3 numbers\n" in server.text
        assert "output list 1: shape, 36 × 3 numbers\nstop with" in server.text
        model = umbridge.HTTPModel(address, "column")
        assert (model.get_input_sizes(), model.get_output_sizes()) == ([1, 72, 108], [3, 108])
        points = read_source(load(posed).mesh, tmp_path / "block.vtu").points
        random = np.random.default_rng(2)
        given = [[700.0], random.uniform(15, 30, 72).tolist(), points.ravel().tolist()]
        rates = [[20.0], random.normal(size=72).tolist(), (0.05 * random.normal(size=108)).tolist()]
        weights = random.normal(size=108).tolist()
        for place, step in enumerate((1e-2, 1e-2, 1e-4)):
            ends = []
            for sign in (1, -1):
                moved = np.add(given[place], sign * step * np.array(rates[place])).tolist()
                ends.append(model([*given[:place], moved, *given[place + 1 :]])[1])
            difference = float(np.subtract(*ends) @ weights) / (2 * step)
            gradient = model.gradient(1, place, given, weights)
            assert float(np.dot(gradient, rates[place])) == pytest.approx(difference, rel=1e-5)
            change = model.apply_jacobian(1, place, given, rates[place])
            assert float(np.dot(change, weights)) == pytest.approx(difference, rel=1e-5)
        for change, message in (
            ({"input": given[:2]}, "'input' must be 3 lists of 1, 72, 108 numbers"),
            ({"input": [given[0], given[0], given[2]]}, "'input' must have 72 numbers"),
            ({"outWrt": 2}, "'outWrt' must be the number of a list, from 0 to 1"),
            ({"inWrt": True}, "'inWrt' must be the number of a list, from 0 to 2"),
            ({"sens": weights[:3]}, "'sens' must have 108 numbers"),
            ({"config": {"certificate": "quick"}}, "a model of arrays has no certificate"),
            ({"input": [*given[:2], [0.0] * 108]}, "cells have no volume"),
        ):
            asked = {"name": "column", "input": given, "outWrt": 1, "inWrt": 0, "sens": weights}
            answer = post(f"{address}/Gradient", asked | change)[1]
            assert message in answer["error"]["message"]
        assert len(model(given)[1]) == 108


@pytest.mark.parametrize(("section", "meaning"), [("sensitivities", "inputs"), ("quantities", "outputs")])
@pytest.mark.parallel([2])
def test_jobs_without_inputs_or_outputs_are_refused(section: str, meaning: str, run_directory: Path) -> None:
    job = write_job(run_directory / "job.yaml", {key: value for key, value in JOB.items() if key != section})
    ended = hpcinv_here("serve", job, cwd=run_directory)
    assert ended.returncode == 2
    assert ended.stderr.count(f"job.yaml: {section}: is missing; it lists the {meaning} of a served job") == 1
