"""The HTTP server of ``serve`` and ``show --edit``: who is answered, and what clients cannot do to others."""

import http.client
import json
import queue
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from helpers.command_line import CUBE

from hpcinv.base.parallel.ranks import MPI
from hpcinv.job.job import load
from hpcinv.studies.serving import http_server, service, um_bridge
from hpcinv.studies.serving.http_server import HttpServer, Reply
from hpcinv.studies.serving.question import Question, Table

GOOD: dict[str, object] = {"name": "block", "input": [[1.0, 2.0]]}


def host_of(server: HttpServer | um_bridge.Server | str) -> tuple[str, int]:
    address = server if isinstance(server, str) else server.address
    name, _, port = address.removeprefix("http://").rpartition(":")
    return name, int(port)


def ask(
    server: HttpServer | um_bridge.Server | str, body: object = None, path: str = "/Evaluate", **headers: str
) -> tuple[int, str]:
    """Return code and text of an answer."""
    connection = http.client.HTTPConnection(*host_of(server), timeout=20)
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    connection.request("POST", path, content, headers)
    reply = connection.getresponse()
    return reply.status, reply.read().decode()


@pytest.fixture
def server() -> Iterator[HttpServer]:
    server = HttpServer("127.0.0.1", 0, lambda method, path, body, _: Reply(200, f"{method} {path} {body!r}".encode()))
    yield server
    server.close()


@pytest.fixture
def model() -> Iterator[um_bridge.Server]:
    model = um_bridge.Server("block", [2], [1], "127.0.0.1", 0, "")
    yield model
    model.close()


def test_requests_to_other_names_are_refused(server: HttpServer) -> None:
    """The page of a name whose address was changed to this machine (DNS rebinding) sends that name."""
    _, port = host_of(server)
    for host in ("evil.example", f"evil.example:{port}", f"localhost.evil.example:{port}", "10.0.0.1", "[2001:db8::1]"):
        code, text = ask(server, Host=host)
        assert (code, "header Host" in text) == (403, True), host
    for host in ("localhost", f"localhost:{port}", f"127.0.0.1:{port + 1}", "127.8.8.8", "[::1]:80"):
        assert ask(server, Host=host)[0] == 200, host


def test_pages_from_elsewhere_make_nothing_happen(server: HttpServer) -> None:
    for origin in ("https://evil.example", "null", "http://localhost:1", "http://127.0.0.1"):
        code, text = ask(server, Origin=origin)
        assert (code, "header Origin" in text) == (403, True), origin
    assert ask(server, Origin=server.address)[0] == 200


def test_half_sent_requests_do_not_starve_others(server: HttpServer) -> None:
    before = threading.active_count()
    halves = [socket.create_connection(host_of(server)) for _ in range(http_server._MOST_READ + 50)]
    for half in halves:
        half.sendall(b"POST /Evaluate HTTP/1.1\r\nContent-Length: 10\r\n\r\nabc")
    assert ask(server)[0] == 200
    deadline = time.monotonic() + 10
    while threading.active_count() - before > http_server._MOST_READ + 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() - before <= http_server._MOST_READ + 2  # the oldest were sent away
    for half in halves:
        half.close()


def test_a_silent_client_is_sent_away(server: HttpServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_server._Handler, "timeout", 0.2)
    with socket.create_connection(host_of(server), timeout=10) as half:
        half.sendall(b"POST /Evaluate HTTP/1.1\r\nContent-Length: 10\r\n\r\nabc")
        assert half.recv(100) == b""


def test_clients_that_left_are_not_solved_for(model: um_bridge.Server) -> None:
    body = json.dumps(GOOD).encode()
    for _ in range(3):
        with socket.create_connection(host_of(model)) as left:
            left.sendall(b"POST /Evaluate HTTP/1.1\r\nContent-Length: %d\r\n\r\n%s" % (len(body), body))
    with ThreadPoolExecutor(1) as pool:
        while model._requests.qsize() < 3:
            time.sleep(0.01)
        waiting = pool.submit(ask, model, GOOD)
        request = model.next(lambda: False)
        assert request is not None
        assert model._requests.qsize() == 0  # the fourth was found, and the others were passed
        request.answers.put({"output": [[3.0]]})
        assert waiting.result() == (200, '{"output": [[3.0]]}')


def test_all_who_wait_get_an_answer_at_the_end() -> None:
    model = um_bridge.Server("block", [2], [1], "127.0.0.1", 0, "")
    with ThreadPoolExecutor(4) as pool:
        waiting = [pool.submit(ask, model, GOOD) for _ in range(4)]
        while model._requests.qsize() < 4:
            time.sleep(0.01)
        model.close()
        for answer in waiting:
            code, text = answer.result()
            assert (code, "the server was stopped" in text) == (500, True)


def test_more_requests_than_can_wait_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(um_bridge, "_MOST_WAITING", 1)
    model = um_bridge.Server("block", [2], [1], "127.0.0.1", 0, "")
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(ask, model, GOOD)
        while model._requests.qsize() < 1:
            time.sleep(0.01)
        code, text = ask(model, GOOD)
        assert (code, "ask again later" in text) == (500, True)
        model.close()
        assert waiting.result()[0] == 500


@pytest.mark.parametrize(
    "number", ["1" + "0" * 30 + "e400", "1" + "0" * 400, "-1" + "0" * 400, "1e400", "NaN", "-Infinity", "true", "null"]
)
def test_numbers_that_no_double_holds_are_refused(number: str, model: um_bridge.Server) -> None:
    code, text = ask(model, f'{{"name": "block", "input": [[{number}, 1]]}}'.encode())
    assert (code, "'input' must have finite numbers" in text) == (400, True)


@pytest.mark.parametrize(
    "change",
    [{"name": []}, {"config": {"certificate": []}}, {"config": {"certificate": {}}}, {"input": {}}],
)
def test_values_of_other_kinds_are_refused(change: dict[str, object], model: um_bridge.Server) -> None:
    assert ask(model, {**GOOD, **change})[0] == 400


def test_whole_numbers_above_64_bits_are_numbers(model: um_bridge.Server) -> None:
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(ask, model, {"name": "block", "input": [[2**64, -(2**70)]]})
        request = model.next(lambda: False)
        assert request is not None
        assert request.question.inputs[0] == [2.0**64, -(2.0**70)]
        request.answers.put({"output": [[0.0]]})
        assert waiting.result()[0] == 200


class FaultyModel:
    """A model that raises an error of a library at 13."""

    made = 0

    def __init__(self, *_: object) -> None:
        FaultyModel.made += 1

    def begin(self) -> tuple[Table, Table]:
        return Table((2,)), Table((1,))

    def answer(self, question: Question) -> list[list[float]]:
        (inputs,) = question.inputs
        if inputs[0] == 13:
            raise FloatingPointError("of a library")
        return [[sum(inputs)]]


def test_an_error_of_a_library_does_not_end_the_server(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(service, "JobModel", FaultyModel)
    job = load({**CUBE, "job": "block"})
    addresses = queue.Queue[str](1)
    stopped = threading.Event()

    def serve() -> int:
        return service.serve(
            job,
            MPI.COMM_SELF,
            host="127.0.0.1",
            port=0,
            token="",
            stop=stopped.is_set,
            ready=lambda address, *_: addresses.put(address),
        )

    with ThreadPoolExecutor(1) as pool:
        solves = pool.submit(serve)
        address = addresses.get(timeout=20)
        fault = ask(address, {**GOOD, "input": [[13, 2]]})
        assert fault[0] == 500
        assert "an error of this program, FloatingPointError: of a library" in fault[1]
        assert FaultyModel.made == 2  # what the error left is not used again
        assert ask(address, {**GOOD, "input": [[3, 4]]}) == (200, '{"output": [[7.0]]}')
        stopped.set()
        assert solves.result() == 1
    assert "FloatingPointError" in capsys.readouterr().err
