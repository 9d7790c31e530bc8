"""Functions in files, in the cell order of the mesh's source, by adios4dolfinx."""

from pathlib import Path

from hpcinv.base.parallel.adios import adios2  # noqa: F401  (with MPI, before adios4dolfinx)
from hpcinv.base.parallel.runtime import DOLFINX
from hpcinv.errors import SystemPartMissing

# isort: split
from dolfinx.fem import Function

PACKAGE = "adios4dolfinx"
REMEDY = f"Type 'pip install --no-deps {PACKAGE}=={DOLFINX}.*' (docs/start/installing.md says why)."

try:
    import adios4dolfinx
except ImportError as exc:
    raise SystemPartMissing(f"{PACKAGE} cannot be imported: {exc}", REMEDY) from None


def write_function(path: Path, name: str, function: Function) -> None:
    """Write the owned part of a function, collective.

    Raises:
        RuntimeError: of ADIOS2, the only one that it has.
    """
    adios4dolfinx.write_function_on_input_mesh(path, function, name=name)


def read_function(path: Path, name: str, function: Function) -> None:
    """Read the function that was written as ``name``; collective."""
    adios4dolfinx.read_function(path, function, name=name)
    function.x.scatter_forward()
