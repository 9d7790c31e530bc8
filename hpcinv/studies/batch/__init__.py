"""The engine of studies and sweeps: cases, their identity, ledger and store, execution, and tables."""
