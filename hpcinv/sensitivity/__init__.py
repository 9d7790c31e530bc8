"""Sensitivities of the computed body and of its quantities of interest to parameters of the job."""
