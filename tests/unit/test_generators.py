"""What is read from mesh generators without running them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.typed import files

from hpcinv.job.mesh_generators import converted_parameters, parameters_of, read_parameters, resolution_of

PYTHON = """
from hpcinv.base.quantity import quantity
from hpcinv.base.quantity import Dimensionless, Length
raise SystemExit("a generator must not be run to be checked")
def build(gmsh, origin: float = 0.0, *, length: Length, size: "Length" = 2e-3, taper: Dimensionless = 0,
          cells: int = 3, curved: bool = True, shape: str = "round", angle=0.0, area: quantity.Area = 1) -> None:
    ...
"""
GEO = """// DefineConstant[ not_this = 1 ];
/* DefineConstant[ nor_this = 1 ]; */
DefineConstant[ size = {0.1, Min 0, Max 1, Name "Parameters/Size [m], of; cells"}, n = 3 ];
DefineConstant[ length ];
other = 4;
"""


def read(tmp_path: Path, name: str, text: str, given: dict[str, object]) -> Any:
    path = tmp_path / name
    path.write_text(text)
    return read_parameters(path, given)


def test_parameters_of_a_python_generator_are_converted_by_their_annotation(tmp_path: Path) -> None:
    given = {"length": "18 cm", "size": "2 mm", "taper": "5 %", "cells": 4, "curved": False, "shape": "square"}
    values, problems = read(tmp_path, "m.py", PYTHON, {**given, "angle": "90 deg", "area": "1 cm^2", "origin": "1 mm"})
    assert problems == []
    assert values == pytest.approx(
        {"length": 0.18, "size": 0.002, "taper": 0.05, "cells": 4, "curved": False, "angle": 1.5707963267948966}
        | {"area": 1e-4, "origin": 1e-3, "shape": "square"}
    )


@pytest.mark.parametrize(
    ("given", "place", "text"),
    [
        ({}, "length", "is needed by m.py"),
        ({"length": 1, "sise": 1}, "sise", "m.py has no such parameter. Did you mean 'size'?"),
        ({"length": 1, "gmsh": 1}, "gmsh", "m.py has no such parameter."),
        ({"length": "1 kg"}, "length", "is a mass"),
        ({"length": 1, "cells": 2.5}, "cells", "must be a whole number, not 2.5"),
        ({"length": 1, "cells": True}, "cells", "must be a whole number, not True"),
        ({"length": 1, "curved": 1}, "curved", "must be true or false, not 1"),
        ({"length": 1, "shape": 1}, "shape", "must be text, not 1"),
        ({"length": [1]}, "length", "must be a length"),
    ],
)
def test_parameters_that_do_not_fit_are_named(tmp_path: Path, given: dict[str, object], place: str, text: str) -> None:
    _, [(where, what)] = read(tmp_path, "m.py", PYTHON, given)
    assert where == (place,)
    assert text in what


def test_parameters_of_a_gmsh_script_are_its_defined_constants(tmp_path: Path) -> None:
    values, problems = read(tmp_path, "m.geo", GEO, {"size": "2 mm", "other": 1})
    assert values == {"size": 0.002}
    assert problems == [(("other",), "m.geo has no such parameter. Known: length, n, size.")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1", "must define build"),
        ("def build(): ...", "must take gmsh as its first argument"),
        ("def build(gmsh:\n", "m.py, line 1: "),
        ("def build(gmsh, a: list[float]): ...", "'a' of build() is a list[float]; a job can give "),
    ],
)
def test_invalid_generators_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "m.py"
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(message)):
        parameters_of(path)


RESOLVED = """
def build(gmsh, *, size: Size = 0.25, near: quantity.Size = sum([1]), n: Divisions = 4, width: Length = 2.0): ...
"""


def test_a_generator_says_what_makes_its_mesh_finer(tmp_path: Path) -> None:
    path = tmp_path / "m.py"
    path.write_text(RESOLVED)
    assert resolution_of(path, {"width": 3.0}).parameters == {"size": 0.25, "n": 4}
    assert resolution_of(path, {"near": 0.5, "n": 3}).parameters == {"size": 0.25, "near": 0.5, "n": 3}
    assert resolution_of(path, {}).finer(2).parameters == {"size": 0.125, "n": 8}
    assert resolution_of(path, {"n": 3}).finer(1.5).parameters == {"n": 5, "size": 0.25 / 1.5}
    assert resolution_of(path, {"n": 1}).finer(0.5).parameters == {"n": 1, "size": 0.5}
    path.write_text(GEO)
    path = path.rename(tmp_path / "m.geo")
    assert resolution_of(path, {}).parameters == {}


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"n": 0}, "must be at least 1"),
        ({"n": 2**63 - 1}, "must be at least 1 and at most 1,000,000, not 9,223,372,036,854,775,807"),
        ({"n": "5/2"}, "must be a whole number"),
        ({"n": 1.5}, "must be a whole number"),
        ({"size": 0}, "must be above 0"),
    ],
)
def test_resolutions_that_make_no_mesh_are_refused(tmp_path: Path, given: dict[str, object], text: str) -> None:
    _, [(_, what)] = read(tmp_path, "m.py", RESOLVED.replace("sum([1])", "1"), given)
    assert text in what


def test_arithmetic_reaches_a_generator_as_a_number(tmp_path: Path) -> None:
    values, problems = read(tmp_path, "m.py", RESOLVED.replace("sum([1])", "1"), {"n": "12/3", "size": "1/4"})
    assert (values, problems) == ({"n": 4, "size": 0.25}, [])
    assert type(values["n"]) is int


def test_lengths_reach_a_generator_in_the_unit_it_works_in(tmp_path: Path) -> None:
    """Defaults too, but neither a default of its own kind nor a value that is not a length."""
    path = tmp_path / "body.py"
    path.write_text(
        "def build(gmsh, *, length: Length, size: Size = 2e-6, side: Area = 4e-12, mu: Stress = 1e3, n: int = 2): ..."
    )
    parameters = converted_parameters(path, {"length": 1.82e-6, "mu": 5.0}, 1e-6)
    assert parameters == {"length": 1.82, "size": 2.0, "side": 4.0, "mu": 5.0}
    path.write_text("def build(gmsh, *, length: Length = HALF): ...")
    with pytest.raises(ValueError, match="needs a number for length"):
        converted_parameters(path, {}, 1e-6)


@pytest.mark.parametrize(
    ("parameter", "unit", "remedy"),
    [
        ("size=6.0", 1.0, "annotate it there (size: Length or Size), or give a plain number"),
        ("size=6.0", 1e-3, "annotate it there (size: Length or Size), or give a plain number"),
        ("size: float = 6.0", 1e-3, "annotate it there (size: Length or Size), or give a plain number"),
        (
            "size: quantity.AnyQuantity = 6.0",
            1e-3,
            "annotate it there (size: Length or Size), or give a plain number",
        ),
    ],
)
def test_a_quantity_for_a_parameter_of_unknown_unit_is_refused(
    tmp_path: Path, parameter: str, unit: float, remedy: str
) -> None:
    """It reached a generator that works in mm as 0.006: gmsh then makes cells until memory is full."""
    path = tmp_path / "m.py"
    path.write_text(f"def build(gmsh, *, {parameter}): ...")
    values, [(where, what)] = read_parameters(path, {"size": "6 mm"}, unit)
    assert values == {}
    assert where == ("size",)
    assert what.startswith("is given as '6 mm', but build() does not define that size is a length, nor its unit; ")
    assert remedy in what
    path.write_text(f"def build(gmsh, *, {parameter}, angle=0): ...")
    assert read_parameters(path, {"size": 6, "angle": "180 deg"}, unit) == ({"size": 6, "angle": np.pi}, [])


def test_a_quantity_without_a_name_of_its_own_is_refused_without_a_type_for_it(tmp_path: Path) -> None:
    path = tmp_path / "m.py"
    path.write_text("def build(gmsh, *, eta=1): ...")
    _, [(_, what)] = read_parameters(path, {"eta": "1 Pa s"})
    assert what.endswith("eta is a viscosity, nor its unit; give a plain number, which is passed unchanged")


def test_a_gmsh_script_takes_quantities_in_si(tmp_path: Path) -> None:
    path = tmp_path / "m.geo"
    path.write_text(GEO)
    assert read_parameters(path, {"size": "2 mm"}, 1e-3) == ({"size": 0.002}, [])


def test_the_generator_on_the_page_about_jobs_meshes_a_bar_with_its_regions(tmp_path: Path) -> None:
    from hpcinv.mesh.cell_count import MeshingMonitor
    from hpcinv.mesh.readers import build_python

    path = tmp_path / "bar.py"
    path.write_text(files(Path(__file__).parents[2] / "docs" / "start" / "jobs.md")[path.name])
    values, problems = read_parameters(path, {"length": "6 cm", "size": "10 mm"})
    assert (values, problems) == (pytest.approx({"length": 0.06, "size": 0.01}), [])
    source = build_python(path, values, 2, MeshingMonitor(10_000))
    assert {group.name for group in source.groups} == {"clamp", "bar"}
    assert source.points.max(axis=0) == pytest.approx([0.06, 0.02, 0.01])
    assert resolution_of(path, values).sizes
