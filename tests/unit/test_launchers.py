"""What is read from the environment before MPI starts: the launcher, and the home directory."""

from __future__ import annotations

import os
import pwd
import tempfile
from pathlib import Path

import pytest

from hpcinv.base.parallel.home import provide_home
from hpcinv.base.parallel.launchers import adapt_to_launcher, check_size
from hpcinv.errors import OutputError, SystemPartMissing

MPICH = "MPICH Version:      5.0.2\nMPICH configure:    --with-device=ch4:ucx,ofi\n"
OPEN_MPI = "Open MPI v4.1.4, package: Debian OpenMPI, ident: 4.1.4"
PMIX = {"PMIX_NAMESPACE": "prterun-7", "PMIX_RANK": "0"}


@pytest.mark.parametrize("library", [OPEN_MPI, MPICH.replace("ucx", "ucx --with-pmix=/usr"), "Intel(R) MPI Library"])
def test_mpis_that_speak_pmix_take_it(library: str) -> None:
    variables = dict(PMIX)
    adapt_to_launcher(library, variables)
    assert variables == PMIX


def test_mpich_without_pmix_refuses_a_launcher_of_pmix() -> None:
    with pytest.raises(SystemPartMissing, match=r"speaks PMIx, which MPICH 5\.0\.2"):
        adapt_to_launcher(MPICH, dict(PMIX))


def test_an_inner_launcher_of_mpich_counts() -> None:
    variables = {**PMIX, "PMI_RANK": "0", "PMI_SIZE": "2"}
    adapt_to_launcher(MPICH, variables)
    assert variables == {"PMI_RANK": "0", "PMI_SIZE": "2"}


def test_single_ranks_instead_of_one_run_are_refused() -> None:
    with pytest.raises(SystemPartMissing, match=r"started 3 processes, and Open MPI v4\.1\.4 takes each for a run"):
        check_size(OPEN_MPI, {"PMI_SIZE": "3"}, 1)
    for variables, size in (({"PMI_SIZE": "3"}, 3), ({"PMI_SIZE": "1"}, 1), ({}, 1)):
        check_size(MPICH, variables, size)


def test_a_home_that_is_a_directory_is_kept(tmp_path: Path) -> None:
    variables = {"HOME": str(tmp_path)}
    provide_home(variables)
    assert variables == {"HOME": str(tmp_path)}


@pytest.mark.parametrize("home", [None, "", "relative", "/dev/null"])
def test_a_users_value_replaces_another(home: str | None, tmp_path: Path) -> None:
    variables = {} if home is None else {"HOME": home}
    provide_home(variables)
    assert variables["HOME"] == pwd.getpwuid(os.geteuid()).pw_dir


def test_a_user_who_is_in_no_database_gets_a_private_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(_: int) -> None:
        raise KeyError

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    homes = [dict[str, str](), dict[str, str]()]
    for variables in homes:
        provide_home(variables)
    home = Path(homes[0]["HOME"])
    assert homes[0] == homes[1]
    assert home.parent == tmp_path
    assert home.stat().st_mode & 0o777 == 0o700
    home.chmod(0o777)
    with pytest.raises(OutputError, match="can be written by everybody"):
        provide_home({})
