"""The ledger of a sweep: which cases are finished, and which process works on which."""
