"""Generation of the script around the command of a container, for any POSIX shell and minimal images.

It waits until its container may start, runs the command as a child, updates a heartbeat file, checks the
readiness if only the container itself can check it, ends the command on request, and records its exit code.
It requires ``/bin/sh`` (dash, busybox, bash) and ``env``, ``sleep``, ``mkdir``; ``tee`` and
``mkfifo`` if the readiness is a line of the log.
"""

import os
import shlex
import stat
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from calibration.addons.aws_batch.wire import JOB_FOLDER
from calibration.base import InputError, writing
from calibration.ci.execution.job import Container, Job

STOP_SIGN, START_SIGN, STATE_FOLDER = "stop", "start", "state"
BEAT_FILE, PID_FILE, READY_FILE, READY_COMMAND, LOG_FILE, PIPE_FILE, ENDED_FILE = (
    "beat",
    "pid",
    "ready.file",
    "ready.command",
    "log",
    "pipe",
    "ended",
)
_MAX_SIGN_BYTES = 100
"""Size limit of a sign."""


class Signs:
    """Folder of signals between our containers and the job's, whose content is untrusted."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def make(self, job: Job) -> None:
        """Create the folders for the containers of a job.

        Raises:
            InfrastructureError: a folder cannot be created.
        """
        with writing(self.folder):
            (self.folder / START_SIGN).mkdir(parents=True, exist_ok=True)
            for container in job.containers:
                state = self.folder / STATE_FOLDER / container.name
                state.mkdir(parents=True, exist_ok=True)
                state.chmod(0o1777)  # the image defines the user

    def start(self, name: str) -> None:
        """Permit a container to start.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        self._write_sign(self.folder / START_SIGN / name)

    def stop(self) -> None:
        """Request all containers to end.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        self._write_sign(self.folder / STOP_SIGN)

    def has(self, name: str, sign: str) -> bool:
        """Return whether a container has given a sign."""
        return os.path.lexists(self.folder / STATE_FOLDER / name / sign)

    def beat(self, name: str) -> int | None:
        """Return the time of the last heartbeat of a container; None before it has started."""
        with suppress(OSError):
            return os.lstat(self.folder / STATE_FOLDER / name / BEAT_FILE).st_mtime_ns
        return None

    def ended(self, name: str) -> tuple[int, bool] | None:
        """Return exit code and whether memory ran out; None if the command has not ended."""
        descriptor = self.open(name, ENDED_FILE)
        if descriptor is None:
            return None
        with os.fdopen(descriptor, "rb") as file:
            words = file.read(_MAX_SIGN_BYTES).split()
        if len(words) != 2 or not all(word.isdigit() for word in words):
            return None  # incomplete, or invalid: then the heartbeat stops too
        return int(words[0]) & 0xFF, int(words[1]) > 0

    def open(self, name: str, sign: str, access: int = os.O_RDONLY) -> int | None:
        """Open a regular file in the state of a container; None if it does not exist."""
        flags = access | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        try:
            descriptor = os.open(self.folder / STATE_FOLDER / name / sign, flags)
        except OSError:
            return None
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            return descriptor
        os.close(descriptor)
        return None

    def _write_sign(self, path: Path) -> None:
        with writing(path):
            path.touch()


GRACE_SECONDS = 5
"""Seconds between SIGTERM and SIGKILL."""
_POLLS_PER_SECOND = 2
"""Number of polls per second."""
_OUT_OF_MEMORY = ("/sys/fs/cgroup/memory.events", "/sys/fs/cgroup/memory/memory.oom_control")
"""Counters of processes killed by the kernel, in both versions of control groups."""

_SCRIPT_BEGINNING = """\
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
_SCRIPT_OF_HOSTS = """\
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
_SCRIPT_WITH_LOG = """\
mkfifo {pipe} || exit 126
tee -a {log} < {pipe} &
tee=$!
( run ) > {pipe} 2>&1
code=$?
left=4
while [ $left -gt 0 ] && kill -0 $tee 2>/dev/null; do left=$((left - 1)); nap; done
"""
_SCRIPT_WITHOUT_LOG = """\
( run )
code=$?
"""
_SCRIPT_END = """\
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
    """Return the script of a container.

    Args:
        container: container with a command; that of its image is not known.
        job: its job.
        folder: folder that all containers see.

    Raises:
        InputError: it has no command.
    """
    command = (*(container.entrypoint or ()), *container.command)
    if not command:
        raise InputError(
            f"container '{container.name}': on AWS Batch a container needs a command; that of its image is not known"
        )
    state = f"{folder}/{STATE_FOLDER}/{container.name}"
    sign = {
        name: shlex.quote(f"{state}/{name}")
        for name in (BEAT_FILE, PID_FILE, READY_FILE, READY_COMMAND, LOG_FILE, PIPE_FILE, ENDED_FILE)
    }
    readiness = container.readiness
    remember = f'echo "$$" > {sign[PID_FILE]}; exec "$@"'
    parts = [
        _SCRIPT_BEGINNING.format(
            name=container.name,
            run="\n".join(
                f"  {line}" for line in _run_lines(container, command, ["/bin/sh", "-c", remember, container.name])
            ),
            beat=sign[BEAT_FILE],
            pid=sign[PID_FILE],
            stop=shlex.quote(f"{folder}/{STOP_SIGN}"),
            start=shlex.quote(f"{folder}/{START_SIGN}/{container.name}"),
            grace=GRACE_SECONDS * _POLLS_PER_SECOND,
        ),
        *_hosts_lines(job),
    ]
    if readiness is not None and readiness.file:
        parts.append(_READY_FILE.format(file=shlex.quote(readiness.file), sign=sign[READY_FILE]))
    if readiness is not None and readiness.command:
        look = "; ".join(_run_lines(container, readiness.command))
        parts.append(_READY_COMMAND.format(run=look, sign=sign[READY_COMMAND]))
    if readiness is not None and readiness.log:
        parts.append(_SCRIPT_WITH_LOG.format(pipe=sign[PIPE_FILE], log=sign[LOG_FILE]))
    else:
        parts.append(_SCRIPT_WITHOUT_LOG)
    parts.append(_SCRIPT_END.format(files=" ".join(_OUT_OF_MEMORY), ended=sign[ENDED_FILE]))
    return "".join(parts)


def _run_lines(container: Container, command: Sequence[str], before: Sequence[str] = ()) -> Iterator[str]:
    """Yield shell lines that replace a subshell by the command, with its working directory and variables."""
    if container.working_directory is not None:
        folder = shlex.quote(container.working_directory)
        yield f"mkdir -p {folder} 2>/dev/null"  # as in Docker
        yield f"cd {folder} || exit 126"
    # by env, as the last step, because shells drop variables with unusual names, and set some of their own
    variables = [f"{name}={value}" for name, value in container.environment.items()]
    yield f"exec {shlex.join([*before, 'env', '--', *variables, *command])}"


def _hosts_lines(job: Job) -> Iterator[str]:
    """Yield lines that resolve names of containers, which share one address, as on Docker's networks."""
    names = " ".join(container.name for container in job.containers)
    if len(job.containers) > 1:
        line = f"127.0.0.1 {names}"
        advice = f"calibration: this user may not add '{line}' to /etc/hosts: find other containers at 127.0.0.1"
        yield _SCRIPT_OF_HOSTS.format(line=shlex.quote(line), advice=shlex.quote(advice))
