"""PETSc options of one solver: defaults, options of the job, and the unused ones among these."""

from collections.abc import Mapping

from petsc4py import PETSc

type Value = str | float | int | bool | None  # None is a flag

NEWTON: Mapping[str, Value] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",  # monotone ones stall: the residual rises on the way to the solution
    "snes_divergence_tolerance": "unlimited",
    "snes_max_it": 10_000,  # the limit is NewtonMonitor's
    "snes_lag_preconditioner": -2,  # LinearSolver decides when tangents are factorized
}


class SolverOptions:
    """Options in PETSc's database under the prefix of this program, from construction until `remove`."""

    prefix = "hpcinv_"

    def __init__(self, of_the_job: Mapping[str, Value]) -> None:
        self._of_the_job, self._names = of_the_job, set(of_the_job)
        self._values: dict[str, Value] = {}
        self._texts: dict[str, str] = {}  # the same as PETSc has them
        self._database = PETSc.Options(self.prefix)
        self.use({})

    def use(self, defaults: Mapping[str, Value]) -> None:
        """Set the defaults of a linear solver in place of earlier ones, except for options that the job sets."""
        before, self._values = self._values, {**NEWTON, **defaults, **self._of_the_job}
        for name in before.keys() - self._values.keys():
            self._database.delValue(name)
        for name in before.keys() & self._values.keys():
            if before[name] != self._values[name]:
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

    def remove(self) -> None:
        """Remove the options, so that PETSc does not report unused ones a second time when it ends."""
        for name in self._database.getAll():
            self._database.delValue(name)
