"""Sensitivities: how the body that was looked for, and what is asked about it, change with numbers of the job."""
