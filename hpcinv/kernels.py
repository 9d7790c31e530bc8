"""How DOLFINx compiles the kernels of forms and expressions."""

from __future__ import annotations

# -g0 halves the compile time against the interpreter's own -g; -ffast-math would break small-strain accuracy.
# Another run may be compiling the same kernel: it is waited for, a minute at most.
JIT_OPTIONS = {"cffi_extra_compile_args": ["-O2", "-g0"], "timeout": 60}
