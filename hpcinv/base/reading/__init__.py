"""Files from other people, read in a child process with limits: nothing here loads MPI, PETSc or DOLFINx.

`isolated_reader` is the program of the child; `hpcinv.mesh.io.isolated` starts it.
"""
