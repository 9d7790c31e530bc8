"""Former names of packages that users' files import."""

import subprocess
import sys
from importlib import import_module

import pytest


@pytest.mark.parametrize(
    ("former", "present"),
    [
        ("quantity", "base.quantity"),
        ("quantity.expressions", "base.quantity.expressions"),
        ("materials", "physics.materials"),
        ("materials.isochoric", "physics.materials.isochoric"),
        ("effects.effect", "physics.effects.effect"),
        ("kinematics.stable_functions", "physics.kinematics.stable_functions"),
    ],
)
def test_a_former_name_is_the_same_module(former: str, present: str) -> None:
    module = import_module(f"hpcinv.{present}")
    assert import_module(f"hpcinv.{former}") is module
    assert module.__spec__ is not None
    assert module.__spec__.name == module.__name__ == f"hpcinv.{present}"


def test_missing_modules_of_former_packages_are_not_found() -> None:
    with pytest.raises(ModuleNotFoundError):
        import_module("hpcinv.materials.nothing")


def test_batch_scripts_run_a_program_by_its_former_name() -> None:
    printed = [
        subprocess.run([sys.executable, "-m", name], check=True, capture_output=True, text=True).stdout
        for name in ("hpcinv.sweep.templates", "hpcinv.studies.sweep.templates")
    ]
    assert printed[0] == printed[1] != ""
