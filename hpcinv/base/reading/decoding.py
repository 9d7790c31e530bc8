"""Text of files in the encodings that programs write."""

import re
from collections.abc import Iterator
from contextlib import suppress

_NOT_TEXT = re.compile(r"[\0-\x08\x0e-\x19\x1b-\x1f\x7f]")  # old systems end files with \x1a


def decoded(content: bytes) -> tuple[str, str]:
    """Return text and encoding of a file: UTF-8, UTF-16, or else Windows' Latin-1; ``ValueError`` if it is not text."""
    for text, encoding in _decodings(content):
        if not _NOT_TEXT.search(text):
            return text, encoding
    raise ValueError("is not a text file")


def _decodings(content: bytes) -> Iterator[tuple[str, str]]:
    marked = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    # Latin letters in UTF-16 have a zero byte each, text in other encodings has none.
    guesses = (
        ["utf-16"] if marked else ["utf-16-le", "utf-16-be"] if b"\0" in content else ["utf-8-sig", "cp1252", "latin-1"]
    )
    for encoding in guesses:
        with suppress(UnicodeDecodeError):
            name = "UTF-8" if encoding == "utf-8-sig" else "UTF-16" if "16" in encoding else "Latin-1"
            yield content.decode(encoding), name
