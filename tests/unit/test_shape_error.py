"""The headline of a run is the largest error of the shape, with its cause and an advice that fits this cause."""

from __future__ import annotations

from typing import Any

import pytest

from hpcinv.output.shape_error import REMEDIES, shape_error
from hpcinv.pages.reports.wording import words

DISPLACEMENT = 4e-3


def summary(mesh: float | None, surface: float | None, gap: float, verdict: str = "warning") -> dict[str, Any]:
    lines = [
        {"name": "discretisation error of the shape", "value": (mesh or 0.0) / DISPLACEMENT},
        {"name": "round trip, relative to the displacement", "value": gap / DISPLACEMENT},
        {"name": "smallest volume ratio J", "value": 0.4, "verdict": verdict, "note": "at (0, 0, 0) m"},
    ]
    return {
        "status": "converged",
        "job": {"job": "kidney", "analysis": "inverse"},
        "solutions": [{"direction": "inverse", "largest_displacement": DISPLACEMENT}],
        "surface_errors": None if surface is None else {"shape": {"sd": surface}},
        "certificate": {
            "verdict": verdict,
            "lines": [{"verdict": "pass", "note": "", "unit": ""} | line for line in lines],
            "estimate": None if mesh is None else {"shape": mesh, "without_geometry": ""},
        },
    }


@pytest.mark.parametrize(
    ("mesh", "surface", "gap", "cause", "headline", "advice"),
    [
        (
            40.9e-6,
            642e-6,
            1e-12,
            "surface",
            "uncertain by 642 µm (16 % of the displacement)",
            "a better surface",
        ),
        (642e-6, 40.9e-6, 1e-12, "mesh", "within 642 µm (16 % of the displacement)", "Refine the mesh"),
        (642e-6, None, 1e-12, "mesh", "within 642 µm", "Refine the mesh"),
        (40.9e-6, None, 1e-3, "round trip", "misses the given body by 1 mm", "the line on stability"),
        (None, 642e-6, 1e-12, "surface", "uncertain by 642 µm", None),  # the mesh's error may be larger
    ],
)
def test_the_headline_is_the_largest_error_with_its_cause(
    mesh: float | None, surface: float | None, gap: float, cause: str, headline: str, advice: str | None
) -> None:
    data = summary(mesh, surface, gap)
    error_sum, report = shape_error(data), words(data, overlapping=False)
    assert error_sum is not None
    assert (error_sum.cause, error_sum.largest) == (
        cause,
        max(error for error in (mesh, surface, gap) if error is not None),
    )
    first, *others = (text for text in report.sure if "µm" in text or " mm" in text)
    assert headline in first
    advised = [text for text in report.next if text in REMEDIES.values()]
    assert not advised if advice is None else any(advice in text for text in advised)
    if cause != "mesh":
        assert not any("Refine the mesh" in text for text in [*report.sure, *report.next])
    assert len(others) == len(error_sum.causes) - 1
    assert any("not estimated" in text for text in report.sure) == (mesh is None)


def test_a_good_shape_from_coarse_voxels_is_not_to_be_refined() -> None:
    report = words(summary(40.9e-6, 642e-6, 0.0, "pass"), overlapping=False)
    assert report.next[0].startswith("Use the shape")
    assert "a finer mesh does not help" in report.next[1]


def test_without_any_estimate_there_is_not_a_headline() -> None:
    assert shape_error(summary(None, None, 0.0)) is None
