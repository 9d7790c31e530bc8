"""The job file: its sections, and the rules that they are checked against."""
