"""HTTP server of this program: requests of limited size, answered in threads; tokens of their addresses."""

import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from hpcinv.errors import OutputError

LONGEST = 1_000_000
"""bytes of a request; longer ones are refused"""
_DISCARDED = 20 * LONGEST  # bytes of a longer request that are read before it is refused; more take longer


@dataclass(frozen=True)
class Reply:
    """Answer to a request: its status, content, and type of the content."""

    code: int
    content: bytes
    kind: str = "application/json"


type Respond = Callable[[str, str, bytes | None], Reply]
"""Answers a request by its method (GET or POST), path and body; a body that is too long is ``None``."""


def new_token() -> str:
    """Return a text that nobody can guess, for the address of a server."""
    return secrets.token_urlsafe(24)


class HttpServer:
    """Server that listens in threads of this process until `close`.

    Args:
        host, port: address to listen on; port 0 takes a free one.

    Raises:
        OutputError: the address cannot be used.
    """

    def __init__(self, host: str, port: int, respond: Respond) -> None:
        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                self._reply("GET")

            def do_POST(self) -> None:
                self._reply("POST")

            def log_message(self, *_: object) -> None:
                """Print nothing for each request."""

            def _reply(self, method: str) -> None:
                try:
                    length = int(self.headers.get("Content-Length") or 0)
                except ValueError:
                    length = -1
                body = None
                if 0 <= length <= LONGEST:
                    body = self.rfile.read(length)
                else:
                    self.close_connection = True
                    for _ in range(0, min(length, _DISCARDED), LONGEST):  # else the client sees a reset, no answer
                        self.rfile.read(min(length, LONGEST))
                        length -= LONGEST
                reply = respond(method, self.path, body)
                self.send_response(reply.code)
                self.send_header("Content-Type", reply.kind)
                self.send_header("Content-Length", str(len(reply.content)))
                self.end_headers()
                self.wfile.write(reply.content)

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except OSError as exc:
            raise OutputError(f"--host {host} --port {port}: cannot be used: {exc.strerror or exc}") from exc
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def address(self) -> str:
        """URL of the server."""
        host, port = self._server.server_address[:2]
        shown = f"[{host!s}]" if ":" in str(host) else str(host)
        return f"http://{shown}:{port}"

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
