"""The mark by which a batch script knows that a run has saved something: without it, a requeue gets no further."""

import os
from contextlib import suppress
from pathlib import Path

VARIABLE = "HPCINV_SAVED"
"""environment variable with the path of the mark, which ``slurm/launch.sh`` sets"""


def mark_saved() -> None:
    """Make the mark, if the environment names one; on one rank."""
    if path := os.environ.get(VARIABLE):
        with suppress(OSError):
            Path(path).touch()
