"""Directory of the batch scripts for Slurm; as a program, prints it, since Slurm runs a copy of a script."""

from pathlib import Path

_HERE = Path(__file__).resolve().parent
TEMPLATES = _HERE / "slurm" if (_HERE / "slurm").is_dir() else _HERE.parents[2] / "slurm"
"""The copy in an installed package, or the directory ``slurm`` of a clone."""

if __name__ == "__main__":
    print(TEMPLATES)
