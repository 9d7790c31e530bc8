"""``hpcinv identify``: parameters of a job and its rest shape from observations; under mpirun for more ranks."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.cli.options import add_ranks
from hpcinv.errors import JobError
from hpcinv.job.job import Job, load

if TYPE_CHECKING:
    from hpcinv.mesh.source import Floats
    from hpcinv.studies.identification.identification_run import Identified
    from hpcinv.studies.identification.job_evaluation import Evaluation


_FEWEST = 10  # samples of a posterior: with fewer its quantiles say nothing


def add_identify(commands: Any) -> None:
    identify = add_command(
        commands,
        "identify",
        "Find parameters of a job and its rest shape from observations of several states (under mpirun).",
        examples="mpirun -n 2 hpcinv identify job.yaml\nhpcinv identify job.yaml --output results/found --overwrite",
        page="how-to/identify.md",
    )
    identify.add_argument("job", type=Path, help="job file (YAML) with a section 'identify'")
    identify.add_argument(
        "--output", type=Path, metavar="DIR", help="where results go (default: results/JOB-identified)"
    )
    identify.add_argument("--overwrite", action="store_true", help="replace another identification in --output")
    identify.add_argument("-q", "--quiet", action="store_true", help="print no line for each evaluation")
    identify.add_argument("--strict", action="store_true", help="end with exit code 7 if there are warnings")
    identify.add_argument(
        "--ranks-per-state",
        type=int,
        metavar="N",
        help="ranks of each team that solves some of the states (default: all)",
    )
    identify.add_argument(
        "--posterior",
        type=int,
        default=0,
        metavar="N",
        help="sample the posterior, with N exact evaluations after the surrogate's",
    )
    add_ranks(identify)
    add_option(identify)
    identify.set_defaults(command=_identify)


def _lines(identified: Identified) -> list[str]:
    """Return what was identified, as lines of text."""
    from hpcinv.studies.identification.identification_report import describe

    lines = describe(identified.estimate)
    for name, sd in identified.shape_deviations.items():
        lines.append(f"shape{f' {name!r}' if name else ''}: standard deviation up to {sd:.2g} m")
    lines += [f"{name}: {identified.quantity_text(name)}" for name in identified.quantity_deviations]
    return [*lines, f"certificate: {identified.result.certificate.verdict.value}", str(identified.cost)]


def _identify(options: argparse.Namespace) -> int:
    if options.posterior < 0 or 0 < options.posterior < _FEWEST:
        raise JobError(f"--posterior {options.posterior}: is too few: {_FEWEST} or more, or 0 for none")
    from hpcinv.base.parallel.launch import launched

    with launched(options.ranks) as (comm, stop):
        from hpcinv.base.parallel.runtime import on_root
        from hpcinv.studies.identification.identification_report import value_text, warnings
        from hpcinv.studies.identification.identification_run import identify

        job = on_root(comm, lambda: _read(options.job))
        directory = options.output or Path("results") / f"{job.job}-identified"

        def tell(number: int, values: Floats, chi_squared: float, evaluation: Evaluation) -> None:
            if options.quiet:
                return
            parameters = job.with_({"sensitivities": list(job.identify.parameters)}).differentiated  # type: ignore[union-attr]
            shown = ", ".join(f"{p.key} = {value_text(p, v)}" for p, v in zip(parameters, values, strict=True))
            ended = f"not reached: {evaluation.failure}" if evaluation.failure else f"chi-square {chi_squared:.6g}"
            print(f"evaluation {number}{' (kept)' if evaluation.kept else ''}: {shown}: {ended}", flush=True)

        identified = identify(
            job,
            comm,
            directory=directory,
            overwrite=options.overwrite,
            report=tell,
            stop_asked=stop,
            ranks_per_state=options.ranks_per_state,
            samples=options.posterior,
        )
        texts = warnings(identified.estimate)
        verdict = identified.result.certificate.verdict
        if comm.rank == 0:
            print("\n".join(_lines(identified)))
            print(f"\n{(directory / 'sections.yaml').read_text('utf-8')}\nresults: {directory}", flush=True)
            for text in texts:
                print(f"warning: {text}", file=sys.stderr)
        code = verdict.exit_code(strict=options.strict)
    return code or (7 if options.strict and texts else 0)


def _read(path: Path) -> Job:
    job = load(path)
    if job.identify is None:
        raise JobError(f"{path}: has no section 'identify', which names parameters and observations")
    return job
