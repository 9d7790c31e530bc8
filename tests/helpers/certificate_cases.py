"""Bodies whose certificates are tested."""

from __future__ import annotations

from typing import Any

from helpers.command_line import NO_CERTIFICATE
from helpers.verification import box, job
from hpcinv.output.result import Result
from hpcinv.trust.certificate import Line

ESTIMATE = NO_CERTIFICATE | {"estimate": True}


def line(result: Result, name: str) -> Line:
    (named_line,) = [entry for entry in result.certificate.lines if entry.name.startswith(name)]
    return named_line


def column(divisions: int, **changes: Any) -> Any:
    mesh = box((1, 1, divisions), lx="0.2 m", ly="0.2 m")
    return job(
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "current"}],
        supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        quantities=[{"name": "length", "of": "Z", "on": "z1", "reduce": "mean"}],
        **{"mesh": mesh, "certificate": ESTIMATE, **changes},
    )
