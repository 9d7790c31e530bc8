"""Sobol indices of a sweep from the command line, against the closed form of a block at small strain."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import hpcinv_here
from helpers.sweeps import BLOCK, write_sweep

from hpcinv.mesh.io.vtu import read_vtu

DENSITIES, MODULI = (0.1, 0.3), (20e3, 40e3)


@pytest.mark.release
def test_a_block_at_small_strain(tmp_path: Path) -> None:
    """Displacements are ρ/E times a field: E[ρ] = (a + b)/2, E[ρ²] = (a² + ab + b²)/3, E[1/E] = ln(b/a)/(b - a),
    E[1/E²] = 1/(ab), so that with the relative variances v of ρ and w of 1/E, V = (1 + v)(1 + w) - 1, S = v/V,
    T = v (1 + w)/V. The strain of 1e-4 is the error of the closed form.
    """
    sample = {"effects[0].density": list(DENSITIES), "material.young": list(MODULI)}
    job = {**BLOCK, "material": {"law": "neo-hookean", "young": "20 kPa", "poisson": 0.3}}
    sweep = write_sweep(
        tmp_path,
        [{"sobol": sample, "count": 32, "seed": 1}],
        job=job,
        set={"output": {"mesh": ["vtu"], "unit_warnings": False}},
    )
    ended = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    shape, output = tmp_path / "spread.vtu", tmp_path / "indices.json"
    ended = hpcinv_here("sweep", "indices", sweep, "--shape", shape, "--output", output, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "not decided" not in ended.stdout

    (a, b), (c, d) = DENSITIES, MODULI
    v = (a * a + a * b + b * b) / 3 / ((a + b) / 2) ** 2 - 1
    w = 1 / (c * d) / (math.log(d / c) / (d - c)) ** 2 - 1
    whole = (1 + v) * (1 + w) - 1
    data = json.loads(output.read_text())
    top = data["quantities"]["top"]
    for table in (top, data["shape"]):
        for key, x, y in (("effects[0].density", v, w), ("material.young", w, v)):
            assert table["indices"][key]["first"]["value"] == pytest.approx(x / whole, abs=2e-3)
            assert table["indices"][key]["total"]["value"] == pytest.approx(x * (1 + y) / whole, abs=2e-3)
    assert top["standard_deviation"]["value"] == pytest.approx(math.sqrt(whole) * abs(top["mean"]["value"]), rel=2e-3)

    field = read_vtu(shape)
    given = np.round(field.points * 4) / 4  # nodes of the given cube, since displacements are small
    height = field.points - given
    sd = field.data["sd"].values[:, 0]
    np.testing.assert_allclose(sd, math.sqrt(whole) * np.linalg.norm(height, axis=1), atol=2e-3 * sd.max())
    free = given[:, 2] > 0
    np.testing.assert_allclose(
        field.data["total index of material.young"].values[free, 0], w * (1 + v) / whole, atol=5e-3
    )
    dominating = field.data["dominating parameter"].values[:, 0]
    assert (dominating[free] == 0).all()
    assert (dominating[~free] == -1).all()
