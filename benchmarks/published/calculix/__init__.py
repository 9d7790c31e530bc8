"""Reference results of CalculiX, and CalculiX itself next to us."""
