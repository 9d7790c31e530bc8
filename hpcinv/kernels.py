"""How DOLFINx compiles the kernels of forms and expressions."""

from __future__ import annotations

# -O1: most kernels run as fast as with -O2, within what noise lets see, and the largest compile much faster: the
# tangent of a three-term Ogden law in 4 instead of 57 s of processor time, for 18 % more in each assembly. -g0 halves
# the compile time against the interpreter's own -g; -ffast-math would break small-strain accuracy.
# Another run may be compiling the same kernel: it is waited for, a minute at most.
JIT_OPTIONS = {"cffi_extra_compile_args": ["-O1", "-g0"], "timeout": 60}
"""What DOLFINx is told for every form and expression."""
