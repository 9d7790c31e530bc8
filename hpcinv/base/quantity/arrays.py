"""Types of arrays of numbers; `LocalIndices` are DOLFINx's, `Ints` global ones and rows of files."""

import numpy as np
import numpy.typing as npt

type Floats = npt.NDArray[np.float64]
type Singles = npt.NDArray[np.float32]
type Ints = npt.NDArray[np.int64]
type LocalIndices = npt.NDArray[np.int32]
type Booleans = npt.NDArray[np.bool_]
