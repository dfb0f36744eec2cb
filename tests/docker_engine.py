"""Fixtures of a real Docker Engine: a base image that no registry is needed for, and a registry of its own."""

import fcntl
import io
import os
import random
import shutil
import signal
import socket
import subprocess
import tarfile
import tempfile
import time
import urllib.request
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.conftest import NEEDS_ROOT

if TYPE_CHECKING:
    import psutil
    from docker import DockerClient

BASE = "debian:bookworm"
"""Made here where the engine has none: no image can be pulled where there is no registry."""
PYTHON_IMAGE = "calibration-test:python"
"""`BASE` with Python, and a user ``robot`` (1000) who is not root."""
PLAIN_IMAGE = "calibration-test:plain"
"""`PYTHON_IMAGE` with git, to run jobs in as root: nothing of GitHub's."""
_PYTHON = f"""FROM {BASE}
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends python3 && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home --uid 1000 robot
USER robot
"""
_PLAIN = f"""FROM {PYTHON_IMAGE}
USER root
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends git python3-venv && rm -rf /var/lib/apt/lists/*
CMD ["bash"]
"""


@pytest.fixture(scope="session")
def engine() -> "Iterator[DockerClient]":
    """A client of the machine's engine; skips where there is none."""
    docker = pytest.importorskip("docker", reason="needs the package docker")
    try:
        client = docker.from_env(timeout=60)
        client.ping()
    except docker.errors.DockerException as error:
        pytest.skip(f"needs a Docker Engine: {error}")
    yield client
    client.close()


@pytest.fixture(scope="session")
def base_image(engine: "DockerClient") -> str:
    """`BASE`: Debian with the machine's certificates."""
    with _one_at_a_time("base"):
        if not engine.images.list(BASE):
            _import_base()
    return BASE


@pytest.fixture(scope="session")
def python_image(engine: "DockerClient", base_image: str) -> str:
    """`PYTHON_IMAGE`."""
    return _made(engine, PYTHON_IMAGE, _PYTHON)


@pytest.fixture(scope="session")
def plain_image(engine: "DockerClient", python_image: str) -> str:
    """`PLAIN_IMAGE`."""
    return _made(engine, PLAIN_IMAGE, _PLAIN)


def _made(engine: "DockerClient", name: str, dockerfile: str) -> str:
    """The name of an image, which is made where the engine has none."""
    with _one_at_a_time(name.partition(":")[2]):
        if not engine.images.list(name):
            engine.images.build(fileobj=io.BytesIO(dockerfile.encode()), tag=name, forcerm=True)
    return name


@dataclass(frozen=True)
class OwnEngine:
    """An engine that a test may kill."""

    folder: Path
    """Of all that is its; a short path, since sockets have short names."""
    process: "subprocess.Popen[bytes]"

    @property
    def address(self) -> str:
        return f"unix://{self.folder}/sock"

    def api(self) -> "DockerClient":
        """Return a client of it, which the caller closes."""
        import docker

        return docker.DockerClient(self.address, timeout=60)

    @property
    def descendants(self) -> "list[psutil.Process]":
        """All that it started, also what outlives it: they name its folder in their command, or are below who does."""
        import psutil

        ours = []
        for process in psutil.process_iter():
            with suppress(psutil.Error):
                if str(self.folder) in " ".join(process.cmdline()) and process.pid != os.getpid():
                    ours += [process, *process.children(recursive=True)]
        return ours


@contextmanager
def started_engine(*options: str) -> Iterator[OwnEngine]:
    """Start an engine of its own, without a bridge; nothing of it is left. Skips where none can be started."""
    psutil = pytest.importorskip("psutil", reason="needs the package psutil")
    dockerd, unshare = shutil.which("dockerd"), shutil.which("unshare")
    if dockerd is None or unshare is None:
        pytest.skip("needs dockerd, and unshare (util-linux)")
    if os.geteuid() != 0:
        pytest.skip(f"{NEEDS_ROOT}, to start an engine")
    folder = Path(tempfile.mkdtemp(prefix="own-engine-"))
    places = {"data-root": "data", "exec-root": "exec", "pidfile": "pid"}
    # With a network of its own: an engine without a bridge removes docker0, that of the machine's own engine.
    command = [unshare, "--net", dockerd, "--bridge=none", "--iptables=false", f"--cgroup-parent=/{folder.name}"]
    command += [f"--host=unix://{folder}/sock", *(f"--{name}={folder}/{place}" for name, place in places.items())]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([*command, *options], stdout=log, stderr=log)
    engine = OwnEngine(folder, process)
    try:
        wait_until(lambda: (folder / "sock").exists() or process.poll() is not None, "the engine starts", 60)
        client = engine.api()
        wait_until(lambda: _pings(client), "the engine answers", 60)
        client.close()
        yield engine
    finally:
        for each in engine.descendants:
            with suppress(psutil.Error):
                each.send_signal(signal.SIGCONT)
                each.kill()
        process.wait(60)
        wait_until(lambda: not engine.descendants, "nothing of the engine runs")
        for line in reversed(Path("/proc/self/mounts").read_text().splitlines()):
            if str(folder) in line.split()[1]:
                subprocess.run(["umount", "--lazy", line.split()[1]], check=False)
        for cgroup in sorted(Path("/sys/fs/cgroup").glob(f"**/{folder.name}/**/"), reverse=True):
            with suppress(OSError):
                cgroup.rmdir()
        shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True)
class Registry:
    """A registry on this machine."""

    address: str
    """``127.0.0.1:PORT``, which the engine trusts without TLS."""
    user: str = ""
    password: str = ""


@pytest.fixture(scope="session")
def registry(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Registry]:
    """A registry that anyone may push to."""
    yield from _registry(tmp_path_factory.mktemp("registry"), "")


@pytest.fixture(scope="session")
def private_registry(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Registry]:
    """A registry with a user and a password."""
    bcrypt = pytest.importorskip("bcrypt", reason="needs the package bcrypt")
    folder = tmp_path_factory.mktemp("private-registry")
    password = "correct horse battery staple"  # noqa: S105
    hashed = bcrypt.hashpw(password.encode(), bcrypt.gensalt(4)).decode()
    (folder / "htpasswd").write_text(f"robot:{hashed}\n")
    auth = f"auth:\n  htpasswd: {{realm: test, path: {folder}/htpasswd}}\n"
    for started in _registry(folder, auth):
        yield Registry(started.address, "robot", password)


def _registry(folder: Path, auth: str) -> Generator[Registry]:
    program = shutil.which("docker-registry")
    if program is None:
        pytest.skip("needs docker-registry (apt-get install docker-registry)")
    port = free_port()
    (folder / "registry.yml").write_text(
        "version: 0.1\nlog: {level: error}\n"
        f"storage: {{filesystem: {{rootdirectory: {folder}/data}}, delete: {{enabled: true}}}}\n"
        f'http: {{addr: "127.0.0.1:{port}"}}\n{auth}'
    )
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([program, "serve", folder / "registry.yml"], stdout=log, stderr=log)
    try:
        wait_until(lambda: _answers(port), "the registry answers")
        yield Registry(f"127.0.0.1:{port}")
    finally:
        process.kill()  # which has nothing to finish
        process.wait(60)
        _forget(f"127.0.0.1:{port}/")


def _forget(prefix: str) -> None:
    """Remove the engine's images that were for a registry which is no more."""
    try:
        import docker

        client = docker.from_env(timeout=60)
    except (ImportError, docker.errors.DockerException):
        return
    for image in client.api.images():
        for tag in image.get("RepoTags") or ():
            if tag.startswith(prefix):
                with suppress(docker.errors.APIError):
                    client.api.remove_image(tag, force=True)
    client.close()


def only_sleep() -> bytes:
    """An image, to be imported, with sleep and its libraries from this machine: the smallest that runs."""
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


def wait_until(holds: Callable[[], bool], what: str, seconds: float = 60.0) -> None:
    """Wait until a condition holds; a failure after so many seconds."""
    deadline = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > deadline:
            pytest.fail(f"not within {seconds:g} s: {what}")
        time.sleep(0.05)


def _pings(client: "DockerClient") -> bool:
    import docker
    import requests

    try:
        return bool(client.ping())
    except (docker.errors.APIError, requests.RequestException):  # its socket is there before it listens
        return False


def _answers(port: int) -> bool:
    try:
        urllib.request.urlopen(f"http://127.0.0.1:{port}/v2/", timeout=10)
    except urllib.error.HTTPError:
        return True  # it wants a password
    except OSError:
        return False
    return True


def free_port() -> int:
    """Return a port for a server that cannot choose one; below those that the kernel gives to whoever asks for any."""
    while True:
        port = random.randrange(12_000, 30_000)
        with socket.socket() as found, suppress(OSError):
            found.bind(("127.0.0.1", port))
            return port


def _import_base() -> None:
    mmdebstrap = shutil.which("mmdebstrap")
    if mmdebstrap is None:
        pytest.skip(f"needs the image {BASE}, or mmdebstrap to make it (apt-get install mmdebstrap)")
    # A machine whose network re-signs TLS needs its own certificates in every container.
    certificates = os.environ.get("SSL_CERT_FILE", "/etc/ssl/certs/ca-certificates.crt")
    inside = "/etc/ssl/certs/ca-certificates.crt"
    with tempfile.TemporaryDirectory() as folder:
        left_out = [f"--dpkgopt=path-exclude=/usr/share/{what}/*" for what in ("doc", "man", "locale")]
        hook = [f"--customize-hook=upload {certificates} {inside}"] if Path(certificates).exists() else []
        options = ["--quiet", "--variant=minbase", "--include=ca-certificates", *left_out, *hook]
        subprocess.run(
            [mmdebstrap, *options, "bookworm", f"{folder}/base.tar"],
            check=True,
            timeout=240,
            env={**os.environ, "SOURCE_DATE_EPOCH": "1700000000"},
        )
        variables = f"ENV LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive PIP_CERT={inside}"
        subprocess.run(
            ["docker", "import", "-c", variables, "-c", 'CMD ["/bin/bash"]', f"{folder}/base.tar", BASE],
            check=True,
            stdout=subprocess.DEVNULL,
            timeout=120,
        )


@contextmanager
def _one_at_a_time(name: str) -> Iterator[None]:
    """Several processes run tests at once; only one makes an image."""
    with Path(tempfile.gettempdir(), f"calibration-test-{os.getuid()}-{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
