"""Untrusted files: with ``--untrusted`` nothing in them is executed, and no files outside their directory are used.

For the risks of jobs without the option see docs/how-to/security.md. The checks are made where a file is read:
validators use `applies`, and report faults at their places. The option sets the environment variable
HPCINV_UNTRUSTED=1, which has the same effect for all commands, also in processes that a command starts.
"""

import argparse
import os
import re
import sys
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, ValidationInfo

from hpcinv.base.files.names import NamesFile, exists
from hpcinv.base.reading.door import PLACES, REFUSED, VARIABLE, admit, is_asked, path_fault
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.suffix import METAIMAGE, NRRD, suffix_of
from hpcinv.errors import JobError
from hpcinv.on_demand import on_demand

_IMAGES = METAIMAGE + NRRD
"""suffixes of images whose headers can name other files"""
_WORKING_DIRECTORY = (
    ".petscrc",
    "petscrc",
    "petsc.cfg",
    "ucx.conf",
    "dolfinx_jit_options.json",
    "ffcx_options.json",
    "matplotlibrc",
)
"""Files that libraries read in the working directory, and that can make them load libraries or write files."""


def add_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--untrusted`` to the parser of a command that reads a job, study, sweep or mesh."""
    parser.add_argument(
        "--untrusted",
        action="store_true",
        help="for files from others: refuse everything that could execute code or access other files",
    )


def applies(info: ValidationInfo) -> bool:
    """Return whether the validated data are untrusted."""
    return bool((info.context or {}).get("untrusted", False))


def _stays_beside(path: str, info: ValidationInfo) -> str:
    if applies(info) and (fault := path_fault((info.context or {}).get("directory", Path()), path)):
        raise ValueError(f"'{path}' {fault}")
    return path


FileBeside = Annotated[str, NamesFile(), AfterValidator(_stays_beside)]
"""Path to a file; in untrusted data it must be in or below the directory of the file that contains the path."""


@contextmanager
def asked_for(options: argparse.Namespace) -> Iterator[None]:
    """Context in which ``--untrusted`` of a command applies, also to all processes that it starts.

    Raises:
        JobError: files in the working directory could be executed.
    """
    with _kept_environment():
        if getattr(options, "untrusted", False):
            os.environ[VARIABLE] = "1"
        if is_asked():
            named = list(_named_in(options))
            _check_working_directory(named)
            admit(*named, *(path.resolve().parent for path in named if path.is_file()), Path("results"))
        yield


@contextmanager
def applied_to(places: Sequence[Path]) -> Iterator[None]:
    """Context in which only files in some places are read, as with ``--untrusted``; all files if there are none."""
    with _kept_environment():
        if places:
            os.environ[VARIABLE] = "1"
            admit(*places)
        yield


@contextmanager
def _kept_environment() -> Iterator[None]:
    kept = {name: os.environ.get(name) for name in (VARIABLE, PLACES)}
    try:
        yield
    finally:
        for name, value in kept.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _named_in(options: argparse.Namespace) -> Iterator[Path]:
    """Yield the files and directories that the arguments name; those to be written need not exist."""
    for value in vars(options).values():
        for entry in value if isinstance(value, list | tuple) else [value]:
            if isinstance(entry, Path) or (isinstance(entry, str) and exists(entry)):
                yield Path(entry)


def _check_working_directory(files: list[Path]) -> None:
    here = Path.cwd()
    if names := [name for name in _WORKING_DIRECTORY if os.path.lexists(name)]:
        text = f"{here / names[0]}: {REFUSED}: a library reads it, as it is in the working directory"
        raise JobError(f"{text}, and it can name code to load; start from another directory, or remove it")
    homes = [path.resolve().parent for path in files if path.is_file()]
    if str(here) in sys.path and any(here == home or home in here.parents for home in homes):
        text = f"{here}: {REFUSED}: with 'python -m' Python imports modules from the working directory"
        raise JobError(f"{text}, where the file is; start as 'hpcinv …', or from another directory")


def image_fault(path: Path) -> str:
    """Fault of a file that is an image with a header that is damaged, or names other files."""
    if suffix_of(path) not in (*_IMAGES, ".gz"):
        return ""
    try:
        source = on_demand("voxels of an image")(path)
    except Fault as damage:  # also of a pattern that would write to memory
        return f"{shown(damage.text, 200)}; it is {REFUSED}"
    except (OSError, ValueError, EOFError, zlib.error):  # reported by its reader
        return ""
    if source.how in ("a pattern of names", "a list of names"):
        return f"names its files by {source.how}, which is {REFUSED}; ask for it as one file"
    for name in source.names:
        if fault := path_fault(path.parent, name):
            return f"has its voxels in '{shown(name)}', which {fault}"
    return ""


_KRYLOV = "preonly cg fcg pipecg minres gmres fgmres lgmres dgmres gcr bcgs fbcgs bcgsl tfqmr cr richardson chebyshev"
_PRECONDITIONERS = "none jacobi pbjacobi bjacobi sor ilu icc lu cholesky asm gasm gamg mg fieldsplit redundant svd"
_WORDS = {
    "snes_type": "newtonls newtontr",
    "snes_linesearch_type": "basic bt l2 cp nleqerr none",
    "ksp_type": _KRYLOV,
    "ksp_norm_type": "none default preconditioned unpreconditioned natural",
    "ksp_pc_side": "left right symmetric",
    "pc_type": _PRECONDITIONERS,
    "pc_factor_mat_solver_type": "mumps petsc superlu superlu_dist umfpack cholmod",
    "pc_precision": "single double",
    "pc_factor_mat_ordering_type": "natural nd 1wd rcm qmd",
    "pc_factor_shift_type": "none nonzero positive_definite inblocks",
    "pc_fieldsplit_type": "additive multiplicative symmetric_multiplicative schur",
    "pc_fieldsplit_schur_fact_type": "diag lower upper full",
    "pc_fieldsplit_schur_precondition": "a11 self selfp user full",
    "pc_gamg_type": "agg classical",
    "pc_mg_type": "multiplicative additive full kaskade",
    "pc_mg_cycle_type": "v w",
    "pc_asm_type": "basic restrict interpolate none",
}
"""PETSc options with a choice of words, by their names without the prefix of an inner solver."""
_NUMBERS = re.compile(
    r"snes_(rtol|atol|stol|max_it|max_funcs|divergence_tolerance|lag_jacobian|lag_preconditioner)"
    r"|snes_linesearch_(max_it|damping|minlambda|maxlambda|maxstep|order|rtol|atol|ltol)"
    r"|ksp_(rtol|atol|divtol|max_it|min_it|initial_guess_nonzero|gmres_restart|gmres_modifiedgramschmidt|lgmres_augment)"
    r"|ksp_(chebyshev_esteig|chebyshev_esteig_steps|chebyshev_eigenvalues|richardson_scale|bcgsl_ell)"
    r"|pc_factor_(levels|fill|shift_amount|zeropivot|reuse_ordering|reuse_fill|pivot_in_blocks)"
    r"|pc_(sor_omega|sor_its|sor_lits|asm_overlap|asm_blocks|bjacobi_blocks|mg_levels|jacobi_abs|redundant_number)"
    r"|pc_gamg_(threshold|threshold_scale|agg_nsmooths|aggressive_coarsening|square_graph|coarse_eq_limit)"
    r"|pc_gamg_(process_eq_limit|repartition|reuse_interpolation|asm_use_agg|recompute_esteig|esteig_ksp_max_it)"
    # The first three integer controls of MUMPS are output units, and 22 writes factors to files.
    r"|mat_mumps_(icntl_([4-9]|1\d|2[013-9]|[3-5]\d)|cntl_[1-7])"
)
"""PETSc options with numbers, or true and false, as values."""
_INNER = re.compile(r"(mg_levels(_\d+)?_|mg_coarse_|sub_|redundant_|fieldsplit_[a-z0-9]+_|pc_gamg_esteig_)+")
_PLAIN = re.compile(r"[-+]?[\d.][-+\d.eE]*(,[-+]?[\d.][-+\d.eE]*)*|true|false|yes|no|on|off|unlimited|", re.IGNORECASE)


def option_fault(name: str, value: object) -> str:
    """Fault of a PETSc option of an untrusted job; empty text if the option is known to be harmless.

    PETSc has thousands; some execute code (``pc_type python``) or write files (``ksp_view ascii:PATH``).
    """
    inner = _INNER.match(name)
    bare = name[inner.end() :] if inner else name
    text = "" if value is None else str(value)
    if bare in _WORDS:
        if text in _WORDS[bare].split():
            return ""
        return f"cannot be '{text[:40]}', which is {REFUSED}; choose one of {', '.join(_WORDS[bare].split())}"
    if _NUMBERS.fullmatch(bare) is None:
        return f"is {REFUSED}, as all PETSc options that are not known to be harmless; remove it"
    return "" if _PLAIN.fullmatch(text) else f"must be a number, true or false; other values are {REFUSED}"
