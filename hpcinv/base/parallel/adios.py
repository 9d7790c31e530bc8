"""ADIOS2 with MPI from two wheels: Python bindings without MPI, and the libraries with MPI that DOLFINx is linked to.

Bindings and libraries of one version have the same classes. The bindings lack one function, the constructor of ADIOS
with a communicator, which is called here in the library. This avoids compiling ADIOS2, which takes minutes.
DOLFINx is imported first: only then do the bindings use its libraries, and not their own without MPI.

Import ``adios2`` from here: only files of meshes and of checkpoints need it.
"""

import ctypes

from hpcinv.base.parallel.runtime import INSTALLING, MPI
from hpcinv.errors import SystemPartMissing

# isort: split
try:
    import adios2
except ImportError as error:
    raise SystemPartMissing(f"adios2 cannot be imported: {error}", INSTALLING) from None

TESTED = "2.12.1.1001"
"""version of the bindings without MPI whose memory layout was tested"""


class _SharedPointer(ctypes.Structure):
    """``std::shared_ptr`` of libstdc++."""

    _fields_ = (("object", ctypes.c_void_p), ("counter", ctypes.c_void_p))


def _provide_mpi() -> None:
    """Give ADIOS2's Python bindings an ``ADIOS(comm)``, unless they were built with MPI.

    Raises:
        SystemPartMissing: bindings or libraries are not those for which this was made.
    """
    bindings = adios2.bindings
    if bindings.is_built_with_mpi:
        return
    if bindings.__version__ != TESTED:
        raise _missing(f"version {bindings.__version__} was built without MPI")
    try:
        library = ctypes.CDLL("libadios2_cxx_mpi.so.2.12")
        construct = library["_ZN6adios25ADIOSC1Ei"]  # adios2::ADIOS::ADIOS(MPI_Comm), where MPI_Comm is an integer
        release = library["_ZNSt16_Sp_counted_baseILN9__gnu_cxx12_Lock_policyE2EE10_M_releaseEv"]
    except (OSError, AttributeError) as exc:
        raise _missing(f"it was built without MPI, and DOLFINx has no ADIOS2 with MPI ({exc})") from None
    construct.argtypes, construct.restype = [ctypes.c_void_p, ctypes.c_int], None
    release.argtypes, release.restype = [ctypes.c_void_p], None

    class ADIOS(bindings.ADIOS):  # type: ignore[misc, name-defined]  # without types
        """ADIOS on the ranks of a communicator."""

        def __init__(self, comm: MPI.Intracomm) -> None:
            super().__init__()  # without MPI
            # nanobind writes the place of a C++ object behind the head of the Python object. This C++ object is
            # a shared pointer, as is adios2::ADIOS: one with the communicator replaces it.
            start = ctypes.c_int32.from_address(id(self) + object.__basicsize__).value
            content = _SharedPointer.from_address(id(self) + start)
            release(content.counter)
            construct(ctypes.byref(content), comm.handle)

    bindings.ADIOS, bindings.is_built_with_mpi = ADIOS, True


def _missing(reason: str) -> SystemPartMissing:
    return SystemPartMissing(f"adios2 cannot be imported: {reason}", INSTALLING)


_provide_mpi()
__all__ = ["adios2"]
