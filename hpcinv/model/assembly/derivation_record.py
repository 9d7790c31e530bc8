"""Records of what was derived from a form, kept among the kernels, so that later processes do without UFL.

UFL takes half a second or more to derive moduli or Taylor arithmetic, whether their kernels are compiled or not. The
name of a record is a hash of all that the derivation depends on: the form, the modules that derive, the versions of
the programs, and the compiler's flags.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from hashlib import sha1
from pathlib import Path
from types import ModuleType
from typing import Any

import ffcx
import ufl
from ffcx.codegeneration import get_signature

from hpcinv.base.parallel.jit import read_record, write_record
from hpcinv.base.parallel.runtime import MPI


class DerivationRecord:
    """A record next to the kernels; methods are collective.

    Args:
        kind: first part of the record's name.
        description: all numbers on which the derivation depends, and the signature of the form.
        modules: modules that derive.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        kind: str,
        description: bytes,
        modules: Sequence[ModuleType],
        jit_options: Mapping[str, Any],
    ) -> None:
        flags = jit_options.get("cffi_extra_compile_args")
        files = tuple(str(module.__file__) for module in modules)
        self._name = f"{kind}_{sha1(f'{flags} {_programs(files)}'.encode() + description).hexdigest()}"
        self._comm, self._directory = comm, Path(jit_options["cache_dir"])

    def read(self) -> Any:
        """Return the recorded data, or ``None`` on this rank if there is no record for it."""
        name, directory = self._name, self._directory
        recorded, text = self._comm.bcast((name, read_record(name, directory)) if self._comm.rank == 0 else None)
        # Flags depend on the processor: rank 0 may know of kernels that this one cannot run.
        return json.loads(text) if text is not None and recorded == name else None

    def write(self, data: Any) -> None:
        if self._comm.rank == 0:
            write_record(self._name, json.dumps(data), self._directory)


@cache
def _programs(files: tuple[str, ...]) -> str:
    """Return a hash of the modules that derive, and the versions of the programs that compile."""
    ours = b"".join(Path(file).read_bytes() for file in (*files, __file__))
    return f"{sha1(ours).hexdigest()} {ufl.__version__} {ffcx.__version__} {get_signature()}"
