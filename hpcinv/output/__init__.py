"""Output of a run: fields, checkpoints, progress, the log, and the run directory."""
