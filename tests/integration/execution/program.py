"""A program that runs jobs, for tests that stop or kill it.

``python -m tests.integration.execution.program KIND RUN FOLDER [ARGUMENT]`` has the exit codes of `calibration`
and prints a line for each outcome: ``job exit_code reason``.
"""

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.base import CalibrationError
from calibration.base.process import Terminated, terminate_cleanly
from calibration.ci.execution.docker import backend
from calibration.ci.execution.docker.container_run import ContainerRun
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job, Readiness
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay
from tests.docker_engine import PYTHON_IMAGE

if TYPE_CHECKING:
    from docker import APIClient


def shell(text: str, name: str = "a", image: str = PYTHON_IMAGE, **settings: object) -> Container:
    return Container(name, image, ("sh", "-c", text), **settings)  # type: ignore[arg-type]


def jobs(kind: str, argument: str) -> list[Job]:
    if kind == "pulling":
        return [Job("j", (shell("true", image=f"{argument}/hangs:1"),))]
    if kind == "waiting":
        never = shell("echo up; sleep 600", "sim", essential=False, readiness=Readiness(file="/never", seconds=600))
        return [Job("j", (never, shell("true", after=("sim",))))]
    if kind in ("running", "creating"):
        helper = shell("sleep 600", "sim", essential=False)
        return [Job(f"j{i}", (helper, shell("echo up; sleep 600"))) for i in range(3)]
    if kind == "copying":
        text = f"head -c 800000000 /dev/zero > {OUTPUT}/zeros; echo up"
        return [Job("j", (shell(text, artifacts=(Artifact(f"{OUTPUT}/*"),)),))]
    if kind == "short":
        return [Job(f"j{i}", (shell("echo up"), shell("sleep 600", "b", essential=False))) for i in range(20)]
    if kind == "bare":  # a separate engine, with an image that contains only sleep
        backend._POLL_SECONDS, backend._SECONDS_WITHOUT_ANSWER = 1, 2
        return [Job(f"j{i}", (Container("a", argument, ("/bin/sleep", "600")),), network="none") for i in range(2)]
    raise AssertionError(kind)


def start_what_is_gone(run: ContainerRun, api: "APIClient", *arguments: Any) -> None:
    """Start a container that was removed after its creation; waits for the removal."""
    while api.containers(all=True, filters={"id": run.id}):
        time.sleep(0.05)
    plain_start(run, api, *arguments)


plain_start = ContainerRun.start


def main() -> int:
    kind, run, folder, argument = (*sys.argv[1:], "")[:4]
    if kind == "creating":
        ContainerRun.start = start_what_is_gone  # type: ignore[method-assign]
    try:
        with terminate_cleanly(), backend.DockerBackend(run=run, show=LogDisplay(Runner())) as docker:
            code = 0
            for _, outcome in docker.run(jobs(kind, argument), Path(folder), workers=2):
                print(outcome.job, int(outcome.exit_code), *outcome.reasons, flush=True)
                code = max(code, int(outcome.exit_code))
            return code
    except CalibrationError as error:
        print(f"error: {error}", file=sys.stderr)
        return int(error.exit_code)
    except Terminated:
        return 143
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
