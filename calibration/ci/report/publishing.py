"""Publishing a report: files, log, annotations, summary and outputs of the step."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import accumulate, takewhile
from pathlib import Path

from calibration.base.errors import InfrastructureError
from calibration.base.files import follow_no_links
from calibration.base.text import one_line
from calibration.ci.report.report import SUMMARY_FILE, Report
from calibration.ci.report.results_json import RESULTS_FILE
from calibration.ci.workflow.runner import Runner
from calibration.ci.workflow.step import add_summary, annotate, set_outputs, stop_commands
from calibration.ci.workflow.step_files import OutputValue

MAX_OUTPUT_CHARACTERS = 100_000
"""Limit of an output that is a list or a mapping: as an environment variable of a later step it may have 128 KiB."""
_FILE_OF_OUTPUT = {"results": RESULTS_FILE, "summary": SUMMARY_FILE}
"""Outputs that are paths of files, empty if no files are written."""


def publish(report: Report, runner: Runner, folder: Path | None = None) -> None:
    """Write the files of a report into a folder if one is given, then show the report on the runner.

    The verdict is the last line of the log. Raises :class:`InfrastructureError` if something cannot be written.
    """
    if folder is not None:
        report.write(folder)
    show(report, runner, folder)


def show(report: Report, runner: Runner, folder: Path | None = None) -> None:
    """Show a report whose files are already written, as :func:`publish` does."""
    outputs, notes = _bound_outputs(report.outputs)
    report = replace(report, notes=(*report.notes, *notes))
    if text := report.log():
        with stop_commands(runner):  # names and cells are untrusted text
            runner.log(f"{text}\n")
    annotate(runner, report.all_annotations())
    add_summary(runner, report.markdown())
    paths = {name: "" if folder is None else folder / file for name, file in _FILE_OF_OUTPUT.items()}
    set_outputs(runner, {"verdict": report.verdict, **paths, **outputs})
    place = "" if folder is None else f" ({folder / RESULTS_FILE})"
    runner.log(one_line(f"{report.line}{place}"))


def _bound_outputs(outputs: Mapping[str, OutputValue | None]) -> tuple[dict[str, OutputValue], list[str]]:
    """Truncate outputs that are lists or mappings to the limit; return them, and a note for each truncated one."""
    bounded: dict[str, OutputValue] = {name: "" if value is None else value for name, value in outputs.items()}
    notes = []
    for name, value in bounded.items():
        if not isinstance(value, list | tuple | dict):
            continue
        entries = list(value.items()) if isinstance(value, dict) else list(value)
        sizes = accumulate(len(json.dumps(entry)) + 2 for entry in entries)
        fit = sum(1 for _ in takewhile(lambda size: size < MAX_OUTPUT_CHARACTERS, sizes))
        if fit < len(entries):
            bounded[name] = dict(entries[:fit]) if isinstance(value, dict) else entries[:fit]
            notes.append(f"output {name}: has the first {fit} of {len(entries)} entries; all are in {RESULTS_FILE}")
    return bounded, notes


def remove_results(folder: Path, names: Iterable[str]) -> None:
    """Remove files of an earlier run from a folder, so that they are not mistaken for current results.

    From then on nothing is written through links in the folder.

    Raises :class:`InfrastructureError` if one cannot be removed.
    """
    follow_no_links(folder)
    for name in names:
        try:
            (folder / name).unlink(missing_ok=True)
        except NotADirectoryError as error:
            raise InfrastructureError(
                f"{folder}: the results cannot be written: it, or a folder above it, is a file"
            ) from error
        except OSError as error:
            raise InfrastructureError(
                f"{folder / name}: an earlier result cannot be removed: {error.strerror}"
            ) from error
