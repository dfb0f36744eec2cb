"""The script around the command of a container: for any POSIX shell, and without a tool that an image may lack.

It waits until its container may start, runs the command as a child, beats while it is there, looks whether the
container is ready where only that can be seen from inside, ends the command when told to, and says how it ended.
What it needs of an image is ``/bin/sh`` (dash, busybox, bash) and ``env``, ``sleep``, ``mkdir``; ``tee`` and
``mkfifo`` where a container is ready by a line of its log.
"""

import os
import shlex
import stat
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from calibration.errors import InfrastructureError, InputError
from calibration.execution.batch.wire import JOB_FOLDER
from calibration.execution.job import Container, Job

STOP, START, STATE = "stop", "start", "state"
BEAT, PID, READY_FILE, READY_COMMAND, LOG, PIPE, ENDED = (
    "beat",
    "pid",
    "ready.file",
    "ready.command",
    "log",
    "pipe",
    "ended",
)
_MOST_BYTES = 100
"""Of a sign."""


class Signs:
    """The folder, as our own containers see it. Those of the job may have put anything into what they can write."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def make(self, job: Job) -> None:
        """Make what the containers of a job write to.

        Raises:
            InfrastructureError: it cannot be made.
        """
        try:
            (self.folder / START).mkdir(parents=True, exist_ok=True)
            for container in job.containers:
                state = self.folder / STATE / container.name
                state.mkdir(parents=True, exist_ok=True)
                state.chmod(0o1777)  # its user is whatever the image says
        except OSError as error:
            raise InfrastructureError(f"{self.folder}: cannot be written: {error.strerror or error}") from error

    def start(self, name: str) -> None:
        """Let a container start.

        Raises:
            InfrastructureError: it cannot be written.
        """
        self._write(self.folder / START / name)

    def stop(self) -> None:
        """Ask all containers to end.

        Raises:
            InfrastructureError: it cannot be written.
        """
        self._write(self.folder / STOP)

    def has(self, name: str, sign: str) -> bool:
        """Whether a container has given a sign."""
        return os.path.lexists(self.folder / STATE / name / sign)

    def beat(self, name: str) -> int | None:
        """What changes for as long as a container is there; None before it is."""
        with suppress(OSError):
            return os.lstat(self.folder / STATE / name / BEAT).st_mtime_ns
        return None

    def ended(self, name: str) -> tuple[int, bool] | None:
        """The exit code of a container's command, and whether memory ran out; None where it has not ended."""
        descriptor = self.open(name, ENDED)
        if descriptor is None:
            return None
        with os.fdopen(descriptor, "rb") as file:
            words = file.read(_MOST_BYTES).split()
        if len(words) != 2 or not all(word.isdigit() for word in words):
            return None  # it is being written; or it is wrong for ever, and the container silent soon
        return int(words[0]) & 0xFF, int(words[1]) > 0

    def open(self, name: str, sign: str, access: int = os.O_RDONLY) -> int | None:
        """A descriptor of a regular file in the state of a container; None where there is none."""
        flags = access | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        try:
            descriptor = os.open(self.folder / STATE / name / sign, flags)
        except OSError:
            return None
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            return descriptor
        os.close(descriptor)
        return None

    def _write(self, path: Path) -> None:
        try:
            path.touch()
        except OSError as error:
            raise InfrastructureError(f"{path}: cannot be written: {error.strerror or error}") from error


GRACE = 5
"""Seconds between the polite and the impolite request to end."""
_NAPS = 2
"""Per second."""
_OUT_OF_MEMORY = ("/sys/fs/cgroup/memory.events", "/sys/fs/cgroup/memory/memory.oom_control")
"""Where the kernel counts processes that it killed, by either version of control groups."""

_BEGINNING = """\
#!/bin/sh
# What container {name} of the job runs.
trap : HUP INT TERM  # its command hears of the end by the file below, so that how it ended can be said
nap() {{ sleep 0.5 2>/dev/null || sleep 1; }}
run() {{
{run}
}}
(
  left={grace}
  while kill -0 $$ 2>/dev/null; do
    echo > {beat}
    if [ -e {stop} ] && [ -s {pid} ]; then
      read -r pid < {pid}
      case $left in {grace}) kill -TERM "$pid" ;; 0) kill -KILL "$pid" ;; esac
      left=$((left - 1))
    fi
    nap
  done
) >/dev/null 2>&1 &
until [ -e {start} ]; do
  [ -e {stop} ] && exit 0
  nap
done
"""
_HOSTS = """\
if ! {{ echo {line} >> /etc/hosts; }} 2>/dev/null; then
  echo {advice}
fi
"""
_READY_FILE = """\
(
  until [ -e {file} ]; do nap; done
  echo > {sign}
) >/dev/null 2>&1 &
"""
_READY_COMMAND = """\
(
  until ( {run} ) </dev/null; do nap; done
  echo > {sign}
) >/dev/null 2>&1 &
"""
_LOGGED = """\
mkfifo {pipe} || exit 126
tee -a {log} < {pipe} &
tee=$!
( run ) > {pipe} 2>&1
code=$?
left=4
while [ $left -gt 0 ] && kill -0 $tee 2>/dev/null; do left=$((left - 1)); nap; done
"""
_PLAIN = """\
( run )
code=$?
"""
_END = """\
lost=0
for file in {files}; do
  if [ -r "$file" ]; then
    while read -r key count; do [ "$key" = oom_kill ] && lost=$count; done < "$file"
  fi
done
echo "$code $lost" > {ended}
exit $code
"""


def script_of(container: Container, job: Job, folder: str = JOB_FOLDER) -> str:
    """The script of one container of a job.

    Args:
        container: has a command, in the place of the image's own.
        job: that it is part of.
        folder: that all containers see.

    Raises:
        InputError: it has no command.
    """
    command = (*(container.entrypoint or ()), *container.command)
    if not command:
        raise InputError(
            f"container '{container.name}': on AWS Batch a container needs a command; its image's is not known"
        )
    state = f"{folder}/{STATE}/{container.name}"
    sign = {name: shlex.quote(f"{state}/{name}") for name in (BEAT, PID, READY_FILE, READY_COMMAND, LOG, PIPE, ENDED)}
    readiness = container.readiness
    remember = f'echo "$$" > {sign[PID]}; exec "$@"'
    parts = [
        _BEGINNING.format(
            name=container.name,
            run="\n".join(
                f"  {line}" for line in _running(container, command, ["/bin/sh", "-c", remember, container.name])
            ),
            beat=sign[BEAT],
            pid=sign[PID],
            stop=shlex.quote(f"{folder}/{STOP}"),
            start=shlex.quote(f"{folder}/{START}/{container.name}"),
            grace=GRACE * _NAPS,
        ),
        *_hosts(job),
    ]
    if readiness is not None and readiness.file:
        parts.append(_READY_FILE.format(file=shlex.quote(readiness.file), sign=sign[READY_FILE]))
    if readiness is not None and readiness.command:
        look = "; ".join(_running(container, readiness.command))
        parts.append(_READY_COMMAND.format(run=look, sign=sign[READY_COMMAND]))
    if readiness is not None and readiness.log:
        parts.append(_LOGGED.format(pipe=sign[PIPE], log=sign[LOG]))
    else:
        parts.append(_PLAIN)
    parts.append(_END.format(files=" ".join(_OUT_OF_MEMORY), ended=sign[ENDED]))
    return "".join(parts)


def _running(container: Container, command: Sequence[str], before: Sequence[str] = ()) -> Iterator[str]:
    """Lines that make a subshell the command, where and with the variables that it is to have."""
    if container.working_directory is not None:
        folder = shlex.quote(container.working_directory)
        yield f"mkdir -p {folder} 2>/dev/null"  # as Docker does
        yield f"cd {folder} || exit 126"
    # by env, and last, since a shell takes and hands on not every name, and some are its own
    variables = [f"{name}={value}" for name, value in container.environment.items()]
    yield f"exec {shlex.join([*before, 'env', '--', *variables, *command])}"


def _hosts(job: Job) -> Iterator[str]:
    """The containers of a task have one address; their names are to lead to it, as on Docker's networks."""
    names = " ".join(container.name for container in job.containers)
    if len(job.containers) > 1:
        line = f"127.0.0.1 {names}"
        advice = f"calibration: this user may not add '{line}' to /etc/hosts: find other containers at 127.0.0.1"
        yield _HOSTS.format(line=shlex.quote(line), advice=shlex.quote(advice))
