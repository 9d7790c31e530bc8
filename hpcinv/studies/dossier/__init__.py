"""Credibility dossier of a run, in the order of ASME V&V 40 and of the FDA's guidance."""
