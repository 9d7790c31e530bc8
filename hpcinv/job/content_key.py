"""What makes two runs the same: a hash of all that their results depend on, wherever their files are."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.job.fingerprint import WITH_DEFINITIONS, file_digest, fingerprint

if TYPE_CHECKING:
    from hpcinv.job.job import Job

_HOW = {"solver", "method", "fixed_point", "certificate", "quantities"}
_IF_ASKED_FOR = {"accuracy", "sensitivities"}


def content_key(job: Job, digest: Callable[[Path], str] = file_digest, **circumstances: Any) -> str:
    """20 hex digits from the physics, the mesh, the spaces, the solver, the certificate and all that is asked for.

    Names, paths, output, checkpoints, and units that values are written in are no part of it.

    Args:
        digest: of a file, for callers with many jobs on the same files.
        circumstances: what else tells runs apart, as JSON data, such as ``ranks``.
    """
    content = (
        fingerprint(job, digest) | job.model_dump(mode="json", include=_HOW, context=WITH_DEFINITIONS) | circumstances
    )
    content |= {name: part for name, part in job.model_dump(mode="json", include=_IF_ASKED_FOR).items() if part}
    if (expected := job.expected_shape) is not None:
        content["expected_shape"] = expected.model_dump(mode="json", exclude={"file"}) | {
            "sha256": digest(job.resolve(expected.file))
        }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:20]
