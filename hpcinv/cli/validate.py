"""Commands ``validate`` and ``schema``, which need neither MPI nor DOLFINx."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.base.parallel.imports import paused_collection
from hpcinv.base.quantity.schema import Spec
from hpcinv.cli.help import add_command
from hpcinv.errors import HpcinvError
from hpcinv.job.job import Job, check_files, json_schema, load
from hpcinv.job.mesh_contents import LARGEST
from hpcinv.job.plausibility import doubtful_moduli
from hpcinv.job.yaml_reader import is_study, is_sweep


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
    validate.set_defaults(command=_validate)

    schema = add_command(
        commands,
        "schema",
        "Print the JSON Schema of job, study or sweep files, for editors.",
        examples="hpcinv schema > job.schema.json\nhpcinv schema sweep > sweep.schema.json",
        page="reference/job-keys.md",
    )
    schema.add_argument(
        "kind", choices=["job", "study", "sweep"], nargs="?", default="job", help="kind of file, by default a job"
    )
    schema.set_defaults(command=_schema)


def _validate(options: argparse.Namespace) -> int:
    failed = 0
    for path in options.jobs:
        try:
            content = _load(path)
            unread = check_files(content) if isinstance(content, Job) else []
            regions = _regions_of_cad(content) if isinstance(content, Job) and content.mesh.is_cad else []
        except HpcinvError as error:
            print(error, file=sys.stderr)
            failed = error.exit_code
        else:
            if isinstance(content, Job) and content.output.unit_warnings:
                for text in doubtful_moduli(content):
                    print(f"warning: {path}: {text}", file=sys.stderr)
            sizes = ", ".join(f"{file} of {file.stat().st_size / 1e6:.0f} MB" for file in unread)
            limit = f"(up to {LARGEST / 1e6:.0f} MB are)"
            print(f"{path}: valid{f'; not read here: {sizes} {limit}' if unread else ''}")
            for line in regions:
                print(f"  {line}")
    return failed


def _regions_of_cad(job: Job) -> list[str]:
    """Return lines on the solids and faces of a job's CAD file; loads what reads meshes, as no other job does."""
    from hpcinv.mesh.io.isolated import cad_contents

    contents = cad_contents(job.resolve(job.mesh.file))
    unit = job.mesh.metres
    lines = [f"{name}: solid" for name in contents["solids"]]
    for name, centre, area in contents["faces"]:
        place = ", ".join(f"{round(float(x) * unit * 1e3, 6) + 0.0:.5g}" for x in centre)
        lines.append(f"{name}: face of {float(area) * unit**2 * 1e6:.4g} mm^2 around ({place}) mm")
    if not contents["faces"]:
        lines.append("faces: numbered when the solids are joined; 'hpcinv mesh from-cad' lists them")
    return lines


def _load(path: Path) -> object:
    """Return the job, or the plan of the study or sweep, in a file; modules of these two take time to import."""
    if is_study(path):
        from hpcinv.studies.study.study_plan import load_study

        return load_study(path)
    if is_sweep(path):
        from hpcinv.studies.sweep.sweep_plan import load_sweep

        return load_sweep(path)
    with paused_collection():
        return load(path)


def _schema(options: argparse.Namespace) -> int:
    from hpcinv.studies.study.study_spec import Study
    from hpcinv.studies.sweep.sweep_spec import Sweep

    kinds: dict[str, type[Spec]] = {"job": Job, "study": Study, "sweep": Sweep}
    print(json.dumps(json_schema(kinds[options.kind]), indent=2))
    return 0
