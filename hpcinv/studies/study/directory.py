"""Directory of a study: its tables and diagrams, and in ``store`` the records of its runs."""

import contextlib
import json
from pathlib import Path

from hpcinv.base.files.atomic import output_errors, publish, replace
from hpcinv.base.files.names import check_output
from hpcinv.errors import OutputError

STORE = "store"
_MARK = "study.json"


class StudyDirectory:
    """Directory of a study, which any number of allocations may use at once.

    Raises:
        OutputError: it holds other files than this study's, or cannot be written.
    """

    def __init__(self, path: Path, study: str) -> None:
        self.path = path
        check_output(path)
        with output_errors(self.path, "Choose another --output."):
            check_content(path, study)
            path.mkdir(parents=True, exist_ok=True)
            publish(path / _MARK, json.dumps({"study": study}).encode())

    def set_ranks(self, ranks: int) -> None:
        """Note the number of ranks with which the study is started."""
        self.write(_MARK, json.dumps(_mark(self.path) | {"ranks": ranks}))

    def write(self, name: str, content: str | bytes) -> None:
        """Write a file of the study; it appears whole or not at all."""
        with output_errors(self.path, "Choose another --output."):
            replace(self.path / name, content.encode() if isinstance(content, str) else content, shared=True)


def check_content(path: Path, study: str) -> None:
    """Raise ``OutputError`` if a directory holds anything else than this study.

    Hidden files are from another allocation that begins at the same moment.
    """
    if (
        path.is_dir()
        and any(not p.name.startswith(".") for p in path.iterdir())
        and (name := _mark(path).get("study")) != study
    ):
        content = f"the study '{name}'" if name else "files that are not of a study"
        raise OutputError(f"{path}: holds {content}", "Choose another --output.")


def ranks_in(path: Path) -> int:
    """Return the number of ranks with which the study in a directory was last started; 1 if that is not known."""
    ranks = _mark(path).get("ranks")
    return ranks if isinstance(ranks, int) else 1


def _mark(path: Path) -> dict[str, object]:
    with contextlib.suppress(OSError, ValueError):
        content = json.loads((path / _MARK).read_text())
        return content if isinstance(content, dict) else {}
    return {}
