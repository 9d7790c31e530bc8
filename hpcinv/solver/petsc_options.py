"""PETSc options of one solver: defaults, options of the job, and the unused ones among these."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from petsc4py import PETSc

from hpcinv.errors import HpcinvError, JobError

type OptionValue = str | float | int | bool | None  # None is a flag

NEWTON: Mapping[str, OptionValue] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",  # monotone ones stall: the residual rises on the way to the solution
    "snes_divergence_tolerance": "unlimited",
    "snes_max_it": 10_000,  # the limit is NewtonMonitor's
    "snes_lag_preconditioner": -2,  # LinearSolver decides when tangents are factorized
}


class SolverOptions:
    """Options in PETSc's database under the prefix of this program, from construction until `remove`.

    Args:
        of_the_job: options of the job by name.
        where: their place in messages.
    """

    prefix = "hpcinv_"

    def __init__(self, job_options: Mapping[str, OptionValue], where: str = "solver.petsc") -> None:
        self._job_options, self._names, self._where = job_options, set(job_options), where
        self._values: dict[str, OptionValue] = {}
        self._texts: dict[str, str] = {}  # values as PETSc's text
        self._database = PETSc.Options(self.prefix)
        self.use({})

    def use(self, defaults: Mapping[str, OptionValue]) -> None:
        """Set the defaults of a linear solver instead of earlier ones, except for options that the job sets."""
        earlier, self._values = self._values, {**NEWTON, **defaults, **self._job_options}
        for name in earlier.keys() - self._values.keys():
            self._database.delValue(name)
        for name in earlier.keys() & self._values.keys():
            if earlier[name] != self._values[name]:
                self._texts.pop(name, None)
        self.restore()

    def change(self, values: Mapping[str, OptionValue]) -> None:
        """Change the values of options, also of options of the job."""
        self._values.update(values)
        for name in values:
            self._texts.pop(name, None)
        self.restore()

    def restore(self) -> None:
        """Set all options again that other solvers have removed or changed; the linear solver may read them again."""
        there = self._database.getAll()
        for name, value in self._values.items():
            if name not in there or there[name] != self._texts.get(name):
                self._database.setValue(name, value)
                if name in self._texts:
                    self._names.discard(name)  # it may have been used before
        now = self._database.getAll()
        self._texts = {name: now.get(name, "") for name in self._values}

    def unused(self) -> list[str]:
        """Return options of the job that PETSc has not used so far: misspelt ones, or ones without effect here."""
        everything = PETSc.Options()  # with a prefix, `used` looks for the wrong name
        # Options that another solver has removed may have been used.
        there = [name for name in sorted(self._names) if name in self._database.getAll()]
        return [name for name in there if not everything.used(self.prefix + name)]

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Context in which an error of PETSc is put down to options of the job, if it has any.

        The options are removed then, so that jobs which follow in this process do not meet them. An error of
        hpcinv in a function that PETSc calls is raised unchanged.

        Raises:
            JobError: with PETSc's reason, instead of its error.
        """
        try:
            yield
        except PETSc.Error as error:
            origin = _origin(error)
            if isinstance(origin, HpcinvError):
                raise origin from None
            if not self._job_options or not isinstance(origin, PETSc.Error):
                raise
            self.remove()
            raise JobError(f"{self._where}: {_refusal(self._job_options, _said(origin))}") from error

    def remove(self) -> None:
        """Remove the options, so that PETSc does not report unused ones a second time when it ends."""
        for name in self._database.getAll():
            self._database.delValue(name)


def _origin(error: BaseException) -> BaseException:
    """Return the error in a function that PETSc called, if that was the cause of an error of PETSc."""
    while isinstance(error, PETSc.Error) and error.__cause__ is not None:
        error = error.__cause__
    return error


def _said(error: PETSc.Error) -> list[str]:
    """Return what PETSc says about an error, line by line, without its call stack and without links."""
    lines = [re.sub(r"^\[\d+\] ", "", line) for line in str(error).splitlines()]
    said = [re.sub(r":? *https?://\S+", "", line).strip(" .") for line in lines[1:] if "() at " not in line]
    return [line for line in said if line] or lines[:1]


def _refusal(options: Mapping[str, OptionValue], said: Sequence[str]) -> str:
    """Return a message on the options whose values PETSc names, or on all if it names none."""
    naming: dict[str, list[str]] = {}
    for name, value in options.items():
        if isinstance(value, str) and value:
            naming[name] = [line for line in said if re.search(rf"(?<!\w){re.escape(value)}(?!\w)", line)]
    named = [name for name in options if naming.get(name)]
    blamed = ", ".join(f"'{name}{'' if (v := options[name]) is None else f': {v}'}'" for name in named or options)
    if named:
        reasons = dict.fromkeys(line for name in named for line in naming[name])
        return f"PETSc refuses {blamed}: {'; '.join(reasons)}; correct or remove it"
    return f"PETSc fails with {blamed}: {'; '.join(said)}; change or remove these options"
