"""Stiffness and rest shape from pressure-volume curves: a thick sphere's closed form, and Klotz's curve."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.integrate
from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE, ROOT

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.job.job import parse
from hpcinv.mesh.io.vtu import read_vtu
from hpcinv.studies.dossier.content import dossier_page
from hpcinv.studies.dossier.context import DossierContext
from hpcinv.studies.identification.filling_curves import MMHG, KlotzCurve
from hpcinv.studies.identification.identification_page import FIGURES, write_identification_report
from hpcinv.studies.identification.identification_run import identify

TRUE = {"c1": 0.5, "c2": 0.1}
GIVEN, PRESSURES = 0.2, (0.4,)
WALL = 1.5**3 - 1  # of the given sphere, with radii 1 and 1.5: 3/(4π) of its volume


def pressure(unloaded: float, inner: float) -> float:
    """Pressure in an incompressible Mooney-Rivlin sphere, ``∫ W'(λ)/(λ³ - 1) dλ`` through the wall."""

    def integrand(s: float) -> float:  # W = c1 (2λ² + λ⁻⁴ - 3) + c2 (λ⁴ + 2λ⁻² - 3), without its factor λ³ - 1
        return 4 * (TRUE["c1"] / s**5 * (s**3 + 1) + TRUE["c2"] / s**3 * (s**3 + 1))

    outer = [(radius**3 + WALL) ** (1 / 3) for radius in (unloaded, inner)]
    return float(scipy.integrate.quad(integrand, outer[1] / outer[0], inner / unloaded, epsabs=1e-12)[0])


def sphere(identification: dict[str, Any]) -> dict[str, Any]:
    mesh = {"inner": 1.0, "outer": 1.5, "radial": 2, "along": 2, "hexahedra": True}

    def inflated(by: float | str) -> list[dict[str, Any]]:
        return [{"effect": "pressure", "region": "inner", "pressure": by}]

    return {
        "mesh": {"file": str(ROOT / "meshes" / "thick_sphere.py"), "parameters": mesh, "geometry_degree": 2},
        "material": {"law": "mooney-rivlin", "c1": 0.52, "c2": 0.104, "d1": "incompressible"},
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        "cavities": {"hollow": {"surface": "inner", "lid": {"apex": [0, 0, 0]}}},
        "states": [
            {"name": "scan", "given": True, "effects": inflated(GIVEN)},
            *({"name": f"at-{i}", "effects": inflated(by)} for i, by in enumerate(PRESSURES)),
        ],
        "quantities": [
            {"name": "V", "of": "volume", "cavity": "hollow"},
            {"name": "V0", "of": "volume", "cavity": "hollow", "over": "reference", "state": "scan"},
        ],
        "certificate": NO_CERTIFICATE,
        "identify": identification,
    }


def test_a_filling_curve_determines_a_factor_of_two_stiffnesses(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """The curve of the true sphere, whose unloaded volume is not known, gives both stiffnesses."""
    unloaded = root(lambda radius: pressure(radius, 1.0) - GIVEN, 0.7, 0.999)
    radii = [root(lambda inner, by=by: pressure(unloaded, inner) - by, unloaded, 1.4) for by in PRESSURES]  # type: ignore[misc]
    points = [{"pressure": 0, "volume": math.pi / 6 * unloaded**3}]
    points += [{"pressure": by, "volume": math.pi / 6 * a**3} for by, a in zip(PRESSURES, radii, strict=True)]
    observed = [{"name": "filling", "curve": points, "cavity": "hollow", "sd": 1e-3}]
    parameters = {"material.c1": {"scale": ["material.c2"]}}
    job = parse(sphere({"parameters": parameters, "observations": observed}), tmp_path / "job.yaml")
    pytest.importorskip("emcee")
    identified = identify(job, comm, directory=tmp_path / "out", samples=6)
    estimated = identified.estimate
    print(f"c1 {estimated.values[0]}, history {estimated.history}, sd {estimated.deviations[0]}")
    assert estimated.values[0] == pytest.approx(TRUE["c1"], rel=5e-4)
    law = next(iter(identified.job.laws.values())).quantities()
    assert law["c2"][0] / law["c1"][0] == pytest.approx(TRUE["c2"] / TRUE["c1"], rel=1e-9)
    assert [r.name for r in estimated.residuals] == ["filling: V-at-0", "filling: V0"]
    assert max(residual.largest for residual in estimated.residuals) < 0.2
    # Nearly normal: the volumes are smooth in one parameter.
    assert estimated.sampled is not None
    assert estimated.sampled.acceptance > 0.9
    assert abs(estimated.sampled.samples.mean() - estimated.values[0]) < 1.2 * estimated.deviations[0]
    # The band of the unloaded volume agrees with the closed form at the samples' stiffnesses.
    (curve,) = identified.curves
    closed = [
        math.pi / 6 * root(lambda radius, c1=c1: pressure(radius, 1.0) * c1 / TRUE["c1"] - GIVEN, 0.7, 0.999) ** 3  # type: ignore[misc]
        for c1 in np.quantile(estimated.sampled.samples[:, 0], (0.025, 0.975))
    ]
    assert curve.points[0].band == pytest.approx(closed, rel=1e-3)
    assert curve.points[0].band[1] - curve.points[0].band[0] == pytest.approx(closed[1] - closed[0], rel=0.02)
    # Rest shapes of the samples: with a smaller stiffness the radius was smaller, to first order.
    assert identified.shape_deviations["rest"] == pytest.approx(estimated.sampled.shape_deviations["rest"], rel=0.6)
    if comm.rank == 0:
        band = read_vtu(tmp_path / "out" / "posterior-rest.vtu")
        assert np.linalg.norm(band.data["sd"].values, axis=1).max() == pytest.approx(
            estimated.sampled.shape_deviations["rest"], rel=1e-6
        )
    assert [point.pressure for point in curve.points] == [0.0, GIVEN, *PRESSURES]
    assert curve.points[1].volume == pytest.approx(
        math.pi / 6, rel=2e-4
    )  # of the given body, whose facets are not spherical
    page = write_identification_report(tmp_path / "out", None).read_text()
    assert "data:image/png;base64," in page
    assert "material.c2" in page
    run = tmp_path / "out" / "run"
    summary, figures = (json.loads(path.read_text()) for path in (run / "summary.json", run.parent / FIGURES))
    assert summary["sensitivities"]["quantities"]["V0"]["sd"] is None  # of independent parameters
    assert figures["quantities"]["V0"]["text"] in page
    dossier = dossier_page(run, summary, DossierContext(), figures).decode()
    assert f"{figures['quantities']['V0']['text'].partition('± ')[2]} by the identified parameters" in dossier
    assert "Identified from observations" in dossier
    # The volumes depend on the pressure over the stiffness only, so that both have the same relative slopes.
    slopes = [float(row[0]) for row in estimated.jacobian]
    step = 1e-4
    shorter = [root(lambda A, by=by: pressure(A, 1.0) - by, 0.7, 0.999) for by in (GIVEN - step, GIVEN + step)]  # type: ignore[misc]
    by_pressure = math.pi / 6 * (shorter[1] ** 3 - shorter[0] ** 3) / (2 * step)
    assert slopes[1] == pytest.approx(-by_pressure * GIVEN / TRUE["c1"] / 1e-3, rel=2e-3)


def test_klotz_curve_passes_through_its_two_points() -> None:
    """The curve passes through its two points, and its normalised form through the first (Klotz et al. 2006)."""
    for end_pressure in (4.0, 10.0, 22.0, 25.0):
        curve = KlotzCurve(120e-6, end_pressure * MMHG)
        unloaded = 120e-6 * (0.6 - 0.006 * end_pressure)
        assert curve.unloaded_volume == curve.volume(0.0) == pytest.approx(unloaded, rel=1e-14)
        assert curve.volume(end_pressure * MMHG) == pytest.approx(120e-6, rel=1e-14)
        other = 30.0 if end_pressure <= 22 else 15.0
        at_30 = unloaded + (120e-6 - unloaded) / (end_pressure / 27.78) ** (1 / 2.76)
        second = at_30 if other == 30.0 else unloaded + 0.8 * (at_30 - unloaded)
        assert curve.volume(other * MMHG) == pytest.approx(second, rel=1e-12)


def test_curves_that_do_not_fit_the_job(tmp_path: Path) -> None:
    def refused(observation: dict[str, Any], parameters: dict[str, Any] | None = None, **other: Any) -> str:
        observed = {"name": "filling", "cavity": "hollow", "sd": 1e-3, **observation}
        section = {"parameters": parameters or {"material.c1": None}, "observations": [observed]}
        with pytest.raises(JobError) as error:
            parse(sphere(section) | other, tmp_path / "job.yaml")
        return error.value.message

    line = [{"pressure": 0, "volume": 0.3}, {"pressure": 0.3, "volume": 0.6}]
    assert "does not reach the pressure of V-at-0" in refused({"curve": line})
    assert "with growing pressures" in refused({"curve": line[::-1]})
    assert "there is no cavity 'hole'" in refused({"curve": line, "cavity": "hole"})
    assert "is needed, and valid, with a curve" in refused({"klotz": "given", "cavity": None})
    assert "between 0 and 100 mmHg" in refused({"klotz": {"pressure": "120 mmHg", "volume": "120 ml"}})
    assert "must be a volume, but it is a length" in refused({"klotz": "given", "sd": "1 mm"})
    assert "add {name: V, of: volume, cavity: hollow}" in refused({"klotz": "given"}, quantities=[])
    pressures = {"states[0].effects[0].pressure": None}
    assert "states[0].effects[0].pressure is sought" in refused({"klotz": "given"}, pressures)
    tied = {"material.c1": {"scale": ["material.c3"]}}
    assert "material.c1.scale[0]: material.c3 is not a number" in refused({"klotz": "given"}, tied)
    zero = {"material.c1": {"scale": ["material.c2"]}}
    law = {"law": "mooney-rivlin", "c1": 0.0, "c2": 0.1, "d1": "incompressible"}
    assert "c1 is 0, so that material.c2 has no ratio" in refused({"klotz": "given"}, zero, material=law)
