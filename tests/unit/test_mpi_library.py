"""The MPI library of another environment than this Python's."""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from hpcinv.base.parallel import ranks


@pytest.mark.parametrize(("own", "named"), [(True, False), (False, True)])
def test_library_is_named_if_it_is_not_in_this_environment(
    own: bool, named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """mpi4py finds a library in the environment of this Python by itself."""
    package = tmp_path / "lib" / "python3.12" / "site-packages" / "mpi4py" / "__init__.py"
    library = tmp_path / "lib" / "libmpi.so.12"
    library.parent.mkdir()
    library.touch()
    monkeypatch.setenv("MPI4PY_LIBMPI", "restored after the test")
    monkeypatch.delenv("MPI4PY_LIBMPI")
    monkeypatch.setattr(sys, "prefix", str(tmp_path if own else tmp_path / "other"))
    monkeypatch.setattr(ranks.importlib.util, "find_spec", lambda name: ModuleSpec(name, None, origin=str(package)))
    ranks._find_library()
    assert ranks.os.environ.get("MPI4PY_LIBMPI") == (str(library) if named else None)
