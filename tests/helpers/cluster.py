"""A real Slurm for tests: one node on the loopback interface, with everything it writes in one temporary directory."""

from __future__ import annotations

import getpass
import os
import random
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

DAEMONS = ("munged", "slurmctld", "slurmd")
PROGRAMS = (*DAEMONS, "sbatch", "srun", "scancel", "scontrol", "squeue", "sinfo", "setpriv")
SBIN = "/usr/sbin:/sbin"  # where the daemons are, and where not every user's path leads
# Slurm has CPUs to give away that the machine need not have.
CPUS = 4

CONFIGURATION = """
ClusterName=test
SlurmctldHost=localhost(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={node}
SlurmUser={user}
SlurmdUser={user}
# Nothing listens to other machines.
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
AuthType=auth/munge
# A job that was requeued begins again when its old credential has expired; 5 s are the least that Slurm takes.
AuthInfo=socket={place}/munge.socket,cred_expire=5
StateSaveLocation={place}/state
SlurmdSpoolDir={place}/spool
SlurmctldPidFile={place}/slurmctld.pid
SlurmdPidFile={place}/slurmd.pid
# Neither cgroups nor accounting, and Slurm identifies processes by their parents.
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
SwitchType=switch/none
PropagateResourceLimits=NONE
# Jobs have the niceness of their sbatch.
PropagatePrioProcess=1
SlurmdParameters=config_overrides
MailProg=/bin/true
ReturnToService=2
SchedulerParameters=sched_interval=1,bf_interval=1,batch_sched_delay=0
KillWait=30
# MPICH names shared memory by the job, and a job that was killed leaves it behind: no id may come back.
FirstJobId={first}
MinJobAge=3600
# Jobs of the partition "urgent" put others back into the queue, which get their own signal first and then a minute.
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
SlurmctldParameters=preempt_send_user_signal
NodeName=localhost NodeAddr=127.0.0.1 NodeHostname=localhost CPUs={cpus} State=UNKNOWN
PartitionName=test Nodes=ALL Default=YES MaxTime=INFINITE DefaultTime=10 PriorityTier=1 GraceTime=60
PartitionName=urgent Nodes=ALL MaxTime=INFINITE DefaultTime=10 PriorityTier=2
"""


class Unavailable(Exception):
    """Why no Slurm can run here."""


@contextmanager
def cluster() -> Iterator[dict[str, str]]:
    """Bring the cluster up and, whatever happens, down again; gives what a user has in the environment.

    The daemons are children of this process and end with it, even if it is killed.

    Raises:
        Unavailable: Slurm is not installed, or cannot run here.
    """
    path = f"{os.environ['PATH']}:{SBIN}"
    if missing := [program for program in PROGRAMS if shutil.which(program, path=path) is None]:
        raise Unavailable(f"not installed: {', '.join(missing)}")
    if os.geteuid() != 0:
        raise Unavailable("slurmd has to be started by root")
    # munged wants everyone to be let through to its socket, which pytest's directories do not.
    place = Path(tempfile.mkdtemp(prefix="slurm-"))
    place.chmod(0o755)
    environment = {"PATH": path, "SLURM_CONF": str(place / "slurm.conf")}
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        _configure(place)
        for command in _commands(place):
            daemons.append(_start(command, place, environment))
            if command[0] == "munged":
                _wait(lambda: (place / "munge.socket").exists(), daemons, place, "munged opens its socket")
        _wait(lambda: _tool(environment, "sinfo", "-h", "-o", "%T") == "idle", daemons, place, "the node is idle")
        yield environment
    finally:
        _end(daemons, environment)
        shutil.rmtree(place, ignore_errors=True)


def _configure(place: Path) -> None:
    (place / "state").mkdir()
    (place / "spool").mkdir()
    key = place / "munge.key"
    key.touch(0o600)
    key.write_bytes(os.urandom(128))
    controller, node = _free_ports()
    first = random.randrange(1000, 10_000_000)
    text = CONFIGURATION.format(
        place=place, controller=controller, node=node, user=getpass.getuser(), cpus=CPUS, first=first
    )
    (place / "slurm.conf").write_text(text.lstrip())


def _free_ports() -> list[int]:
    """Two ports on which nothing listens, outside the range from which the system gives ports away by itself."""
    ports: list[int] = []
    while len(ports) < 2:
        port = random.randrange(20000, 30000)
        with socket.socket() as probe:
            if port not in ports and probe.connect_ex(("127.0.0.1", port)) != 0:
                ports.append(port)
    return ports


def _commands(place: Path) -> Iterator[list[str]]:
    files = {"socket": "socket", "key-file": "key", "pid-file": "pid", "seed-file": "seed", "log-file": "log"}
    munge = [f"--{option}={place}/munge.{suffix}" for option, suffix in files.items()]
    yield ["munged", "--foreground", "--num-threads=2", *munge]
    yield ["slurmctld", "-D", "-c", "-f", f"{place}/slurm.conf"]
    yield ["slurmd", "-D", "-c", "-N", "localhost", "-f", f"{place}/slurm.conf"]


def _start(command: list[str], place: Path, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    with (place / f"{command[0]}.log").open("ab") as log:
        return subprocess.Popen(
            ["setpriv", "--pdeathsig", "TERM", *command],
            env=os.environ | environment,
            cwd=place,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )


def _wait(is_so: Callable[[], bool], daemons: list[subprocess.Popen[bytes]], place: Path, what: str) -> None:
    deadline = time.monotonic() + 30
    while not is_so():
        ended = next((name for name, d in zip(DAEMONS, daemons, strict=False) if d.poll() is not None), None)
        if ended or time.monotonic() > deadline:
            name = ended or DAEMONS[len(daemons) - 1]
            log = (place / f"{name}.log").read_text(errors="replace").strip().splitlines()[-3:]
            raise Unavailable(f"{name + ' ended' if ended else 'in vain'} before {what}: {' | '.join(log)}")
        time.sleep(0.1)


def _tool(environment: dict[str, str], *command: str) -> str:
    """What one of Slurm's tools says; nothing if it fails."""
    try:
        done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, timeout=10)
    except subprocess.TimeoutExpired:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _end(daemons: list[subprocess.Popen[bytes]], environment: dict[str, str]) -> None:
    """End the jobs, then the daemons, the last first, and at last what may be left of the jobs."""
    if len(daemons) == len(DAEMONS) and all(daemon.poll() is None for daemon in daemons):
        _tool(environment, "scancel", "--user", getpass.getuser())
        deadline = time.monotonic() + 15
        while time.monotonic() < deadline and (_tool(environment, "squeue", "-h") or _job_processes(environment)):
            time.sleep(0.1)
    for daemon in reversed(daemons):
        daemon.terminate()
        try:
            daemon.wait(10)
        except subprocess.TimeoutExpired:
            daemon.kill()
            daemon.wait()
    for process in _job_processes(environment):
        os.kill(process, signal.SIGKILL)


def _job_processes(environment: dict[str, str]) -> list[int]:
    """Processes of this cluster's jobs: Slurm's own for each step, and what they started."""
    mark = f"SLURM_CONF={environment['SLURM_CONF']}".encode()
    processes = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            variables = path.read_bytes().split(b"\0")
            name = (path.parent / "comm").read_text().strip()
        except OSError:  # it has ended meanwhile
            continue
        job = any(variable.startswith(b"SLURM_JOB_ID=") for variable in variables)
        if mark in variables and (job or name == "slurmstepd"):
            processes.append(int(path.parent.name))
    return processes
