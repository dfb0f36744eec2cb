"""The script in the shells of this machine; those of images are tested in the integration tests."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.aws_batch.inside.script import BEAT_FILE, READY_COMMAND, READY_FILE, Signs, script_of
from calibration.base import InputError
from calibration.ci.execution.job import Container, Job, Readiness
from tests.docker_engine import wait_until
from tests.properties import at_most

SHELLS = [
    pytest.param(command, id=command[0], marks=pytest.mark.skipif(shutil.which(command[0]) is None, reason="not here"))
    for command in (["dash"], ["bash", "--posix"])
]


@contextmanager
def running(folder: Path, shell: list[str], container: Container) -> Iterator[tuple[Signs, "subprocess.Popen[str]"]]:
    """Run the script of a job's only container; its command may start at once."""
    job = Job("j", (container,))
    signs = Signs(folder / "it's a folder")
    signs.make(job)
    path = signs.folder / "a.sh"
    path.write_text(script_of(container, job, str(signs.folder)))
    signs.start("a")
    process = subprocess.Popen(
        [*shell, str(path)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    try:
        yield signs, process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def sh(text: str, **changes: Any) -> Container:
    return Container("a", "", ("sh", "-c", text), **changes)


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.parametrize("code", [0, 3, 255])
def test_the_commands_exit_code_is_the_scripts(tmp_path: Path, shell: list[str], code: int) -> None:
    with running(tmp_path, shell, sh(f"echo out; exit {code}")) as (signs, process):
        assert process.communicate(timeout=60)[0] == "out\n"
        assert process.returncode == code
        assert signs.ended("a") == (code, False)


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.parametrize("ready", [None, Readiness(log="x")])
def test_a_stop_reaches_the_command(tmp_path: Path, shell: list[str], ready: Readiness | None) -> None:
    trapping = sh("trap 'echo bye; exit 9' TERM; echo up; while :; do sleep 0.1; done", readiness=ready)
    with running(tmp_path, shell, trapping) as (signs, process):
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        process.send_signal(signal.SIGTERM)  # as Batch does: the command must not receive it
        before = signs.beat("a")
        wait_until(lambda: signs.beat("a") != before, "it beats on")
        signs.stop()
        assert process.communicate(timeout=60)[0] == "bye\n"
        assert process.returncode == 9
        assert signs.ended("a") == (9, False)


@pytest.mark.parametrize("shell", SHELLS)
def test_it_beats_for_as_long_as_it_is_there(tmp_path: Path, shell: list[str]) -> None:
    with running(tmp_path, shell, sh("sleep 600")) as (signs, process):
        wait_until(lambda: signs.has("a", BEAT_FILE), "it beats")
        process.kill()
        process.wait()

        def still() -> bool:
            last = signs.beat("a")
            time.sleep(1.2)
            return signs.beat("a") == last

        wait_until(still, "it beats no more")
        assert signs.ended("a") is None


@pytest.mark.parametrize("shell", SHELLS)
def test_readiness_seen_from_inside(tmp_path: Path, shell: list[str]) -> None:
    file, other = tmp_path / "it is $(ready)", tmp_path / "other"
    readiness = Readiness(file=str(file), command=("sh", "-c", f'[ "$A" = "$(cat {other})" ]'))
    with running(tmp_path, shell, sh("sleep 600", environment={"A": "1 2"}, readiness=readiness)) as (signs, _):
        wait_until(lambda: signs.has("a", BEAT_FILE), "it runs")
        assert not signs.has("a", READY_FILE)
        file.touch()
        wait_until(lambda: signs.has("a", READY_FILE), "the file is there")
        assert not signs.has("a", READY_COMMAND)
        other.write_text("1 2")
        wait_until(lambda: signs.has("a", READY_COMMAND), "the command answers")


@pytest.mark.parametrize("shell", SHELLS)
def test_stopped_before_its_turn(tmp_path: Path, shell: list[str]) -> None:
    with running(tmp_path, shell, sh("echo ran")) as (signs, process):
        process.communicate(timeout=60)
        (signs.folder / "start" / "a").unlink()
        signs.stop()
        again = subprocess.run([*shell, signs.folder / "a.sh"], capture_output=True, timeout=60, check=True)
        assert (again.stdout, again.stderr) == (b"", b"")


def test_a_folder_that_is_not_there_is_made_as_docker_does(tmp_path: Path) -> None:
    with running(tmp_path, ["sh"], sh("pwd", working_directory=f"{tmp_path}/new/$x")) as (_, process):
        assert process.communicate(timeout=60)[0] == f"{tmp_path}/new/$x\n"
    (tmp_path / "file").touch()
    with running(tmp_path / "2", ["sh"], sh("pwd", working_directory=f"{tmp_path}/file")) as (signs, process):
        process.communicate(timeout=60)
        assert signs.ended("a") == (126, False)


def test_without_a_command_there_is_nothing_to_run() -> None:
    with pytest.raises(InputError, match="container 'a': on AWS Batch a container needs a command"):
        script_of(Container("a", ""), Job("j", ()))


TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)


@at_most(25)
@given(
    st.lists(TEXT, min_size=1, max_size=4),
    st.dictionaries(st.from_regex(r"[A-Z_]{3,8}", fullmatch=True), TEXT, max_size=2),
)
def test_nothing_is_left_to_a_shell(arguments: list[str], environment: dict[str, str]) -> None:
    """Execute the script's command line."""
    environment = {f"H_{name}": value for name, value in environment.items()}
    names = [f"${{{name}}}" for name in environment]
    show = 'for each; do printf "%s\\0" "$each"; done' + "".join(f'; printf "%s\\0" "{name}"' for name in names)
    container = Container("a", "", ("sh", "-c", show, "sh", *arguments), environment=environment)
    script = script_of(container, Job("j", (container,)), "/dev/null")
    body = script[script.index("run() {") : script.index("\n(\n  left=")]
    body = body.replace('echo "$$" > /dev/null/state/a/pid; ', "")
    found = subprocess.run(["dash"], input=f"{body}\nrun\n".encode(), capture_output=True, timeout=60, check=True)
    assert found.stdout.decode().split("\0")[:-1] == [*arguments, *environment.values()]
