"""The suffix by which the format of a file is known."""

from pathlib import Path

METAIMAGE, NRRD = (".mha", ".mhd"), (".nrrd",)
"""suffixes of images with a header of text"""


def suffix_of(path: Path | str) -> str:
    """Return the last suffix in lower case: programs on Windows write ``PART.STEP``."""
    return Path(path).suffix.lower()
