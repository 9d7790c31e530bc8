"""Arrays within an HTML page: 16 bits for each number, differences of neighbours, compressed, in base64."""

import base64
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

LEVELS = 65_535


class PackedArrays:
    """Arrays of one page, numbered in the order in which they are added; ``viewer/src/arrays.js`` reads them."""

    def __init__(self) -> None:
        self.specs: list[dict[str, Any]] = []
        self._parts: list[bytes] = []

    def add(self, values: npt.NDArray[Any]) -> int:
        """Add numbers (n,) or (n, components), kept to 1/65535 of the range of each component."""
        columns = np.asarray(values, dtype=float).reshape(len(values), -1)
        finite = np.where(np.isfinite(columns), columns, 0.0)
        low = finite.min(axis=0) if len(finite) else np.zeros(columns.shape[1])
        span = np.ptp(finite, axis=0) if len(finite) else np.zeros(columns.shape[1])
        levels = np.rint((finite - low) / np.where(span > 0, span, 1.0) * LEVELS)
        return self._append(levels, low=low.tolist(), span=span.tolist())

    def add_whole(self, values: npt.NDArray[Any]) -> int:
        """Add whole numbers from 0 to 65535, (n,) or (n, components), which are kept exactly."""
        columns = np.asarray(values).reshape(len(values), int(np.prod(np.shape(values)[1:])))
        zeros, ones = [0.0] * columns.shape[1], [float(LEVELS)] * columns.shape[1]
        return self._append(columns, low=zeros, span=ones)

    def texts(self) -> list[str]:
        """Return the content of each array as text."""
        return [base64.b64encode(part).decode() for part in self._parts]

    def _append(self, columns: npt.NDArray[Any], **spec: Any) -> int:
        levels = columns.T.astype(np.uint16)
        steps = np.diff(levels, axis=1, prepend=np.uint16(0))  # modulo 65536
        content = steps.astype("<u2").reshape(-1).view(np.uint8).reshape(-1, 2).T.tobytes()  # low bytes, high bytes
        self._parts.append(zlib.compress(content, 9))
        self.specs.append({"rows": columns.shape[0], "components": columns.shape[1], **spec})
        return len(self.specs) - 1
