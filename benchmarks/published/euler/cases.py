"""The number of unstable directions of the straight column, by the certificate's line on stability."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hpcinv.output.result import Result


def quantities(name: str, result: Result) -> dict[str, float]:
    """Return the number of unstable directions."""
    (line,) = (line for line in result.certificate.lines if line.name.startswith("stability"))
    return {"unstable-directions": float("nan") if line.value is None else line.value}
