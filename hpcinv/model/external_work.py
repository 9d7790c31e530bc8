"""Virtual work of an effect, with one message where the text of an effect is wrong."""

from __future__ import annotations

import sys
import traceback
from typing import Any

import ufl

from hpcinv.errors import HpcinvError, JobError, described
from hpcinv.model.plugin_terms import noted
from hpcinv.physics.effects import Effect
from hpcinv.physics.kinematics.kinematics import Kinematics

ADVICE = (
    "  Return a sum of integrals that are linear in v: k.dV(f) or k.dv(f) over the reference or current volume,"
    " k.dA(f, region) or k.da(f, region) over an area."
)


def external_work(where: str, effect: Effect, k: Kinematics, v: Any, load: Any, par: Any) -> Any | None:
    """Return the external virtual work of an effect, ``None`` if it has none.

    Args:
        where: place of the effect in the job.

    Raises:
        JobError: its `virtual_work` fails, or returns something else than an integral linear in ``v``.
    """
    source = sys.modules[type(effect).__module__].__file__ or type(effect).__module__
    try:
        work = effect.virtual_work(k, v, load, par)
    except HpcinvError:
        raise
    except Exception as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == source]
        line = f", line {lines[-1]}" if lines else ""
        raise JobError(f"{where}: {source}{line}: virtual_work fails: {described(error)}", ADVICE) from error
    if work is None or work == 0:
        return None
    if not isinstance(work, ufl.Form):
        raise JobError(f"{where}: {source}: virtual_work returns no integral, but {type(work).__name__}", ADVICE)
    try:
        is_linear = ufl.algorithms.compute_form_arities(work) == {1}
    except Exception:  # the kind of error depends on the operator
        is_linear = False
    if not is_linear:
        raise JobError(f"{where}: {source}: virtual_work is not linear in v", ADVICE)
    return noted(where, effect.virtual_work, work)
