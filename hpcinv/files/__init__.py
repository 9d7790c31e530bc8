"""Files and directories: written whole or not at all, locked, and opened only where that is allowed."""
