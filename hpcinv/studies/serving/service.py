"""The loop of a served job: rank 0 takes a request, all ranks solve, rank 0 answers."""

import traceback
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from hpcinv.base.parallel.ranks import MPI, on_root
from hpcinv.errors import HpcinvError, Interrupted, JobError, described
from hpcinv.job.job import Job
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.serving.job_model import JobModel, Linearisation
from hpcinv.studies.serving.um_bridge import Request, Server, error


def serve(
    job: Job,
    comm: MPI.Intracomm,
    *,
    host: str,
    port: int,
    token: str,
    stop: Callable[[], bool],
    ready: Callable[[str, JobModel, Linearisation], None],
) -> int:
    """Answer requests until the process is asked to stop; return the number of solves. Collective.

    Args:
        host, port: address to listen on; port 0 takes a free one.
        token: first part of the path of each request; empty for none.
        stop: whether this process was asked to stop.
        ready: called on rank 0 with the address, the model, and its evaluation at the values of the job.

    Raises:
        JobError, MeshError, SolveError: the job cannot be served, or has no solution at its own values.
        OutputError: the address cannot be used.
    """
    server: Server | None = None
    request: Request | None = None  # on rank 0
    solves = 0
    with ExitStack() as own:

        def new_model() -> JobModel:
            own.close()
            return JobModel(job, own.enter_context(Workspace(comm)), stop)

        model = new_model()
        first = model.evaluate(model.start)

        def listen() -> None:
            nonlocal server
            server = Server(job.job, len(model.parameters), len(first.outputs), host, port, token)
            ready(server.address, model, first)

        def next_request() -> tuple[list[float], str] | None:
            nonlocal request
            assert server is not None
            request = server.next(stop)
            return None if request is None else (request.inputs, request.level)

        def reply(answer: dict[str, Any]) -> None:
            if request is not None:
                request.answers.put(answer)

        on_root(comm, listen)
        try:
            while (asked := on_root(comm, next_request)) is not None:
                try:
                    evaluation = model.evaluate(*asked)
                    solves += 1
                    if request is not None:  # on rank 0
                        reply(request.answer(evaluation))
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
