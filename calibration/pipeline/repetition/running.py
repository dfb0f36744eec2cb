"""The loop of repeated runs: each in a folder of its own, kept whatever happens to the next."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from calibration.base.errors import CalibrationError, ExitCode
from calibration.base.flake_rate import MAX_REPETITIONS
from calibration.base.text import one_line
from calibration.ci.execution.workspace import locked
from calibration.ci.report import FILES, Outcome, remove_results
from calibration.ci.report.badge import BADGE_FILE
from calibration.ci.report.report import Report
from calibration.ci.report.results_json import BRIEF_FILE
from calibration.ci.workflow import Runner
from calibration.pipeline.repetition.repetition import Repetition
from calibration.pipeline.repetition.report import report
from calibration.pipeline.repetition.results import THE_RUN, RepeatedResults, repeated_results
from calibration.pipeline.repetition.settings import Repetitions
from calibration.pipeline.results import PAGE_FILE, reason_of_end

RUN_PREFIX = "run-"
"""Prefix of the folder of a run; its number follows."""
REPORT_FILES = (*FILES, BRIEF_FILE, PAGE_FILE, BADGE_FILE)


def repeated(
    settings: Repetitions,
    output: Path,
    runner: Runner,
    title: str,
    once: Callable[[Path], Repetition],
    undecided_passes: bool = False,
) -> tuple[RepeatedResults, Report]:
    """Run work as often as it is asked for, compare the runs, and report; the report is not shown yet.

    A run that ends with an error of exit code 1 has failed, and the next one follows. Any other error, and a signal,
    ends all: what the runs before have come to is reported, and the error is raised again.

    Args:
        settings: how often, and what may differ.
        output: folder of the report, and of a folder for each run.
        runner: its log.
        title: of the report.
        once: runs the work once, into a folder.
        undecided_passes: whether an undecided spread counts as passed.

    Raises:
        CalibrationError: a run could not be made, or the report cannot be written.
    """
    runs: list[Repetition] = []

    def written() -> tuple[RepeatedResults, Report]:
        results = repeated_results(settings, runs, output, undecided_passes)
        found = report(results, runs, output, title)
        found.write(output)
        return results, found

    with locked(output):
        remove_results(output, REPORT_FILES)
        for number in range(settings.repeat + 1, MAX_REPETITIONS + 1):  # of more runs into this folder
            if (folder := output / f"{RUN_PREFIX}{number}").exists():
                remove_results(folder, REPORT_FILES)
        for number in range(1, settings.repeat + 1):
            folder, begin = output / f"{RUN_PREFIX}{number}", time.perf_counter()
            try:
                run = once(folder)
            except BaseException as error:  # signals too: the runs before are kept
                run = _cut_short(folder, error, time.perf_counter() - begin)
                if not isinstance(error, CalibrationError) or error.exit_code != ExitCode.FAIL:
                    runner.log(one_line(f"run {number} of {settings.repeat} was cut short: {run.sentence}"))
                    if runs:
                        runs.append(run)
                        with suppress(CalibrationError):  # such as that the disk is full, which is the error
                            written()
                    raise
            runs.append(_with_verdict(replace(run, whole_seconds=time.perf_counter() - begin)))
            runner.log(one_line(f"run {number} of {settings.repeat}: {run.verdict}: {run.sentence}"))
        return written()


def run_of_repetition(run: str | None, folder: Path) -> str | None:
    """Return the name of a repetition in a cloud, where each has its own; None for a new one."""
    return None if run is None else f"{run}-{folder.name}"


def _cut_short(folder: Path, error: BaseException, seconds: float) -> Repetition:
    why = reason_of_end(error)
    code = error.exit_code if isinstance(error, CalibrationError) and error.exit_code > ExitCode.FAIL else None
    return Repetition(folder=folder, sentence=why, whole_seconds=seconds, cut_short=why, error=code)


def _with_verdict(run: Repetition) -> Repetition:
    """Return a run with its own failure as an outcome, if none of its outcomes has failed and its verdict is fail."""
    if run.verdict != "fail" or any(each.verdict == "fail" for each in run.outcomes):
        return run
    return replace(run, outcomes=(*run.outcomes, Outcome(name=THE_RUN, reasons=(run.sentence,))))
