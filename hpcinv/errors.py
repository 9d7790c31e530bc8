"""Exceptions with a message, a remedy and the exit code of the command line."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar, Self


class HpcinvError(Exception):
    """Base of all errors that are shown to the user as one message, without a traceback."""

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str, advice: str = "") -> None:
        super().__init__(message, advice)
        self.message = message
        self.advice = advice

    def __str__(self) -> str:
        return f"{self.message}\n  {self.advice}" if self.advice else self.message


def described(error: BaseException) -> str:
    """Return kind and text of an error in code of others; a lack of memory often has no text."""
    text = str(error) or ("there is not enough memory" if isinstance(error, MemoryError) else "")
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


class JobError(HpcinvError):
    """The job file is wrong; ``problems`` holds one line for each error in it."""

    exit_code = 2

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems

    def __reduce__(self) -> tuple[type[Self], tuple[str, ...]]:
        return type(self), self.problems


class MeshError(HpcinvError):
    """The mesh cannot be used: unreadable, inverted cells, empty or unknown regions."""

    exit_code = 2


@contextmanager
def naming_field(field: str) -> Iterator[None]:
    """Add the name of a job field to a ``MeshError``."""
    try:
        yield
    except MeshError as error:
        raise MeshError(f"{field}: {error.message}", error.advice) from None


class OutputError(HpcinvError):
    """Results cannot be written where they were asked for."""

    exit_code = 2


class SubmitError(HpcinvError):
    """A batch system is not there, or refuses a job."""

    exit_code = 2


class SolveError(HpcinvError):
    """The load was not reached; the message is the diagnosis."""

    exit_code = 3


class CheckpointError(HpcinvError):
    """A checkpoint is damaged, or belongs to another problem."""

    exit_code = 4


class SystemPartMissing(HpcinvError):
    """Something that hpcinv needs is missing: an X library, a Python package, a C compiler for a plugin's operator."""

    exit_code = 5


class OutOfMemory(HpcinvError):
    """There is not enough memory."""

    exit_code = 5

    @classmethod
    def describing(cls, error: MemoryError) -> Self:
        """Return the message for an error of Python or NumPy, which may have no text."""
        text = f"there is not enough memory: {error}" if str(error) else "there is not enough memory"
        return cls(text, "Take a machine with more memory, more nodes, or a smaller problem.")


class Interrupted(HpcinvError):
    """A signal asked the run to stop; it was checkpointed and can be resumed (``EX_TEMPFAIL``)."""

    exit_code = 75
