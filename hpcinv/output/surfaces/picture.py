"""A picture as bytes, whoever drew it, and the fields in whose colours a result is drawn."""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal, get_args

from hpcinv.base.files.atomic import write_output

type Colour = Literal["displacement", "von-mises", "pressure", "J", "error", "regions"]
COLOURS: tuple[Colour, ...] = get_args(Colour.__value__)
REGIONS = ("#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#0072B2", "#D55E00", "#F0E442", "#999999")
"""colours of regions in pictures and pages, in the order of the regions (Okabe & Ito)"""


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
