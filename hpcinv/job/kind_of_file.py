"""Kind of a YAML file: a job, a study or a sweep."""

from pathlib import Path

from hpcinv.job.yaml_reader import read_yaml


def is_study(path: Path) -> bool:
    """Return whether a file is a study rather than a job; raises ``JobError`` if it cannot be read."""
    return "series" in read_yaml(path)


def is_sweep(path: Path) -> bool:
    """Return whether a file is a sweep rather than a job or a study; raises ``JobError`` if it cannot be read."""
    return "axes" in read_yaml(path)
