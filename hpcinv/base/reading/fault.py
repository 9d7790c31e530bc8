"""What is wrong with a file."""

IMAGING = "Install it by: pip install 'hpcinv[imaging]'"
"""what installs the packages of images"""


class Fault(Exception):
    """A file cannot be read, or contradicts itself; ``text`` follows the file's name in the message."""

    def __init__(self, text: str, advice: str = "") -> None:
        super().__init__(text, advice)
        self.text = text
        self.advice = advice


def shown(text: str, most: int = 100) -> str:
    """Return text from a file for a message: of ``most`` characters, all of them printable."""
    short = text if len(text) <= most else f"{text[:most]}…"
    return "".join(c if c.isprintable() else "?" for c in short)


class PackageMissing(Fault):
    """A package that reads this format is not installed."""
