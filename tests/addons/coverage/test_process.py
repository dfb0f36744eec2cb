import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from calibration.addons.coverage.tests import run
from calibration.base import InfrastructureError, InputError
from tests.docker_engine import wait_until
from tests.processes import runs

STUBBORN = """
import os, signal, subprocess, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(300)"])
print("started", os.getpid(), child.pid, flush=True)
time.sleep(300)
"""


def execute(code: str, folder: Path, seconds: float = 30.0) -> tuple[int, bytes]:
    output = bytearray()
    return run([sys.executable, "-c", code], folder, dict(os.environ), seconds, output.extend), bytes(output)


def gone(pids: list[int]) -> bool:
    """Return whether processes end soon."""
    wait_until(lambda: not any(map(runs, pids)), "they are gone")
    return True


def test_output_and_errors_come_in_order(tmp_path: Path) -> None:
    code = "import sys, os; print(os.getcwd(), flush=True); print('bad', file=sys.stderr, flush=True); sys.exit(3)"
    assert execute(code, tmp_path) == (3, f"{tmp_path}\nbad\n".encode())


def test_a_signal_is_a_code_below_zero(tmp_path: Path) -> None:
    assert execute("import os; os.kill(os.getpid(), 9)", tmp_path)[0] == -signal.SIGKILL


def test_nothing_is_read_from_us(tmp_path: Path) -> None:
    assert execute("import sys; print(repr(sys.stdin.read()))", tmp_path) == (0, b"''\n")


def test_much_output(tmp_path: Path) -> None:
    code, output = execute("import sys; sys.stdout.write('x' * 5_000_000)", tmp_path)
    assert (code, len(output)) == (0, 5_000_000)


def test_it_may_close_its_output_and_go_on(tmp_path: Path) -> None:
    code = "import os, time; os.close(1); os.close(2); time.sleep(0.5); os._exit(4)"
    assert execute(code, tmp_path) == (4, b"")


def test_what_it_leaves_behind_is_ended(tmp_path: Path) -> None:
    """Though that holds the output open."""
    code = "import subprocess; print(subprocess.Popen(['sleep', '60']).pid, flush=True)"
    status, output = execute(code, tmp_path)
    assert status == 0
    assert gone([int(output)])


def test_it_may_not_take_longer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.base.process.STOP_SECONDS", 0.2)  # it ignores SIGTERM
    output = bytearray()
    with pytest.raises(InfrastructureError, match=r"the tests took longer than 1.5 s \(timeout\) and were stopped"):
        run([sys.executable, "-c", STUBBORN], tmp_path, dict(os.environ), 1.5, output.extend)
    assert gone([int(pid) for pid in output.split()[1:]])


@pytest.mark.parametrize("arguments", [["/no/such/program"], ["a\0b"]])
def test_what_cannot_be_started(tmp_path: Path, arguments: list[str]) -> None:
    with pytest.raises(InputError, match="cannot be started"):
        run(arguments, tmp_path, {}, 5, bytearray().extend)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler  # signals are heard again


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_to_us_ends_it_too(tmp_path: Path, number: signal.Signals) -> None:
    program = f"""
import os, sys
from pathlib import Path
from typing import Any
from calibration.base import process
from calibration.addons.coverage import tests as process
from calibration.base.process import terminate_cleanly
process.GRACE = 0.2
try:
    with terminate_cleanly():
        process.run([sys.executable, "-c", {STUBBORN!r}], Path(), dict(os.environ), 60, lambda data: os.write(1, data))
except KeyboardInterrupt as error:
    sys.exit(type(error).__name__)
"""
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        pids = [int(pid) for pid in child.stdout.readline().split()[1:]]
        child.send_signal(number)
        said = {signal.SIGINT: "KeyboardInterrupt", signal.SIGTERM: "Terminated"}.get(number, "")
        assert child.stderr.read().strip() == said
    assert child.returncode == (1 if said else -signal.SIGKILL)
    assert gone(pids)


def test_a_signal_that_arrives_while_it_starts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = subprocess.Popen
    pids = []

    def start_slowly(*arguments: Any, **settings: Any) -> "subprocess.Popen[bytes]":
        started = start(*arguments, **settings)
        pids.append(started.pid)
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)
        return started

    monkeypatch.setattr("calibration.base.process.subprocess.Popen", start_slowly)
    with pytest.raises(KeyboardInterrupt):
        execute("import time; time.sleep(60)", tmp_path)
    assert gone(pids)


def test_outside_of_the_main_thread(tmp_path: Path) -> None:
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(execute("print(1)", tmp_path)[0]))
    thread.start()
    thread.join()
    assert codes == [0]
