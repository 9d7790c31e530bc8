"""The loop of a served job: rank 0 takes a request, all ranks solve, rank 0 answers."""

import traceback
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from typing import Any

from hpcinv.base.parallel.ranks import MPI, on_root
from hpcinv.errors import HpcinvError, Interrupted, JobError, described
from hpcinv.job.job import Job
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.serving.array_model import ArrayModel
from hpcinv.studies.serving.job_model import JobModel
from hpcinv.studies.serving.question import Question, Refusal, Table
from hpcinv.studies.serving.um_bridge import Request, Server, error


def serve(
    job: Job,
    comm: MPI.Intracomm,
    *,
    host: str,
    port: int,
    token: str,
    stop: Callable[[], bool],
    ready: Callable[[str, Table, Table], None],
    arrays: Sequence[str] = (),
    with_shape: bool = False,
) -> int:
    """Answer requests until the process is asked to stop; return the number of solves. Collective.

    Args:
        host, port: address to listen on; port 0 takes a free one.
        token: first part of the path of each request; empty for none.
        stop: whether this process was asked to stop.
        ready: called on rank 0 with the address, and with inputs and outputs at the values of the job.
        arrays, with_shape: further inputs and an output, as of `ArrayModel`.

    Raises:
        JobError, MeshError, SolveError: the job cannot be served, or has no solution at its own values.
        OutputError: the address cannot be used.
    """
    server: Server | None = None
    request: Request | None = None  # on rank 0
    solves = 0
    with ExitStack() as own:

        def new_model() -> JobModel | ArrayModel:
            own.close()
            if arrays or with_shape:
                return own.enter_context(closing(ArrayModel(job, comm, arrays, with_shape, stop)))
            return JobModel(job, own.enter_context(Workspace(comm)), stop)

        model = new_model()
        inputs, outputs = model.begin()

        def listen() -> None:
            nonlocal server
            server = Server(job.job, inputs.sizes, outputs.sizes, host, port, token)
            ready(server.address, inputs, outputs)

        def next_request() -> Question | None:
            nonlocal request
            assert server is not None
            request = server.next(stop)
            return None if request is None else request.question

        def reply(answer: dict[str, Any]) -> None:
            if request is not None:
                request.answers.put(answer)

        on_root(comm, listen)
        try:
            while (asked := on_root(comm, next_request)) is not None:
                try:
                    reply({"output": model.answer(asked)})
                    solves += 1
                except Refusal as refusal:
                    reply(error(refusal.kind, str(refusal)))
                except Interrupted:
                    reply(error("ModelError", "the server was stopped"))
                    break
                except HpcinvError as exc:
                    kind = "InvalidInput" if isinstance(exc, JobError) else "ModelError"
                    reply(error(kind, str(exc)))
                except Exception as exc:
                    if comm.size > 1:  # other ranks may wait for this one
                        raise
                    traceback.print_exception(exc)
                    model = new_model()  # the error may have left anything in the earlier one
                    reply(error("ModelError", f"an error of this program, {described(exc)}"))
        finally:
            if server is not None:
                server.close()
    return solves
