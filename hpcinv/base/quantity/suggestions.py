"""Suggestions for misspelt names."""

import difflib
from collections.abc import Iterable


def did_you_mean(word: str, known: Iterable[str], *, list_all: bool = True) -> str:
    """`` Did you mean 'x'?`` for the nearest of the known names, otherwise all of them; begins with a space."""
    names = sorted(set(known))
    for case in (str, str.casefold):  # exact case first: Pa and PA are not the same
        folded = {case(n): n for n in reversed(names)}
        matches = difflib.get_close_matches(case(word), folded, n=1, cutoff=0.6)
        if matches:
            return f" Did you mean '{folded[matches[0]]}'?"
    return f" Known: {', '.join(names)}." if names and list_all else ""
