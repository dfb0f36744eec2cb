"""Publishing a report: files, log, annotations, the step's summary and its outputs."""

from collections.abc import Iterable
from pathlib import Path

from calibration.errors import WorldError
from calibration.report.report import RESULTS_FILE, SUMMARY_FILE, Report
from calibration.workflow.annotations import annotate
from calibration.workflow.groups import stop_commands
from calibration.workflow.outputs import set_outputs
from calibration.workflow.runner import Runner
from calibration.workflow.summary import add_summary
from calibration.workflow.text import one_line

_PATHS = {"results": RESULTS_FILE, "summary": SUMMARY_FILE}
"""Outputs that are paths of files, empty where none are written."""


def publish(report: Report, runner: Runner, folder: Path | None = None) -> None:
    """Write the files of a report into a folder if one is given, then show the report on the runner.

    The verdict is the last line of the log. Raises :class:`WorldError` when something cannot be written.
    """
    if folder is not None:
        report.write(folder)
    show(report, runner, folder)


def show(report: Report, runner: Runner, folder: Path | None = None) -> None:
    """Show a report whose files are written already, as :func:`publish` does."""
    if text := report.log():
        with stop_commands(runner):  # names and cells are text of others
            runner.log(f"{text}\n")
    annotate(runner, report.all_annotations())
    add_summary(runner, report.markdown())
    paths = {name: "" if folder is None else folder / file for name, file in _PATHS.items()}
    set_outputs(runner, {"verdict": report.verdict, **paths, **report.outputs})
    place = "" if folder is None else f" ({folder / RESULTS_FILE})"
    runner.log(one_line(f"{report.line}{place}"))


def remove_results(folder: Path, names: Iterable[str]) -> None:
    """Remove files that an earlier run left in a folder, so that none is mistaken for this one's.

    Raises :class:`WorldError` when one cannot be removed.
    """
    for name in names:
        try:
            (folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise WorldError(f"{folder / name}: an earlier result cannot be removed: {error.strerror}") from error
