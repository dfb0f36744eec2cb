"""What all tests share: the rule for skipped tests in CI, and the data that is not part of the repository."""

import gc
import os
import re
import signal
import tempfile
from collections import Counter
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.properties import register_profiles
from tests.thorough import unmark_first_cases

# As the commands do, before anything imports numpy: the tests' processes are the parallelism.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

# Environments and checkouts that come and go: ext4 takes its time for a file where others have just been removed.
MEMORY, ENOUGH = Path("/dev/shm"), 8 << 30  # noqa: S108
if "TMPDIR" not in os.environ and MEMORY.is_dir():
    _memory = os.statvfs(MEMORY)
    if _memory.f_bavail * _memory.f_frsize > ENOUGH and not _memory.f_flag & os.ST_NOEXEC:
        os.environ["TMPDIR"], tempfile.tempdir = str(MEMORY), None

# A shell has what it starts in the background ignore it, which all that is started from there inherits: tests send it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Whoever makes a Coverage object, as coverage-upload does, tells the one that measures these tests to save nothing.
with suppress(ImportError, AttributeError):
    import coverage

    del coverage.process_startup.coverage  # type: ignore[attr-defined]

register_profiles()

pytest_plugins = [
    "tests.docker_engine",
    "tests.small",
    *(f"tests.addons.{file.parent.name}.{file.stem}" for file in Path(__file__).parent.glob("addons/*/fixtures.py")),
]

PROJECT = Path(__file__).resolve().parents[1]
NO_SHARED_DATA = "needs ../shared/data beside the project"
NEEDS_ROOT = "needs root"

WAITING = {"e2e", "integration", "recorder"}
"""Folders of tests that mostly wait, for an engine or a browser."""
BEGUN = 0.8
"""Share of the other tests, of each worker, among which these are spread: the longest begins in time."""

# Set by .ci/run, which installs what the tests need: a skipped test is a hole there, so it fails.
# Only what cannot be installed may be missing: the data, and the rights of root.
STRICT = os.environ.get("CALIBRATION_CI_STRICT") == "1"


NEEDED = re.compile(r"needs (?:an? |the (?:image |package )?)?([^:(,]+)")
HOW_TO_HAVE = {
    "docker engine": "apt-get install docker.io, and start dockerd",
    "dockerd": "apt-get install docker.io",
    "docker-registry": "apt-get install docker-registry",
    "chromium": "apt-get install chromium",
    "git": "apt-get install git",
    "openssl": "apt-get install openssl",
    "mmdebstrap": "apt-get install mmdebstrap",
}
"""How to have what tests need; .ci/run does it for all."""


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real and synthetic datasets beside the project; skip where it is not."""
    folder = PROJECT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(NO_SHARED_DATA)
    return folder


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect the tests without looking for garbage: they stay, and are not looked through later either."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Decide which cases are thorough, and order the tests."""
    unmark_first_cases(items)
    spread_waiting_tests(items)


def spread_waiting_tests(items: list[pytest.Item]) -> None:
    """Spread the files of tests that wait evenly over the workers, so that the cores always have something else to do.

    A worker begins with a part of the list; those with little left take from the ends of the others.
    """
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    waiting: list[pytest.Item] = []
    others: list[pytest.Item] = []
    for item in items:
        (others if WAITING.isdisjoint(item.path.relative_to(PROJECT).parts) else waiting).append(item)
    files = list(dict.fromkeys(item.path for item in waiting))
    each_file = {file: [item for item in waiting if item.path == file] for file in files}
    ordered: list[pytest.Item] = []
    for worker in range(workers):
        own = others[len(others) * worker // workers : len(others) * (worker + 1) // workers]
        places = files[worker::workers]
        begun = 0
        for number, file in enumerate(places):
            until = round(BEGUN * len(own) * number / len(places))
            ordered += own[begun:until] + each_file[file]
            begun = until
        ordered += own[begun:]
    items[:] = ordered


def fail_if_skipped(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Turn the report of a skip into that of a failure, in CI."""
    if not STRICT or not report.skipped or hasattr(report, "wasxfail"):
        return
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    if NO_SHARED_DATA not in reason and not (NEEDS_ROOT in reason and os.geteuid() != 0):
        report.outcome = "failed"
        report.longrepr = f"{reason} (a skip is a failure where CALIBRATION_CI_STRICT=1)"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    fail_if_skipped(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    fail_if_skipped(report)
    return report


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Generator[None]:
    """Say what was skipped for which tool, and how to have it, below the list of skipped tests."""
    yield
    skipped = [
        each.longrepr[2] for each in terminalreporter.stats.get("skipped", ()) if isinstance(each.longrepr, tuple)
    ]
    needed = Counter(match[1].strip() for reason in skipped if (match := NEEDED.search(reason)))
    for tool, count in needed.most_common():
        how = HOW_TO_HAVE.get(tool.lower())
        terminalreporter.write_line(f"{count} skipped: needs {tool}{f' ({how})' if how else ''}")
