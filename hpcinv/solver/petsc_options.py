"""PETSc options of one solver: defaults, what the job sets, and which of the latter nothing asked for."""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

type Value = str | float | int | bool | None  # None is a flag

NEWTON: Mapping[str, Value] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",  # monotone ones stall: the residual rises on the way to the solution
    "snes_divergence_tolerance": "unlimited",
    "snes_max_it": 10_000,  # the limit is NewtonMonitor's
}


class SolverOptions:
    """Options in PETSc's database under a prefix of their own, from construction until `remove`."""

    prefix = "hpcinv_"

    def __init__(self, of_the_job: Mapping[str, Value]) -> None:
        self._of_the_job, self._names = of_the_job, set(of_the_job)
        self._values: dict[str, Value] = {}
        self._texts: dict[str, str] = {}  # the same as PETSc has them
        self._database = PETSc.Options(self.prefix)
        self.use(NEWTON)

    def use(self, defaults: Mapping[str, Value]) -> None:
        """Set defaults, but for those that the job sets itself."""
        self._values |= {**defaults, **self._of_the_job}
        self.restore()

    def restore(self) -> None:
        """Put back what other solvers have removed or changed: the linear solver may ask again."""
        there = self._database.getAll()
        for name, value in self._values.items():
            if name not in there or there[name] != self._texts.get(name):
                self._database.setValue(name, value)
                if name in self._texts:
                    self._names.discard(name)  # it may have been used before
        now = self._database.getAll()
        self._texts = {name: now.get(name, "") for name in self._values}

    def unused(self) -> list[str]:
        """Options of the job that nothing in PETSc has asked for so far: misspelt, or without effect here."""
        everything = PETSc.Options()  # with a prefix of its own, `used` looks for the wrong name
        # Those that another solver has taken back may have been used.
        there = [name for name in sorted(self._names) if name in self._database.getAll()]
        return [name for name in there if not everything.used(self.prefix + name)]

    def remove(self) -> None:
        """Take the options back, so that PETSc does not report the unused ones a second time at its end."""
        for name in self._database.getAll():
            self._database.delValue(name)
