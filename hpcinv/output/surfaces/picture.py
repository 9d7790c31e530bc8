"""A picture as bytes, whoever drew it."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from hpcinv.base.files.atomic import write_output


@dataclass(frozen=True, repr=False)
class Picture:
    """A picture as PNG, which notebooks display."""

    png: bytes

    def save(self, path: str | PathLike[str]) -> None:
        """Write the picture to a file; raises ``OutputError`` if it cannot be written."""
        write_output(Path(path), self.png)

    def __repr__(self) -> str:
        """Return one line, which notebooks save with the picture."""
        return f"<picture of {len(self.png):,} bytes of PNG>"

    def _repr_png_(self) -> bytes:
        return self.png
