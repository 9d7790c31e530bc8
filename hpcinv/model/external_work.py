"""Virtual work and constraints of effects, with one message where the text of an effect is wrong."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import ufl

from hpcinv.errors import HpcinvError, JobError, described
from hpcinv.physics.effects import Effect
from hpcinv.physics.kinematics.kinematics import Kinematics
from hpcinv.physics.points.kernels import noted

ADVICE = (
    "  Return a sum of integrals that are linear in v: k.dV(f) or k.dv(f) over the reference or current volume,"
    " k.dA(f, region) or k.da(f, region) over an area."
)
ADVICE_ON_CONSTRAINTS = (
    "  Return a sum of integrals of u that is zero at the solution: k.dV(f), k.dv(f), k.dA(f, region), k.da(f, region)."
)


def external_work(where: str, effect: Effect, k: Kinematics, v: Any, load: Any, par: Any) -> Any | None:
    """Return the external virtual work of an effect, ``None`` if it has none.

    Args:
        where: place of the effect in the job.

    Raises:
        JobError: its `virtual_work` fails, or returns something else than an integral linear in ``v``.
    """
    source = _source(effect)
    work = _returned(where, effect, effect.virtual_work, (k, v, load, par), ADVICE)
    if work is None:
        return None
    try:
        is_linear = ufl.algorithms.compute_form_arities(work) == {1}
    except Exception:  # the kind of error depends on the operator
        is_linear = False
    if not is_linear:
        raise JobError(f"{where}: {source}: virtual_work is not linear in v", ADVICE)
    return noted(where, effect.virtual_work, work)


def constraint_forms(
    named: Iterable[tuple[str, tuple[Effect, Any, Any]]], k: Kinematics, u: Any
) -> Iterator[tuple[int, Any]]:
    """Yield the constraints of effects of which the solve may find a number, with their places among the effects.

    Raises:
        JobError: a `constraint` fails, or returns something else than an integral.
    """
    for number, (where, (effect, load, p)) in enumerate(named):
        if effect.finds:
            form = _returned(where, effect, effect.constraint, (k, u, load, p), ADVICE_ON_CONSTRAINTS)
            if form is None or form.arguments():
                text = "constraint returns no integral of u alone"
                raise JobError(f"{where}: {_source(effect)}: {text}", ADVICE_ON_CONSTRAINTS)
            yield number, noted(where, effect.constraint, form)


def _source(effect: Effect) -> str:
    return sys.modules[type(effect).__module__].__file__ or type(effect).__module__


def _returned(where: str, effect: Effect, method: Callable[..., Any], args: tuple[Any, ...], advice: str) -> Any | None:
    """Return the integral that a method of an effect returns, ``None`` if there is none; raises ``JobError``."""
    source, name = _source(effect), method.__name__
    try:
        form = method(*args)
    except HpcinvError:
        raise
    except Exception as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == source]
        line = f", line {lines[-1]}" if lines else ""
        raise JobError(f"{where}: {source}{line}: {name} fails: {described(error)}", advice) from error
    if form is None or form == 0:
        return None
    if not isinstance(form, ufl.Form):
        raise JobError(f"{where}: {source}: {name} returns no integral, but {type(form).__name__}", advice)
    return form
