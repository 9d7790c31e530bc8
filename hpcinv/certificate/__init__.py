"""Certificate of a run: checks of its result that are independent of the solve."""

from __future__ import annotations

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.certificate.certify import certify
from hpcinv.certificate.certify_all import certify_all
from hpcinv.certificate.check import Certificate, Line, Verdict, lower_bound_line, skipped, upper_bound_line
from hpcinv.certificate.discretisation_error import Estimate

__all__ = [
    "Certificate",
    "Estimate",
    "Line",
    "Verdict",
    "certify",
    "certify_all",
    "lower_bound_line",
    "skipped",
    "upper_bound_line",
]
