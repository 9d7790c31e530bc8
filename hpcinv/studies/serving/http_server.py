"""HTTP server of this program: requests of limited size, answered in threads; tokens of their addresses."""

import ipaddress
import re
import secrets
import select
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from hpcinv.errors import OutputError

LONGEST = 1_000_000
"""bytes of a request, unless a server allows more; longer ones are refused"""
_DISCARDED = 20 * LONGEST  # bytes of a longer request that are read before it is refused; more take longer
_MOST_READ = 100
"""connections whose request has not arrived; then the oldest is closed. Raised, half-sent requests take more memory"""
_SILENCE = 30.0
"""s without a byte after which a connection is closed; raised, half-sent requests stay longer"""
_PAUSE = 0.05
"""s between looks at whether to close; raised, the end takes longer"""
_PATIENCE = 5.0
"""s for the last answers to be sent when the server closes; raised, a client that reads slowly delays the end"""


@dataclass(frozen=True)
class Reply:
    """Answer to a request: its status, content, and type of the content."""

    code: int
    content: bytes
    kind: str = "application/json"


type Respond = Callable[[str, str, bytes | None, Callable[[], bool]], Reply]
"""Answers a request by its method (GET or POST), path and body, and a function that says whether its client is still
there; a body that is too long is ``None``."""


def new_token() -> str:
    """Return a text that nobody can guess, for the address of a server."""
    return secrets.token_urlsafe(24)


def is_loopback(host: str) -> bool:
    """Return whether only programs on this machine reach an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class HttpServer:
    """Server that listens in threads of this process until `close`.

    On an address of this machine it answers requests to this machine only: the page of another name, whose address was
    changed to this one, reads nothing. Requests of pages from elsewhere are refused, since they name their origin.

    Args:
        host, port: address to listen on; port 0 takes a free one.
        longest: bytes of a request.

    Raises:
        OutputError: the address cannot be used.
    """

    def __init__(self, host: str, port: int, respond: Respond, longest: int = LONGEST) -> None:
        class Handler(_Handler):
            most_bytes = longest

            def reply(self, method: str, body: bytes | None, is_there: Callable[[], bool]) -> Reply:
                if fault := _fault_of(self.headers, is_local=is_loopback(host)):
                    return Reply(403, fault.encode(), "text/plain")
                return respond(method, self.path, body, is_there)

        try:
            self._server = _Server((host, port), Handler)
        except (OSError, UnicodeError) as exc:
            reason = getattr(exc, "strerror", None) or exc
            raise OutputError(f"--host {host} --port {port}: cannot be used: {reason}") from exc
        threading.Thread(target=self._server.serve_forever, args=(_PAUSE,), daemon=True).start()

    @property
    def address(self) -> str:
        """URL of the server."""
        host, port = self._server.server_address[:2]
        shown = f"[{host!s}]" if ":" in str(host) else str(host)
        return f"http://{shown}:{port}"

    def close(self) -> None:
        """Stop listening, and wait until the answers that were begun are sent."""
        self._server.shutdown()
        self._server.server_close()
        self._server.wait_for_answers()


def _fault_of(headers: Any, *, is_local: bool) -> str:
    """Return why a request is refused by its headers; empty text if it is not."""
    host = headers.get("Host", "")
    name = re.sub(r":\d+$", "", host).strip("[]")
    if is_local and host and not is_loopback(name):
        return "this server answers requests to this machine only, and the header Host names another one"
    if headers.get("Origin", f"http://{host}") != f"http://{host}":
        return "this server answers programs and its own pages, and the header Origin names another page"
    return ""


class _Server(ThreadingHTTPServer):
    """Threads of connections; only some may be without a whole request."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._changed = threading.Condition()
        self._reading: dict[socket.socket, None] = {}
        self._answering = 0
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._changed:
            self._reading[request] = None
            oldest = next(iter(self._reading)) if len(self._reading) > _MOST_READ else None
            if oldest is not None:
                del self._reading[oldest]
        if oldest is not None:
            with suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._changed:
            self._reading.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing where a client has left, or was sent away."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)

    @contextmanager
    def answering(self, request: socket.socket) -> Iterator[None]:
        """Context in which a request that has arrived is answered."""
        with self._changed:
            self._reading.pop(request, None)
            self._answering += 1
        try:
            yield
        finally:
            with self._changed:
                self._reading[request] = None  # the next one may follow
                self._answering -= 1
                self._changed.notify_all()

    def wait_for_answers(self) -> None:
        """Wait until no request is being answered, but not for ever."""
        deadline = time.monotonic() + _PATIENCE
        with self._changed:
            while self._answering and (left := deadline - time.monotonic()) > 0:
                self._changed.wait(left)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = _SILENCE
    most_bytes = LONGEST
    server: _Server

    def reply(self, method: str, body: bytes | None, is_there: Callable[[], bool]) -> Reply:
        """Return the answer to a request."""
        raise NotImplementedError

    def do_GET(self) -> None:
        self._answer("GET")

    def do_POST(self) -> None:
        self._answer("POST")

    def log_message(self, *_: object) -> None:
        """Print nothing for each request."""

    def _answer(self, method: str) -> None:
        body = self._body()
        with self.server.answering(self.connection):
            reply = self.reply(method, body, self._is_there)
            self.send_response(reply.code)
            self.send_header("Content-Type", reply.kind)
            self.send_header("Content-Length", str(len(reply.content)))
            self.end_headers()
            self.wfile.write(reply.content)

    def _body(self) -> bytes | None:
        """Return the body of the request, ``None`` if it is too long."""
        try:
            length = int(self.headers.get("Content-Length") or 0)
        except ValueError:
            length = -1
        if 0 <= length <= self.most_bytes:
            return self.rfile.read(length)
        self.close_connection = True
        for _ in range(0, min(length, _DISCARDED), LONGEST):  # else the client sees a reset, no answer
            self.rfile.read(min(length, LONGEST))
            length -= LONGEST
        return None

    def _is_there(self) -> bool:
        """Return whether the client has not closed the connection."""
        poll = select.poll()
        poll.register(self.connection, select.POLLIN)
        try:
            return not poll.poll(0) or bool(self.connection.recv(1, socket.MSG_PEEK))
        except OSError:
            return False
