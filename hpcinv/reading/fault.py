"""What is wrong with a file."""


class Fault(Exception):
    """A file cannot be read, or contradicts itself; ``text`` follows the file's name in the message."""

    def __init__(self, text: str, advice: str = "") -> None:
        super().__init__(text, advice)
        self.text = text
        self.advice = advice


class PackageMissing(Fault):
    """A package that reads this format is not installed."""
