"""Writers of mesh files for other programs."""
