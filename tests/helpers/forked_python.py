"""A stand-in for Python that runs ``-m hpcinv …`` in a fork of a server that has imported the stack (`helpers.forks`).

A copy of this file is in the directory of the server's socket; all other programs are left to Python itself. The
stand-in passes on its arguments, environment, working directory, open files, signals and processors, and ends as the
fork does.
"""

import marshal
import os
import signal
import socket
import struct
import sys

FORWARDED = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGHUP)


def main() -> None:
    """Run the arguments, and end this process as they end."""
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, FORWARDED)
    if sys.argv[1:3] != ["-m", "hpcinv"]:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
    # The manager of mpirun is asked by an open file, whose number it has put into the environment.
    files = [0, 1, 2] + [int(os.environ[name]) for name in ("PMI_FD",) if name in os.environ]
    ignored = [number for number in FORWARDED if signal.getsignal(number) == signal.SIG_IGN]
    request = marshal.dumps(
        {
            "arguments": [os.fsencode(word) for word in sys.argv[2:]],
            "environment": dict(os.environb),
            "files": files,
            "ignored": [int(number) for number in ignored],
            "blocked": [int(number) for number in blocked],
            "processors": list(os.sched_getaffinity(0)),
        }
    )
    place = os.open(".", os.O_PATH)  # it may have been removed
    server = socket.socket(socket.AF_UNIX)
    os.chdir(os.path.dirname(__file__))  # noqa: PTH120  (the path of a socket is limited to 100 characters)
    server.connect("socket")
    socket.send_fds(server, [struct.pack("q", len(request))], [place, *files])
    server.sendall(request)
    for number in {*FORWARDED}.difference(ignored):
        signal.signal(number, lambda number, _: server.send(bytes([number])))
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    status = server.recv(4)
    if len(status) < 4:
        sys.exit("the server of forks has ended")
    (code,) = struct.unpack("i", status)
    if code < 0:
        if -code not in (signal.SIGKILL, signal.SIGSTOP):
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ == "__main__":
    main()
