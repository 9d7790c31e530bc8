"""The ledger of a store: which cases are finished, and which process works on which."""
