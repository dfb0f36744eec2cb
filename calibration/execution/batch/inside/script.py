"""The script around the command of a container: for any POSIX shell, and without a tool that an image may lack.

It waits until its container may start, runs the command as a child, beats while it is there, looks whether the
container is ready where only that can be seen from inside, ends the command when told to, and says how it ended.
What it needs of an image is ``/bin/sh`` (dash, busybox, bash) and ``env``, ``sleep``, ``mkdir``; ``tee`` and
``mkfifo`` where a container is ready by a line of its log.
"""

import shlex
from collections.abc import Iterator, Sequence

from calibration.errors import InputError
from calibration.execution.batch.inside.signs import (
    BEAT,
    ENDED,
    LOG,
    PID,
    PIPE,
    READY_COMMAND,
    READY_FILE,
    START,
    STATE,
    STOP,
)
from calibration.execution.batch.wire import JOB_FOLDER
from calibration.execution.job import Container, Job

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
