"""The certificate: what a run's answer is worth, found by checks that its solve did not need."""

from __future__ import annotations

from hpcinv.certificate.certify import certify
from hpcinv.certificate.estimate import Estimate
from hpcinv.certificate.verdict import Certificate, Line, Verdict, at_least, at_most, skipped

__all__ = ["Certificate", "Estimate", "Line", "Verdict", "at_least", "at_most", "certify", "skipped"]
