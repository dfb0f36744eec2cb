"""Starts an action in a Python environment of its own, which the actions of one job share.

    bootstrap.py ACTION                             what every action.yml runs (through bootstrap.sh)
    bootstrap.py environment FOLDER LOCK [PROJECT]  what the Makefile runs: FOLDER gets the packages of
                                                    requirements/LOCK, and PROJECT as an editable package

The environment is a venv without pip in RUNNER_TEMP (outside GitHub: in the user's cache folder), so the job's own
Python, PATH and packages stay as they are. It is filled from outside, by uv or pip, and only with wheels whose hashes
stand in the lock; where there is no uv, and much to install, pip first brings one, for this once. It gets its name when
it is complete, so an interrupted or simultaneous installation leaves nothing half done.

The job's settings for pip and uv are ignored (a PIP_TARGET or a no-binary would break the installation), except those
that say where packages come from and how to get there: index, mirror, proxy, certificates, time-outs, cache. The hashes
make it irrelevant who serves a package.

Only the standard library is used, and a Python from 3.8 on reads this file far enough to say that it is too old.
"""

import ast
import contextlib
import ctypes
import fcntl
import hashlib
import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, NoReturn

# Which entry point and which lock each action uses: the one place that says so.
ACTIONS = {
    "build-image": ("build-image/main.py", "image.txt"),
    "import-data": ("import-data/main.py", "run.txt"),
    "comment": ("comment/main.py", "github.txt"),
    "introspect-csv": ("introspect-csv/main.py", "introspect.txt"),
    "calibrate-matrix": ("calibrate-matrix/main.py", "calibrate.txt"),
    "convergence": ("convergence/main.py", "run.txt"),
    "collect-data-sim": ("collect-data-sim/main.py", "run.txt"),
    "coverage-upload": ("coverage-upload/main.py", "coverage.txt"),
    "static-analysis": ("static-analysis/main.py", "analysis.txt"),
    "check-messages": ("check-messages/main.py", "run.txt"),
    "check": ("check/main.py", "run.txt"),
    "test-image": ("test-image/main.py", "calibrate.txt"),
    "bundle": ("bundle/main.py", "run.txt"),
    "deliver": ("deliver/main.py", "run.txt"),
    "run": ("run.py", "run.txt"),  # the root action.yml; no folder, because a folder here is a sub-action
}
# Likewise for the steps of the reusable workflow that are no actions.
WORKFLOW_STEPS = {
    "plan-matrix": ("workflow_step.py", "engine.txt"),
    "gather-results": ("workflow_step.py", "engine.txt"),
}
# What an interpreter of the user's own must be able to import. Without OpenCV some comparisons and all
# that collects are missing, without matplotlib a figure, without docker or boto3 what runs containers: each says so.
MODULES = {
    "introspect.txt": ["click", "yaml"],
    "engine.txt": ["click", "yaml", "numpy", "defusedxml", "rich"],
    "calibrate.txt": ["click", "yaml", "numpy", "defusedxml", "rich"],
    "coverage.txt": ["click", "yaml", "coverage", "defusedxml", "requests"],
    "analysis.txt": ["click", "yaml", "defusedxml", "lizard", "ruff", "yamllint"],
    "github.txt": ["click", "yaml", "requests"],
    "image.txt": ["click", "yaml", "rich", "docker"],
    "run.txt": ["click", "yaml", "numpy", "defusedxml", "rich"],
}

# A sixth of the packages is enough where calibration.yml only calibrates: none of these words is in it.
# One in a comment or a name costs seconds, no more.
NEEDS_ALL = re.compile(
    r"\b(image|software|simulation|backend|aws-batch|analysis|delivery|tests|requirements|xacro)\b", re.IGNORECASE
)
MAX_CONFIG_BYTES = 1 << 20
OF_CONTAINERS = ("IMAGE", "COMMAND", "BACKEND", "AWS_BATCH")

LOCKED = ["--require-hashes", "--only-binary", ":all:", "-r"]  # for uv and pip, before the lock's path
PIP_SETTINGS = [
    *("index-url", "extra-index-url", "find-links", "no-index", "trusted-host", "keyring-provider"),
    *("proxy", "cert", "client-cert", "timeout", "default-timeout", "retries", "cache-dir"),
]
# What uv calls them; with any other of them that says where packages come from, pip does it all.
UV_NAMES = {
    "PIP_INDEX_URL": "UV_DEFAULT_INDEX",
    "PIP_EXTRA_INDEX_URL": "UV_INDEX",
    "PIP_FIND_LINKS": "UV_FIND_LINKS",
    "PIP_TRUSTED_HOST": "UV_INSECURE_HOST",
    "PIP_PROXY": "ALL_PROXY",
    "PIP_CERT": "SSL_CERT_FILE",
}
PIP_ONLY = {"PIP_NO_INDEX", "PIP_KEYRING_PROVIDER", "PIP_CLIENT_CERT"}
UV_SETTINGS = re.compile(
    "UV_(DEFAULT_INDEX|INDEX|INDEX_URL|EXTRA_INDEX_URL|INDEX_.+_(USERNAME|PASSWORD)|FIND_LINKS|INSECURE_HOST|OFFLINE"
    "|KEYRING_PROVIDER|NATIVE_TLS|SYSTEM_CERTS|HTTP_.+|CACHE_DIR)"
)

ROOT = Path(__file__).resolve().parents[1]
BASE_PYTHON: str = getattr(sys, "_base_executable", sys.executable)  # not that of a venv
MARKER = "calibration-ci.txt"  # in a complete environment: the interpreter it is for, then its packages, a line each
BAD_INPUT, WORLD = 2, 3  # exit codes, as in calibration/base/errors.py
INSTALLER = ".installer-"  # folders in an environment, while it is made
MUCH = 8  # packages that pip installs no sooner than uv and them
PR_SET_PDEATHSIG = 1  # of Linux: the signal that a process gets when its parent ends
TIMEOUT = 900  # seconds for an installation: steps of a composite action cannot have `timeout-minutes`
POLL_SECONDS = 0.02  # between two looks at whether it has ended


def report(message: str, status: int) -> int:
    """Tell the user in one line, an annotation where the runner reads the log, and return the exit code."""
    for raw, escaped in (("%", "%25"), ("\r", "%0D"), ("\n", "%0A")):
        message = message.replace(raw, escaped)
    print(("::error::" if on_github() else "") + message, flush=True)
    return status


def on_github() -> bool:
    """Whether the runner of GitHub, or act, reads what is printed."""
    return os.environ.get("GITHUB_ACTIONS") == "true"


if sys.version_info < (3, 11):  # noqa: UP036  (said here, before what only a newer Python understands)
    found = "{}.{}".format(*sys.version_info[:2])
    sys.exit(
        report(
            f"Calibration CI needs Python 3.11 or newer; {sys.executable} is {found}. To have one beside it: "
            "python3 -m pip install uv && uv venv --python 3.11 .venv",
            WORLD,
        )
    )


class BootstrapError(Exception):
    """What ends this program: a line for the user and an exit code."""

    def __init__(self, message: str, status: int = WORLD) -> None:
        super().__init__(message, status)


def main(arguments: list[str]) -> None:
    """Start the action named by the arguments, or make the environment that they describe."""
    if os.name != "posix":
        raise BootstrapError("Calibration CI runs on Linux and macOS")
    if len(arguments) == 1 and arguments[0] in ACTIONS | WORKFLOW_STEPS:
        start(arguments[0])
    if len(arguments) not in (3, 4) or arguments[0] != "environment":
        raise BootstrapError("usage: bootstrap.py ACTION | environment FOLDER LOCK [PROJECT]", BAD_INPUT)
    _, folder, lock, *project = arguments
    environment(Path(folder).absolute(), ROOT / "requirements" / lock, [Path(path).absolute() for path in project])


def start(action: str) -> NoReturn:
    """Replace this process by the action's own, so that exit codes and signals pass straight through."""
    entry, lock = (ACTIONS | WORKFLOW_STEPS)[action]
    if action in ("run", "calibrate-matrix") and engine_is_enough(os.environ):
        lock = "engine.txt"
    python = sys.executable
    if not os.environ.get("INPUT_PYTHON"):
        python = str(shared_environment(ROOT / "requirements" / lock) / "bin" / "python")
    elif missing := [name for name in MODULES[lock] if importlib.util.find_spec(name) is None]:
        raise BootstrapError(
            f"input 'python': {python} cannot import {', '.join(missing)}: install into it what requirements/{lock} "
            "lists (not with --user), or leave the input empty",
            BAD_INPUT,
        )
    os.execv(python, [python, "-I", "-u", "-X", "utf8", str(ROOT / "actions" / entry), action])  # noqa: S606


def engine_is_enough(variables: Mapping[str, str]) -> bool:
    """Return whether what an action is asked for needs the engine alone."""
    if "CELL_IMAGE" in variables:  # a cell of the workflow, whose plan knows
        return not variables["CELL_IMAGE"]
    if any(variables.get(f"INPUT_{name}") for name in OF_CONTAINERS):
        return False
    return bool(variables.get("INPUT_DATASET")) or only_calibrates(
        Path(variables.get("INPUT_CONFIG") or "calibration.yml")
    )


def only_calibrates(config: Path) -> bool:
    """Return whether a configuration needs the engine alone; one that cannot be read does: the command says why."""
    try:
        with config.open("rb") as file:
            text = file.read(MAX_CONFIG_BYTES + 1)
    except OSError:
        return True
    return len(text) <= MAX_CONFIG_BYTES and not NEEDS_ALL.search(text.decode(errors="replace"))


def shared_environment(lock: Path) -> Path:
    """Return an environment with the packages of `lock`: one that this job has already, else a new one."""
    began = time.monotonic()
    home = environments_home()
    digest = hashlib.sha256(f"{interpreter()}\n{lock.read_text()}".encode()).hexdigest()[:12]
    target = home / f"{lock.stem}-{digest}"
    for candidate in [target, *sorted(home.glob("[!.]*"))]:  # the larger one of another action does as well
        if provides(candidate, pins(lock)):
            print(f"Python environment: {candidate.name} is there", flush=True)
            return candidate
    with group(f"Python environment: installing {lock.stem}"), scratch_folder(home) as scratch:
        built = scratch / target.name
        create(built, lock)
        try:
            built.rename(target)
        except OSError:  # there is one: either another process was first, or it is broken
            if not provides(target, pins(lock)):
                shutil.rmtree(target)
                built.rename(target)
    print(f"Python environment: {target.name} took {time.monotonic() - began:.1f} s", flush=True)
    return target


def environments_home() -> Path:
    """Return the folder of the shared environments, made if need be."""
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    home = Path(os.environ.get("RUNNER_TEMP") or cache).expanduser().absolute() / "calibration-ci"
    try:
        home.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BootstrapError(f"{home}: {error.strerror}; set RUNNER_TEMP to a folder that can be written") from error
    return home


def environment(folder: Path, lock: Path, project: list[Path]) -> None:
    """Bring `folder` (such as .venv) to the packages of `lock`, and `project` into it as an editable package."""
    python = folder / "bin" / "python"
    marked = (folder / MARKER).exists()
    if python.exists() and not marked and not folder.samefile(sys.prefix):
        # Made by hand, perhaps with another Python than this one: let its own do the work.
        os.execv(python, [str(python), "-I", __file__, *sys.argv[1:]])  # noqa: S606
    if provides(folder, pins(lock) | editables(project)):
        return
    with group(f"setting up {folder.name} with requirements/{lock.name} (once)"):
        if not python.exists() or (marked and not provides(folder, set())):  # its Python has gone, or is another now
            shutil.rmtree(folder, ignore_errors=True)
        create(folder, lock, project)


def create(folder: Path, lock: Path, project: list[Path] | None = None) -> None:
    """Make `folder` a venv if it is none, install `lock` and `project` into it, and mark it as complete."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, symlinks=True)
    (folder / MARKER).unlink(missing_ok=True)
    for left in folder.glob(f"{INSTALLER}*"):  # by one that was killed
        shutil.rmtree(left, ignore_errors=True)
    install(python, [*LOCKED, str(lock)], much=len(pins(lock)) >= MUCH)
    for path in project or []:
        install(python, ["--no-build-isolation", "--editable", str(path)])
    (folder / MARKER).write_text("\n".join([interpreter(), *sorted(pins(lock) | editables(project or []))]))


def interpreter() -> str:
    """Return what an environment depends on besides its packages: version, platform and place of this Python."""
    base = os.path.realpath(BASE_PYTHON)
    return f"{sys.version} {sysconfig.get_config_var('SOABI')} {base}".replace("\n", " ")


def pins(lock: Path) -> set[str]:
    """Return the requirements of a lock as `name==version ; marker`, without their hashes."""
    return {line.rstrip(" \\") for line in lock.read_text().splitlines() if re.match("[A-Za-z0-9]", line)}


def editables(project: list[Path]) -> set[str]:
    """Return the same for packages that are installed from a folder."""
    return {f"--editable {path}" for path in project}


def provides(folder: Path, packages: set[str]) -> bool:
    """Whether an environment is complete, for this interpreter, and has these packages (and perhaps more)."""
    try:
        made_for, *present = (folder / MARKER).read_text().splitlines()
    except (OSError, ValueError):
        return False
    return made_for == interpreter() and covers(present, packages) and (folder / "bin" / "python").exists()


def covers(present: Iterable[str], wanted: Iterable[str]) -> bool:
    """Whether the first requirements include the others; what is there under no condition is there under any."""
    present = set(present)
    return all(pin in present or pin.partition(" ;")[0] in present for pin in wanted)


def install(python: Path, arguments: list[str], *, much: bool = False) -> None:
    """Install into the environment of `python` with the first installer that succeeds.

    What the installers print is shown where the runner folds it, elsewhere only if all of them fail.
    """
    tried = []
    with tempfile.TemporaryFile() as printed:
        output = None if on_github() else printed
        for command, variables in installers(python, output, much=much):
            tried.append(Path(command[0]).name)
            if run([*command, "--no-deps", *arguments], variables, output):
                return
        printed.seek(0)
        print(printed.read().decode(errors="replace"), end="", flush=True)
    if not tried:
        raise BootstrapError(
            "neither uv nor pip is here to install Python packages; on Debian, Ubuntu: apt-get install python3-venv"
        )
    raise BootstrapError(
        f"the Python packages could not be installed with {' or '.join(tried)}, see the lines above; "
        "on a machine without network, name a Python that has them (input 'python')"
    )


def installers(python: Path, output: IO[bytes] | None, *, much: bool) -> Iterator[tuple[list[str], dict[str, str]]]:
    """Yield the commands that install into the environment of `python`, and the variables to run each with."""
    job = dict(os.environ)
    clean = {name: job[name] for name in job if not re.match("PIP_|UV_|PYTHON|VIRTUAL_ENV$|CONDA_", name)}
    for_uv = clean | {name: job[name] for name in job if UV_SETTINGS.fullmatch(name)}
    for_uv |= {"NO_COLOR": "1", "UV_NO_PROGRESS": "1"}  # act gives its steps a terminal
    uv = shutil.which("uv")
    if uv:
        yield [uv, "pip", "install", "--python", str(python)], for_uv

    def temporary_folder() -> tempfile.TemporaryDirectory[str]:
        return tempfile.TemporaryDirectory(prefix=INSTALLER, dir=python.parents[1])

    with contextlib.ExitStack() as stack:
        pip = [BASE_PYTHON, "-I", "-m", "pip"]
        listing = subprocess.run([*pip, "config", "list"], capture_output=True, text=True, timeout=60, check=False)
        if listing.returncode:  # this Python has no pip: borrow the one that it can put into a venv
            if importlib.util.find_spec("ensurepip") is None:
                return
            tool = stack.enter_context(temporary_folder())
            venv.create(tool, symlinks=True, with_pip=True)
            pip = [f"{tool}/bin/python", "-I", "-m", "pip"]
            listing = subprocess.run([*pip, "config", "list"], capture_output=True, text=True, timeout=60, check=False)
        settings = pip_settings(listing.stdout) | {"PIP_CONFIG_FILE": os.devnull, "PIP_NO_INPUT": "1"}
        options = ["--disable-pip-version-check", "--progress-bar", "off", "--no-warn-script-location"]
        if much and not uv and not settings.keys() & PIP_ONLY:
            folder = Path(stack.enter_context(temporary_folder()))
            venv.create(folder, symlinks=True)
            bring = [*pip, "--python", str(folder / "bin" / "python"), "install", *options, "--no-deps", *LOCKED]
            brought = run([*bring, str(ROOT / "requirements" / "uv.txt")], clean | settings, output)
            if brought and os.access(folder / "bin" / "uv", os.X_OK):
                same = {UV_NAMES[name]: settings[name] for name in UV_NAMES if name in settings}
                # As pip: any of the places will do, since the hashes say what is right.
                command = [str(folder / "bin" / "uv"), "pip", "install", "--index-strategy", "unsafe-best-match"]
                yield [*command, "--no-cache", "--python", str(python)], for_uv | same
        yield [*pip, "--python", str(python), "install", *options], clean | settings


def pip_settings(listing: str) -> dict[str, str]:
    """Return the settings to keep, as variables, from `pip config list` (lines such as `global.index-url='...'`)."""
    kept = {}
    for source in ("global.", "install.", ":env:."):  # the later wins, as it does for pip
        for key in PIP_SETTINGS:
            if found := re.search(rf"^{re.escape(source + key)}=(.*)$", listing, re.MULTILINE):
                kept["PIP_" + key.upper().replace("-", "_")] = str(ast.literal_eval(found[1]))
    return kept


def run(command: list[str], variables: dict[str, str], output: IO[bytes] | None) -> bool:
    """Run an installer; whether it succeeded. It ends with this process, with all that it has started.

    What it prints goes to `output`, or to where this process prints.
    """
    ending = {signal.SIGINT, signal.SIGTERM}
    libc = ctypes.CDLL(None)

    def begin() -> None:
        if sys.platform == "linux":
            libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ending)

    # Held back until we can answer them: one that arrived while the installer starts would leave it behind.
    signal.pthread_sigmask(signal.SIG_BLOCK, ending)
    # Not in the workspace: a uv.toml there has no say. One stream: the order of the lines stays.
    process = subprocess.Popen(
        command,
        env=variables,
        cwd="/",
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        preexec_fn=begin,
    )
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ending)
        deadline = time.monotonic() + TIMEOUT
        while process.poll() is None:
            # Not process.wait(): a handler that raises in it can leave its lock taken, and nothing ends it then.
            if time.monotonic() > deadline:
                line = f"stopped after {TIMEOUT} s\n"
                output.write(line.encode()) if output else print(line, end="", flush=True)
                return False
            time.sleep(POLL_SECONDS)
        return process.returncode == 0
    finally:
        if process.returncode is None:
            signal.pthread_sigmask(signal.SIG_BLOCK, ending)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            with contextlib.suppress(ChildProcessError):
                os.waitpid(process.pid, 0)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ending)


@contextlib.contextmanager
def group(title: str) -> Iterator[None]:
    """Fold what is printed meanwhile, where the runner reads the log."""
    print(f"::group::{title}" if on_github() else title, flush=True)
    try:
        yield
    finally:
        if on_github():
            print("::endgroup::", flush=True)


@contextlib.contextmanager
def scratch_folder(home: Path) -> Iterator[Path]:
    """Give a folder in `home`, on the same disk and with a name that no environment has; gone afterwards.

    The process that makes one keeps it locked. What one left that was killed has no lock any more, and is removed here.
    """
    with contextlib.ExitStack() as stack:
        with locked(home):
            for left in home.glob(".*"):
                with contextlib.suppress(OSError), locked(left, fcntl.LOCK_NB):
                    shutil.rmtree(left)
            scratch = tempfile.TemporaryDirectory(prefix=".", dir=home, ignore_cleanup_errors=True)
            folder = Path(stack.enter_context(scratch))
            stack.enter_context(locked(folder))
        yield folder


@contextlib.contextmanager
def locked(folder: Path, flags: int = 0) -> Iterator[None]:
    """Lock a folder against others that ask for it here."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | flags)
        yield
    finally:
        os.close(descriptor)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that what was begun is removed
    try:
        main(sys.argv[1:])
    except BootstrapError as problem:
        sys.exit(report(*problem.args))
    except (OSError, subprocess.SubprocessError) as error:  # a full disk, a Python that lacks parts
        sys.exit(report(f"the Python environment could not be made: {error}", WORLD))
    except KeyboardInterrupt:
        sys.exit(130)
