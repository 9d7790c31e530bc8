"""The protocol of UM-Bridge 1.0 over HTTP: requests wait for the ranks that answer them.

Source: Seelinger et al., "UM-Bridge: Uncertainty quantification and modeling bridge" (2023), doi:10.21105/joss.04748.
"""

import json
import math
import queue
import secrets
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hpcinv.base.quantity.units import as_float
from hpcinv.job.settings import LEVELS
from hpcinv.studies.serving.http_server import LONGEST, HttpServer, Reply
from hpcinv.studies.serving.question import Question, Refusal

_FEATURES = {"Evaluate": True, "Gradient": True, "ApplyJacobian": True, "ApplyHessian": False}
_ANSWERED = {"Evaluate": "", "Gradient": "sens", "ApplyJacobian": "vec"}  # requests that need a solve, and their vector


_MOST_WAITING = 1000
"""requests that wait for a solve; raised, a client that sends many without waiting takes more memory. Fewer requests of
arrays wait."""
_BYTES = 32
"""bytes of a number in a request of arrays; lowered, requests with all digits are refused"""


@dataclass(frozen=True)
class Request:
    """A request for a solve.

    Attributes:
        is_wanted: whether the client is still there.
        answers: where the answer goes.
    """

    question: Question
    is_wanted: Callable[[], bool]
    answers: "queue.Queue[dict[str, Any]]" = field(default_factory=lambda: queue.Queue(1))


def error(kind: str, message: str) -> dict[str, Any]:
    """Return the protocol's answer to a request that failed."""
    return {"error": {"type": kind, "message": message}}


class Server:
    """HTTP server of one model, in threads of rank 0; requests for solves wait in a queue.

    Args:
        name: of the model.
        inputs: lengths of the lists of inputs.
        outputs: lengths of the lists of outputs.
        host, port: address to listen on; port 0 takes a free one.
        token: first part of the path of each request; empty for none.

    Raises:
        OutputError: the address cannot be used.
    """

    def __init__(
        self, name: str, inputs: Sequence[int], outputs: Sequence[int], host: str, port: int, token: str
    ) -> None:
        self.name, self.inputs, self.outputs, self.token = name, list(inputs), list(outputs), token
        self._longest = max(LONGEST, _BYTES * (sum(inputs) + max(*inputs, *outputs)))
        self._most_waiting = max(1, _MOST_WAITING * LONGEST // self._longest)
        self._requests: queue.Queue[Request] = queue.Queue(self._most_waiting)
        self._lock, self._is_closed = threading.Lock(), False
        self._server = HttpServer(host, port, self._reply, self._longest)

    @property
    def address(self) -> str:
        """URL that a client is given."""
        return f"{self._server.address}/{self.token}".rstrip("/")

    def next(self, stop: Callable[[], bool]) -> Request | None:
        """Return the next request whose client waits for a solve; ``None`` when the process is asked to stop."""
        while not stop():
            try:
                request = self._requests.get(timeout=0.1)
            except queue.Empty:
                continue
            if request.is_wanted():
                return request
            request.answers.put(error("ModelError", "the client has left"))
        return None

    def close(self) -> None:
        """Answer the requests that wait, and stop listening."""
        with self._lock:
            self._is_closed = True
        while not self._requests.empty():
            self._requests.get().answers.put(error("ModelError", "the server was stopped"))
        self._server.close()

    def _reply(self, method: str, path: str, body: bytes | None, is_wanted: Callable[[], bool]) -> Reply:
        """Return the answer to a request over HTTP."""
        code = 200
        try:
            if body is None:
                raise Refusal("InvalidInput", f"a request may have {self._longest} bytes")
            content = self.respond(path, _mapping(body) if method == "POST" else {}, is_wanted)
        except Refusal as refusal:
            content, code = error(refusal.kind, str(refusal)), 404 if refusal.kind == "NotFound" else 400
        else:
            code = 500 if "error" in content else 200
        return Reply(code, json.dumps(content).encode())

    def respond(self, path: str, body: Mapping[str, Any], is_wanted: Callable[[], bool]) -> dict[str, Any]:
        """Return the answer to a request; one for a solve waits for it.

        Raises:
            Refusal: the request is not valid.
        """
        start, _, kind = path.strip("/").rpartition("/")
        if not secrets.compare_digest(start.encode(errors="replace"), self.token.encode()):
            raise Refusal("NotFound", "the address lacks the token that 'hpcinv serve' printed")
        if kind == "Info":
            return {"protocolVersion": 1.0, "models": [self.name]}
        if kind not in ("ModelInfo", "InputSizes", "OutputSizes", *_ANSWERED):
            raise Refusal("UnsupportedFeature" if kind == "ApplyHessian" else "NotFound", f"there is no '{kind}' here")
        if body.get("name") != self.name:
            raise Refusal("ModelNotFound", f"there is no model '{body.get('name')}'; there is '{self.name}'")
        if kind == "ModelInfo":
            return {"support": _FEATURES}
        if kind.endswith("Sizes"):
            return {"inputSizes": self.inputs} if kind == "InputSizes" else {"outputSizes": self.outputs}
        request = self._request(kind, body, is_wanted)
        with self._lock:
            if self._is_closed:
                return error("ModelError", "the server was stopped")
            try:
                self._requests.put_nowait(request)
            except queue.Full:
                return error("ModelError", f"{self._most_waiting:,} requests wait for an answer: ask again later")
        return request.answers.get()

    def _request(self, kind: str, body: Mapping[str, Any], is_wanted: Callable[[], bool]) -> Request:
        given, count = body.get("input"), len(self.inputs)
        if not isinstance(given, list) or len(given) != count:
            lists = "one list" if count == 1 else f"{count} lists"
            raise Refusal("InvalidInput", f"'input' must be {lists} of {', '.join(map(str, self.inputs))} numbers")
        out = into = 0
        if kind != "Evaluate":
            out, into = _place(body, "outWrt", self.outputs), _place(body, "inWrt", self.inputs)
        config = body.get("config") or {}
        if not isinstance(config, dict) or not config.keys() <= {"certificate"}:
            raise Refusal("InvalidInput", "'config' may have 'certificate' only")
        level = config.get("certificate", "off")
        if level not in LEVELS:
            raise Refusal("InvalidInput", f"'config' may have 'certificate': {', '.join(LEVELS)}")
        key = _ANSWERED[kind]
        size = self.outputs[out] if key == "sens" else self.inputs[into]
        vector = _numbers(body.get(key), key, size) if key else []
        inputs = [_numbers(numbers, "input", size) for numbers, size in zip(given, self.inputs, strict=True)]
        return Request(Question(kind, inputs, level, tuple(vector), out, into), is_wanted)


def _place(body: Mapping[str, Any], key: str, sizes: Sequence[int]) -> int:
    """Return the number of a list."""
    place = body.get(key)
    if not isinstance(place, int) or isinstance(place, bool) or not 0 <= place < len(sizes):
        lists = "0: there is one list" if len(sizes) == 1 else f"the number of a list, from 0 to {len(sizes) - 1}"
        raise Refusal("InvalidInput", f"'{key}' must be {lists}")
    return place


def _mapping(body: bytes) -> Mapping[str, Any]:
    try:
        data = json.loads(body)
    except (ValueError, RecursionError) as exc:
        raise Refusal("InvalidInput", "the body of the request is not JSON") from exc
    if not isinstance(data, dict):
        raise Refusal("InvalidInput", "the body of the request is not a JSON object")
    return data


def _numbers(given: object, key: str, size: int) -> list[float]:
    """Return ``size`` finite numbers."""
    if not isinstance(given, list) or len(given) != size:
        raise Refusal("InvalidInput", f"'{key}' must have {size} numbers")
    numbers = [as_float(x) if isinstance(x, int | float) and not isinstance(x, bool) else math.nan for x in given]
    if not all(map(math.isfinite, numbers)):
        raise Refusal("InvalidInput", f"'{key}' must have finite numbers")
    return numbers
