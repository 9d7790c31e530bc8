"""Program of the child process that compiles the kernels of a certificate (`hpcinv.kernels_ahead`).

It reads the job, its mesh and the forecast of its solvers from standard input, as the run has pickled them.
"""

import pickle
import signal
import sys


def main() -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # removes temporary files
    import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

    # isort: split
    from hpcinv.cli.rehearsal import rehearse_certificate

    rehearse_certificate(*pickle.load(sys.stdin.buffer))


if __name__ == "__main__":
    main()
