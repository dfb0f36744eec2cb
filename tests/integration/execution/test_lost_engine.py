"""An engine that dies, or falls silent, in mid-run: one line, exit code 3, soon."""

import io
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from calibration.execution.docker.labels import new_run
from calibration.execution.docker.leftovers import find_leftovers
from tests.conftest import NEEDS_ROOT
from tests.engine import wait_until

PROJECT = Path(__file__).resolve().parents[3]
psutil = pytest.importorskip("psutil")
IMAGE = "only-sleep:1"


@dataclass
class OwnEngine:
    """An engine that a test may kill."""

    folder: Path
    process: subprocess.Popen[bytes]

    @property
    def address(self) -> str:
        return f"unix://{self.folder}/sock"

    def api(self):  # type: ignore[no-untyped-def]
        import docker

        return docker.DockerClient(self.address, timeout=10)

    @property
    def descendants(self) -> list["psutil.Process"]:
        """All that it started, also what outlives it: they name its folder in their command, or are below who does."""
        ours = []
        for process in psutil.process_iter():
            with suppress(psutil.Error):
                if str(self.folder) in " ".join(process.cmdline()) and process.pid != os.getpid():
                    ours += [process, *process.children(recursive=True)]
        return ours


@pytest.fixture
def own_engine(monkeypatch: pytest.MonkeyPatch) -> Iterator[OwnEngine]:
    dockerd, unshare = shutil.which("dockerd"), shutil.which("unshare")
    if dockerd is None or unshare is None:
        pytest.skip("needs dockerd, and unshare (util-linux)")
    if os.geteuid() != 0:
        pytest.skip(f"{NEEDS_ROOT}, to start an engine")
    folder = Path(tempfile.mkdtemp(prefix="lost-engine-"))  # a short path: sockets have short names
    command = [
        unshare,
        "--net",  # an engine without a bridge removes docker0, which would be that of the machine's own engine
        dockerd,
        "--host",
        f"unix://{folder}/sock",
        "--data-root",
        folder / "data",
        "--exec-root",
        folder / "exec",
        "--pidfile",
        folder / "pid",
        "--bridge=none",
        "--iptables=false",
        "--storage-driver=vfs",
        f"--cgroup-parent=/{folder.name}",
    ]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
    engine = OwnEngine(folder, process)
    try:
        wait_until(lambda: (folder / "sock").exists() or process.poll() is not None, "the engine starts", 30)
        client = engine.api()
        wait_until(client.ping, "the engine answers", 30)
        client.api.import_image_from_data(_image(), *IMAGE.split(":"))
        client.close()
        monkeypatch.setenv("DOCKER_HOST", engine.address)
        yield engine
    finally:
        for each in engine.descendants:
            with suppress(psutil.Error):
                each.send_signal(signal.SIGCONT)
                each.kill()
        process.wait(20)
        _unmount(folder)
        for cgroup in sorted(Path("/sys/fs/cgroup").glob(f"**/{folder.name}/**/"), reverse=True):
            with suppress(OSError):
                cgroup.rmdir()
        shutil.rmtree(folder, ignore_errors=True)


def _unmount(folder: Path) -> None:
    for line in reversed(Path("/proc/self/mounts").read_text().splitlines()):
        if str(folder) in line.split()[1]:
            subprocess.run(["umount", "--lazy", line.split()[1]], check=False)


def _image() -> bytes:
    """An image with sleep and its libraries from this machine."""
    file = io.BytesIO()
    said = subprocess.run(["ldd", "/bin/sleep"], capture_output=True, text=True, check=True).stdout
    libraries = {word for word in said.split() if word.startswith("/")}
    with tarfile.open(fileobj=file, mode="w") as archive:
        folders = {parent for path in ("/bin/sleep", *libraries) for parent in Path(path).parents}
        for folder in sorted(folders):
            entry = tarfile.TarInfo(f".{folder}")
            entry.type, entry.mode = tarfile.DIRTYPE, 0o755
            archive.addfile(entry)
        for path in ("/bin/sleep", *sorted(libraries)):
            archive.add(Path(path).resolve(), f".{path}")
    return file.getvalue()


def start(folder: Path, run: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.integration.execution.program", "bare", run, str(folder), IMAGE]
    return subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def running(engine: OwnEngine, run: str) -> int:
    client = engine.api()
    try:
        return sum(each.state == "running" for each in find_leftovers(client.api, run))
    finally:
        client.close()


@pytest.mark.parametrize(("number", "within"), [(signal.SIGKILL, 10), (signal.SIGSTOP, 25)])
def test_lost_in_mid_run(own_engine: OwnEngine, tmp_path: Path, number: signal.Signals, within: float) -> None:
    """Killed, its connections break; stopped, it holds them and says nothing."""
    run = new_run()
    with start(tmp_path, run) as process:
        try:
            wait_until(lambda: running(own_engine, run) == 2, "both jobs run", 30)
            own_engine.process.send_signal(number)
            begin = time.monotonic()
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 3, out + err
    assert time.monotonic() - begin < within
    lines = [line for line in out.splitlines() if " | " not in line]
    assert sorted(line.split()[:2] for line in lines) == [["j0", "3"], ["j1", "3"]]
    for line in lines:
        assert f"the Docker Engine at {own_engine.address} does not answer any more" in line
        assert line.endswith(f"is removed by: calibration cleanup --run {run}")
    assert err == ""


def test_nothing_is_left_when_it_is_back(own_engine: OwnEngine, tmp_path: Path) -> None:
    """What a lost engine still had is what `calibration cleanup` finds: its labels are on it."""
    run = new_run()
    with start(tmp_path, run) as process:
        wait_until(lambda: running(own_engine, run) == 2, "both jobs run", 30)
        process.kill()
    done = subprocess.run(
        [sys.executable, "-m", "calibration", "cleanup"], cwd=PROJECT, capture_output=True, text=True, check=True
    )
    assert "2 containers, 2 volumes removed" in done.stdout
    client = own_engine.api()
    assert find_leftovers(client.api) == []
    client.close()
