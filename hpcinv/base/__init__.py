"""What everything else stands on: numbers with units, files, ranks, and files read in a process of its own."""
