"""The exit code of a process whose libraries end it."""

import subprocess
import sys

import pytest

RUN = "from calibration.base.process import run_process; import atexit, ctypes, sys\n"


def ended(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", RUN + code], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("code", [0, 1, 2, 3, 130])
def test_a_command_ends_the_process_with_its_code(code: int) -> None:
    done = ended(f"atexit.register(print, 'handler')\nrun_process(lambda: print('said') or {code})")
    assert (done.returncode, done.stdout, done.stderr) == (code, "said\nhandler\n", "")


@pytest.mark.parametrize("code", [0, 1])
def test_a_library_that_calls_exit_is_an_infrastructure_failure(code: int) -> None:
    assert ended(f"run_process(lambda: ctypes.CDLL(None).exit({code}))").returncode == 3


def test_a_thread_is_waited_for() -> None:
    done = ended(
        "import threading, time\n"
        "run_process(lambda: threading.Thread(target=lambda: (time.sleep(0.2), print('done'))).start() or 0)"
    )
    assert (done.returncode, done.stdout) == (0, "done\n")


def test_no_workers_are_begun_without_room_for_their_threads() -> None:
    code = (
        "import resource\n"
        "from pathlib import Path\n"
        "from calibration.ci.execution.tasks import in_processes\n"
        "pages = int(Path('/proc/self/statm').read_text().split()[0])\n"
        "room = pages * resource.getpagesize() + (40 << 20)\n"
        "resource.setrlimit(resource.RLIMIT_AS, (room, room))\n"
        "try:\n    print(list(in_processes([str], 2)))\n"
        "except MemoryError:\n    print('no memory')\n"
    )
    assert ended(code).stdout == "no memory\n"


def test_a_worker_whose_parent_is_killed_while_it_is_forked_ends() -> None:
    code = (
        "import os, signal, time\n"
        "from calibration.ci.execution.tasks import in_processes\n"
        "def kill_parent():\n"
        "    parent = os.getppid()\n"
        "    os.kill(parent, signal.SIGKILL)\n"
        "    while os.getppid() == parent:\n        time.sleep(0.01)\n"
        "os.register_at_fork(after_in_child=kill_parent)\n"
        "list(in_processes([str], 1))\n"
    )
    assert ended(code).returncode == -9  # and no worker that keeps its stdout open
