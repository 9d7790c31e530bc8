"""Files that documents, job files and comments refer to are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
REFERENCE = re.compile(
    r"(?<![\w/.:-])((?:tests|benchmarks|docs|hpcinv|meshes|jobs|slurm)/[\w./-]*\.(?:py|md|ya?ml|sbatch|sh|png|svg|geo|msh))"
)
LINK = re.compile(r"\]\((?!https?:)([\w./-]+\.\w+)")
WRITTEN = re.compile(r"^jobs/(?:job|arm|sag|sheet)")  # stand for files of the reader
RECIPE = re.compile(r"^<!-- file: ([\w./-]+) -->$", re.MULTILINE)  # a file that the reader makes
MADE = re.compile(r"> ([\w./-]+)$", re.MULTILINE)  # by a command of the same document


def documents() -> list[Path]:
    paths = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    for directory, kind in (("jobs", "yaml"), ("slurm", "s*"), ("benchmarks", "py"), ("hpcinv", "py")):
        paths += (ROOT / directory).rglob(f"*.{kind}")
    return sorted(paths)


def missing_in(path: Path) -> set[str]:
    """Files that a document names and that are not there."""
    text = path.read_text()
    named = set(REFERENCE.findall(text)) - set(MADE.findall(text)) - set(RECIPE.findall(text))
    missing = {name for name in named if not WRITTEN.match(name) and not (ROOT / name).exists()}
    if path.suffix == ".md":
        missing |= {name for name in LINK.findall(text) if not (path.parent / name).exists()}
    return missing


def test_files_that_documents_name_exist() -> None:
    missing = {str(path.relative_to(ROOT)): names for path in documents() if (names := missing_in(path))}
    assert not missing
