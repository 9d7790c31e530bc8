"""Launchers of other MPIs, found in the environment before MPI starts: later, MPI ends the process by itself."""

import sys
from collections.abc import MutableMapping
from pathlib import Path

from hpcinv.errors import SystemPartMissing

_PMIX = "PMIX_NAMESPACE"  # the variable by which MPICH takes the launcher for one of PMIx


def adapt_to_launcher(library: str, environment: MutableMapping[str, str]) -> None:
    """Check before MPI starts that its launcher speaks its protocol.

    Variables of PMIx around a launcher of MPICH, as in a shell that ``srun --mpi=pmix`` has started, are removed.

    Args:
        library: what ``MPI_Get_library_version`` says.

    Raises:
        SystemPartMissing: MPICH without PMIx was started by a launcher that speaks only that.
    """
    if _PMIX not in environment or not library.startswith("MPICH") or "pmix" in library.lower():
        return
    if "PMI_RANK" in environment:
        for name in [name for name in environment if name.startswith("PMIX_")]:
            del environment[name]
        return
    raise SystemPartMissing(
        f"{_launcher(environment)} speaks PMIx, which {_name(library)}, the MPI that is loaded, does not", _advice()
    )


def check_size(library: str, environment: MutableMapping[str, str], size: int) -> None:
    """Raise ``SystemPartMissing`` if MPI has one rank, although its launcher has started several.

    Each would solve the whole job, and all would write to the same place.
    """
    announced = environment.get("PMI_SIZE", "")
    if size == 1 and announced.isdecimal() and int(announced) > 1:
        raise SystemPartMissing(
            f"the launcher has started {announced} processes, and {_name(library)} takes each for a run of its own",
            _advice(),
        )


def _launcher(environment: MutableMapping[str, str]) -> str:
    if any(name.startswith("OMPI_") for name in environment):
        return "Open MPI's mpirun"
    return "srun --mpi=pmix" if "SLURM_JOB_ID" in environment else f"the launcher ({_PMIX} is set)"


def _name(library: str) -> str:
    """Name and version of an MPI, such as ``MPICH 5.0.2``."""
    first = library.partition("\n")[0].partition(",")[0]
    return " ".join(first.replace("Version:", "").split())


def _advice() -> str:
    own = Path(sys.executable).with_name("mpirun")
    launcher = str(own) if own.exists() else "the mpirun of the MPI that mpi4py was built with"
    return f"Start it by {launcher}, or under Slurm by 'srun --mpi=pmi2'."
