"""The files and the end of one run of tests, as outcomes of its tests."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from calibration.addons.image_tests.settings import COVERAGE_FOLDER, ImageTests
from calibration.base.errors import ExitCode, InputError
from calibration.base.files import read_bytes
from calibration.base.text import one_line, shorten
from calibration.ci.execution.outcome import ARTIFACTS_FOLDER, End, JobOutcome
from calibration.ci.report.xunit_reading import CaseOutcome, Tally, read_test_report

MAX_REPORT_BYTES = 100 * 1024 * 1024
MAX_CASES = 200_000
"""Limit of the tests of one run."""
MAX_LOG_LINES, MAX_LOG_TAIL_BYTES = 20, 64 * 1024
"""Limits of what is kept of the container's last output."""
RUN_CASE = "(the run)"
"""Case that stands for the run itself: it fails if its process crashes or hangs, or if a report is missing or bad."""
_ENDS_CUT_SHORT = (End.TIMED_OUT, End.SIGNALLED, End.OUT_OF_MEMORY)
"""Ends of a container after which tests may not have run, whatever the reports say."""
_BYTES_OF_ROOT = 4096
_ROOTS_OF_REPORTS = (b"<testsuite", b"<Site")


@dataclass(frozen=True)
class JudgedRun:
    """One run of the tests of an entry."""

    cases: tuple[CaseOutcome, ...]
    """Outcomes of its tests; the last one is that of the run itself (`RUN_CASE`)."""
    seconds: float
    folder: Path
    """Folder of its job."""
    coverage: tuple[Path, ...] = ()
    """Files of coverage."""
    log: Path | None = None
    last_lines: tuple[str, ...] = ()
    """The container's last output, if the run itself has failed."""
    error: ExitCode | None = None
    """Exit code of a run that could not be made."""

    @property
    def tally(self) -> Tally:
        """Numbers of its tests, without the run itself."""
        return Tally.of(self.cases[:-1])

    @property
    def passes(self) -> bool:
        """Whether every test passed, and the run itself."""
        return all(case.state != "failed" for case in self.cases)


def judge_run(tests: ImageTests, outcome: JobOutcome) -> JudgedRun:
    """Read the reports of a run, and judge its end."""
    files = outcome.folder / ARTIFACTS_FOLDER
    cases: list[CaseOutcome] = []
    problems: list[str] = []
    for name in sorted(file.path for file in outcome.artifacts if _is_report(files / file.path)):
        try:
            cases += read_test_report(read_bytes(files / name, MAX_REPORT_BYTES, "a report of tests"), name)
        except InputError as error:
            problems.append(str(error).replace(f"{files}/", ""))
        if len(cases) > MAX_CASES:
            problems.append(f"{name}: found more than {MAX_CASES} tests, the limit of a run")
            break
    container = next((each for each in outcome.containers if each.log is not None), None)
    log = container.log if container else None
    timed_out = any(each.end == End.TIMED_OUT for each in outcome.containers)
    cut_short = any(each.end in _ENDS_CUT_SHORT for each in outcome.containers)
    tally = Tally.of(cases)
    if cut_short or (outcome.exit_code != ExitCode.PASS and not tally.failed):
        problems = [*outcome.reasons, *problems]  # of failed tests it is only the consequence
    elif not tally.ran and not tests.allow_no_tests:
        skipped = f" ({tally.skipped} were skipped)" if tally.skipped else ""
        problems.insert(0, f"no test ran{skipped}: found no report with tests, expected JUnit or CTest XML")
    message = shorten(one_line("; ".join(problems)), 500)
    itself = CaseOutcome(RUN_CASE, message, state="failed" if problems else "passed", seconds=outcome.seconds)
    not_made = outcome.exit_code in (ExitCode.BAD_INPUT, ExitCode.INFRASTRUCTURE) and not timed_out
    return JudgedRun(
        (*map(_bounded, cases[:MAX_CASES]), itself),
        round(outcome.seconds, 3),
        outcome.folder,
        tuple(_coverage_files(tests, outcome)),
        log,
        _last_lines(log) if problems and log else (),
        outcome.exit_code if not_made else None,
    )


def _is_report(path: Path) -> bool:
    """Return whether a file is a report of tests, or an XML file that is to be one: not one of coverage."""
    try:
        with path.open("rb") as file:
            start = file.read(_BYTES_OF_ROOT)
    except OSError:
        return False
    if any(root in start for root in _ROOTS_OF_REPORTS):
        return True
    return path.suffix == ".xml" and b"<coverage" not in start


def _coverage_files(tests: ImageTests, outcome: JobOutcome) -> Iterator[Path]:
    for file in outcome.artifacts:
        path = outcome.folder / ARTIFACTS_FOLDER / file.path
        if file.path.startswith(f"{COVERAGE_FOLDER}/") or (tests.coverage_files and not _is_report(path)):
            yield path


def _last_lines(log: Path) -> tuple[str, ...]:
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - MAX_LOG_TAIL_BYTES))
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return ()
    return tuple(one_line(line) for line in lines if line.strip())[-MAX_LOG_LINES:]


def _bounded(case: CaseOutcome) -> CaseOutcome:
    return case if case.name != RUN_CASE else replace(case, name=f"{RUN_CASE} in a report")
