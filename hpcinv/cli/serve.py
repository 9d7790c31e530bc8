"""``hpcinv serve``: a job as a model of UM-Bridge, evaluated over HTTP; under mpirun for more ranks."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.cli.options import add_ranks, port

if TYPE_CHECKING:
    from hpcinv.studies.serving.question import Table


def add_serve(commands: Any) -> None:
    serve = add_command(
        commands,
        "serve",
        "Serve a job to UM-Bridge clients: parameters in, quantities and their derivatives out (under mpirun).",
        examples="hpcinv serve job.yaml\nmpirun -n 2 hpcinv serve job.yaml --port 4243",
        page="how-to/serve.md",
    )
    serve.add_argument("job", type=Path, help="job file (YAML) with sections 'sensitivities' and 'quantities'")
    serve.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    serve.add_argument("--port", type=port, default=4242, help="port to listen on (default: 4242; 0: any free one)")
    serve.add_argument(
        "--arrays",
        nargs="+",
        default=[],
        metavar="KEY",
        help="further lists of inputs: quantities from data arrays of the mesh, such as material.mu, or mesh.nodes",
    )
    serve.add_argument("--shape", action="store_true", help="a further list of outputs: the computed nodes, in m")
    add_ranks(serve)
    add_option(serve)
    serve.set_defaults(command=_serve)


def _serve(options: argparse.Namespace) -> int:
    from hpcinv.base.parallel.launch import launched

    with launched(options.ranks) as (comm, stop):
        from hpcinv.base.parallel.runtime import on_root
        from hpcinv.job.job import load
        from hpcinv.studies.serving.http_server import is_loopback, new_token
        from hpcinv.studies.serving.service import serve

        def ready(address: str, inputs: Table, outputs: Table) -> None:
            print(describe(job.job, address, inputs, outputs), flush=True)

        job = on_root(comm, lambda: load(options.job))
        token = "" if is_loopback(options.host) else new_token()
        solves = serve(
            job,
            comm,
            host=options.host,
            port=options.port,
            token=token,
            stop=stop,
            ready=ready,
            arrays=options.arrays,
            with_shape=options.shape,
        )
        if comm.rank == 0:
            print(f"stopped after {solves} requests", flush=True)
    return 0


def describe(name: str, address: str, inputs: Table, outputs: Table) -> str:
    """Return the address, and tables of inputs and outputs with units and the values of the job."""
    lines = [f"model '{name}' at {address}"]
    for title, table in (("input", inputs), ("output", outputs)):
        if rows := table.rows:
            widths = [max(len(row[i]) for row in rows) for i in range(3)]
            lines.append(f"{title}s (index, name, SI unit, value in the job):")
            lines += [
                f"  {index}  {row[0]:{widths[0]}}  {row[1]:{widths[1]}}  {row[2]:>{widths[2]}}"
                for index, row in enumerate(rows)
            ]
        first = len(table.sizes) - len(table.arrays)
        lines += [f"{title} list {first + i}: {text}" for i, text in enumerate(table.arrays)]
    return "\n".join([*lines, "stop with Ctrl-C"])
