"""The boundary of a body and of results, and what is inside: gathered, kept with a run, and read again."""
