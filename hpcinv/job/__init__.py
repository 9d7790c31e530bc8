"""The job file: its sections and the rules by which they are checked."""
