"""Files and directories: atomic writing, locks, and checks of untrusted files."""
