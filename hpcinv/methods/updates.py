"""The update rules by the names that the field ``method`` of a job knows."""

from __future__ import annotations

from hpcinv.methods.aitken import Aitken
from hpcinv.methods.anderson import Anderson
from hpcinv.methods.sellier import Sellier
from hpcinv.methods.update import Update

UPDATES: dict[str, type[Update]] = {name: rule for rule in (Sellier, Aitken, Anderson) for name in rule.names}
