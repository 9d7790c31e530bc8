"""Commands ``validate`` and ``schema``, which need neither MPI nor DOLFINx."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from hpcinv.cli.help import add_command
from hpcinv.errors import HpcinvError
from hpcinv.files.untrusted import add_option
from hpcinv.job.job import Job, json_schema, load
from hpcinv.job.plausibility import doubtful_moduli
from hpcinv.quantity.schema import Spec
from hpcinv.study.study_plan import is_study, load_study
from hpcinv.study.study_spec import Study
from hpcinv.sweep.sweep_plan import is_sweep, load_sweep
from hpcinv.sweep.sweep_spec import Sweep


def add_validate(commands: Any) -> None:
    validate = add_command(
        commands,
        "validate",
        "Check job, study and sweep files without running them.",
        examples="hpcinv validate job.yaml sweep.yaml",
        page="start/jobs.md",
    )
    validate.add_argument("jobs", type=Path, nargs="+", metavar="file", help="job, study or sweep file (YAML)")
    add_option(validate)
    validate.set_defaults(command=_validate, is_proven=True)

    schema = add_command(
        commands,
        "schema",
        "Print the JSON Schema of job, study or sweep files, for editors.",
        examples="hpcinv schema > job.schema.json\nhpcinv schema sweep > sweep.schema.json",
        page="reference/job-keys.md",
    )
    schema.add_argument("kind", choices=list(_KINDS), nargs="?", default="job", help="kind of file, by default a job")
    schema.set_defaults(command=_schema)


def _validate(options: argparse.Namespace) -> int:
    failed = 0
    for path in options.jobs:
        try:
            content = (load_study if is_study(path) else load_sweep if is_sweep(path) else load)(path)
        except HpcinvError as error:
            print(error, file=sys.stderr)
            failed = error.exit_code
        else:
            if isinstance(content, Job) and content.output.unit_warnings:
                for text in doubtful_moduli(content):
                    print(f"warning: {path}: {text}", file=sys.stderr)
            print(f"{path}: valid")
    return failed


_KINDS: dict[str, type[Spec]] = {"job": Job, "study": Study, "sweep": Sweep}


def _schema(options: argparse.Namespace) -> int:
    print(json.dumps(json_schema(_KINDS[options.kind]), indent=2))
    return 0
