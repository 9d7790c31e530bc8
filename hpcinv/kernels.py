"""How DOLFINx compiles the kernels of forms and expressions."""

from __future__ import annotations

# -O1: the kernels run as fast as with -O2, within what the noise lets see, and the largest compile in a tenth of the time
# (the tangent of a three-term Ogden law in 5 instead of 45 s). -g0 halves it against the interpreter's own -g;
# -ffast-math would break small-strain accuracy. Another run may be compiling the same kernel: it is waited for.
JIT_OPTIONS = {"cffi_extra_compile_args": ["-O1", "-g0"], "timeout": 60}
