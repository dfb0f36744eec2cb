"""A suite in miniature: the real bootstrap, with one tiny package to install and a command that says how it was run."""

import base64
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

PROJECT = Path(__file__).resolve().parents[2]
PYTHON = Path(getattr(sys, "_base_executable", sys.executable))

COMMAND = """
import json, os, signal, sys, time

def action_entry(name):
    import tiny
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(42))
    facts = {"action": name, "pid": os.getpid(), "prefix": sys.prefix, "isolated": sys.flags.isolated}
    print(json.dumps(facts | {"tiny": tiny.VERSION}), flush=True)
    time.sleep(float(os.environ.get("SLEEP", "0")))
    sys.exit(int(os.environ.get("STATUS", "0")))
"""


@dataclass
class Suite:
    """A folder like the repository's, its wheels, and an environment of a job to run it in."""

    folder: Path
    wheels: Path
    variables: dict[str, str]
    """With uv on PATH, where there is one: pip, the other way, takes several times as long."""
    uv: Path
    """The folder of uv, and of nothing else; empty where there is none."""

    @property
    def path_without_uv(self) -> str:
        return self.variables["PATH"].removeprefix(f"{self.uv}{os.pathsep}")

    @property
    def environments(self) -> list[Path]:
        """What there is in the folder of shared environments, hidden names included."""
        home = Path(self.variables["RUNNER_TEMP"]) / "calibration-ci"
        return sorted(home.iterdir()) if home.is_dir() else []

    def lock(self, name: str, program: str = "", **versions: str) -> None:
        """Write requirements/NAME with packages of these versions, made for the purpose, each with the same program."""
        lines = ["# a comment\n"]
        for package, version in versions.items():
            wheel = self._wheel(package, version, program)
            lines.append(
                f"{package}=={version} \\\n    --hash=sha256:{hashlib.sha256(wheel.read_bytes()).hexdigest()}\n"
            )
        (self.folder / "requirements" / name).write_text("".join(lines))

    def _wheel(self, package: str, version: str, program: str) -> Path:
        info = f"{package}-{version}.dist-info"
        files = {
            f"{package}.py": f"VERSION = {version!r}\n",
            f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n",
            f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        }
        if program:
            files[f"{package}-{version}.data/scripts/{package}"] = program
        record = ""
        for name, text in files.items():
            digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()
            record += f"{name},sha256={digest},{len(text)}\n"
        files[f"{info}/RECORD"] = f"{record}{info}/RECORD,,\n"
        wheel = self.wheels / f"{package}-{version}-py3-none-any.whl"
        with zipfile.ZipFile(wheel, "w") as archive:
            for name, text in files.items():
                entry = zipfile.ZipInfo(name)  # no time of day: the same bytes every time
                entry.external_attr = (0o100755 if "scripts/" in name else 0o100644) << 16
                archive.writestr(entry, text)
        return wheel

    def start(self, *arguments: str, cwd: Path | None = None, **variables: str) -> subprocess.Popen[str]:
        """Start bootstrap.sh as a step of a composite action does."""
        return subprocess.Popen(
            ["bash", str(self.folder / "actions" / "bootstrap.sh"), *arguments],
            env=self.variables | variables,
            cwd=cwd or self.folder.parent,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, *arguments: str, cwd: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
        """Start it and wait; the output is in `stdout`."""
        with self.start(*arguments, cwd=cwd, **variables) as process:
            try:
                output, _ = process.communicate(timeout=240)
            finally:
                process.kill()
        return subprocess.CompletedProcess(process.args, process.returncode, output)


@pytest.fixture(scope="session")
def bootstrap() -> ModuleType:
    """Return bootstrap.py as a module."""
    spec = importlib.util.spec_from_file_location("bootstrap", PROJECT / "actions" / "bootstrap.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def suite(tmp_path: Path) -> Suite:
    folder = tmp_path / "the suite"
    (folder / "actions").mkdir(parents=True)
    for name in ("bootstrap.sh", "bootstrap.py", "introspect-csv", "calibrate-matrix"):
        source = PROJECT / "actions" / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / "actions" / name)
    (folder / "calibration").mkdir()
    (folder / "calibration" / "__main__.py").write_text(COMMAND)
    (folder / "requirements").mkdir()
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    temp = tmp_path / "runner temp"
    temp.mkdir()
    uv = tmp_path / "uv"
    uv.mkdir()
    if found := shutil.which("uv", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"):
        (uv / "uv").symlink_to(found)
    suite = Suite(
        folder,
        wheels,
        {
            "PATH": os.pathsep.join(map(str, (uv, PYTHON.parent, "/usr/bin", "/bin"))),
            "HOME": str(tmp_path),
            "RUNNER_TEMP": str(temp),
            "GITHUB_ACTIONS": "true",
            # No network. That these settings count, and others do not, is what some tests are about.
            "PIP_NO_INDEX": "1",
            "PIP_FIND_LINKS": str(wheels),
            "UV_OFFLINE": "1",
            "UV_FIND_LINKS": str(wheels),
            "UV_CACHE_DIR": str(tmp_path / "uv-cache"),
        },
        uv,
    )
    suite.lock("introspect.txt", tiny="1.0")
    suite.lock("calibrate.txt", tiny="1.0", larger="2.0")
    return suite
