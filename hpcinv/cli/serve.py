"""``hpcinv serve``: a job as a model of UM-Bridge, evaluated over HTTP; under mpirun for more ranks."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.cli.options import add_ranks, port

if TYPE_CHECKING:
    from hpcinv.studies.serving.job_model import JobModel, Linearisation


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

        def ready(address: str, model: JobModel, first: Linearisation) -> None:
            print(describe(address, model, first), flush=True)

        job = on_root(comm, lambda: load(options.job))
        token = "" if is_loopback(options.host) else new_token()
        solves = serve(job, comm, host=options.host, port=options.port, token=token, stop=stop, ready=ready)
        if comm.rank == 0:
            print(f"stopped after {solves} requests", flush=True)
    return 0


def describe(address: str, model: JobModel, first: Linearisation) -> str:
    """Return the address, and tables of inputs and outputs with units and the values of the job."""
    inputs = [
        (p.key, p.dimension.unit if p.dimension is not None else "", f"{value:.6g}")
        for p, value in zip(model.parameters, model.start, strict=True)
    ]
    outputs = [
        (name, unit, f"{value:.6g}")
        for name, unit, value in zip(first.outputs, first.units, first.values.tolist(), strict=True)
    ]
    lines = [f"model '{model.job.job}' at {address}"]
    for title, rows in (("inputs", inputs), ("outputs", outputs)):
        widths = [max(len(row[i]) for row in rows) for i in range(3)]
        lines.append(f"{title} (index, name, SI unit, value in the job):")
        lines += [
            f"  {index}  {name:{widths[0]}}  {unit:{widths[1]}}  {value:>{widths[2]}}"
            for index, (name, unit, value) in enumerate(rows)
        ]
    return "\n".join([*lines, "stop with Ctrl-C"])
