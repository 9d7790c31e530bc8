"""``hpcinv compile``: compile the C code of hpcinv before the first run; jobs need none."""

import argparse
import os
from typing import Any

from hpcinv.cli.help import add_command


def add_compile(commands: Any) -> None:
    command = add_command(
        commands,
        "compile",
        "Compile hpcinv's own C code for the cache; nothing of a job has to be compiled.",
        examples="hpcinv compile --cache /shared/kernels",
        page="how-to/start-up.md",
    )
    command.add_argument("jobs", nargs="*", metavar="file", help="not needed: laws and loads of a job are programs")
    command.add_argument(
        "--cache", metavar="DIR", help="the cache, for runs with HPCINV_KERNELS=DIR (default: $HPCINV_KERNELS)"
    )
    command.set_defaults(command=_compile)


def _compile(options: argparse.Namespace) -> int:
    if options.cache is not None:
        os.environ["HPCINV_KERNELS"] = options.cache

    from hpcinv.base.parallel.launch import launched

    with launched(None) as (comm, _):
        from hpcinv.base.parallel import code_cache
        from hpcinv.base.parallel.ranks import on_root
        from hpcinv.model.assembly.csr_tangent import compiled_code
        from hpcinv.physics.points.interpreter import note_on_speed

        slow = note_on_speed()
        if not slow:
            compiled_code(comm)

        def tell() -> None:
            for job in options.jobs:
                print(f"{job}: nothing to compile; its first run makes programs in about a second")
            print(slow or f"hpcinv's C code is in {code_cache.directory()}")

        on_root(comm, tell)
    return 0
