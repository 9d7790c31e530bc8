"""Another program loads the rest shape of a run: whole decks of it, and the distance of its body from the given one."""
