"""What a client asks of a served job, and why it is refused."""

from __future__ import annotations

from dataclasses import dataclass


class Refusal(Exception):
    """A request that is answered with an error of the protocol: its kind and message."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


@dataclass(frozen=True)
class Question:
    """A request that needs a solve.

    Attributes:
        kind: ``Evaluate``, ``Gradient`` or ``ApplyJacobian``.
        inputs: lists of numbers, in the units of the model.
        level: of the certificate.
        vector: weights of an output list of a gradient, or direction of an input list of ``ApplyJacobian``.
        output, input: numbers of these lists.
    """

    kind: str
    inputs: list[list[float]]
    level: str = "off"
    vector: tuple[float, ...] = ()
    output: int = 0
    input: int = 0


@dataclass(frozen=True)
class Table:
    """Rows of text about the inputs or outputs of a model.

    Attributes:
        sizes: lengths of the lists.
        rows: name, unit and value of each number of the first list, if that has single numbers.
        arrays: a line about each further list.
    """

    sizes: tuple[int, ...]
    rows: tuple[tuple[str, str, str], ...] = ()
    arrays: tuple[str, ...] = ()
