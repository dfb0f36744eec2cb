"""Report of a command: its verdict, results, outputs, annotations and text, and its publishing."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, takewhile
from pathlib import Path
from typing import Any

from calibration.base import ExitCode, InfrastructureError, escape_markdown, follow_no_links, one_line, write_atomically
from calibration.base.verdict import Verdict
from calibration.ci.report.blocks import MOST_LINES, Block, Lines, Table, cut
from calibration.ci.report.junit import Outcome, junit_xml
from calibration.ci.report.results_json import (
    BRIEF_FILE,
    RESULTS_FILE,
    Brief,
    BriefTable,
    results_document,
    results_text,
)
from calibration.ci.workflow.runner import (
    Annotation,
    Level,
    OutputValue,
    Runner,
    add_summary,
    annotate,
    set_outputs,
    stop_commands,
)

SUMMARY_FILE, JUNIT_FILE = "summary.md", "junit.xml"
FILES = (RESULTS_FILE, SUMMARY_FILE, JUNIT_FILE)
"""Files of every report."""
ROWS_IN_BRIEF, LINES_IN_BRIEF = 50, 10
"""Limits of the rows of a table, and of the lines of a block, in the brief report."""


@dataclass(frozen=True, kw_only=True)
class Report:
    """Results of a command, complete and independent of where they are written."""

    title: str
    """Heading of the summary, and title of annotations, in the user's words: ``Static analysis``."""
    verdict: Verdict
    sentence: str
    """Text after the verdict in the last line: ``2 violations in 4 checks of 1 table``."""
    results: Any
    """Content of results.json beside schema, verdict and reasons: a record, or a mapping."""
    suites: Mapping[str, Sequence[Outcome]] = field(default_factory=dict)
    """Outcomes for JUnit, by suite."""
    outputs: Mapping[str, OutputValue | None] = field(default_factory=dict)
    """Outputs of the step, beside the verdict and the paths of the files; None becomes an empty text."""
    reasons: tuple[str, ...] = ()
    """Reasons of a failure, one line each, worst first: listed first, and annotated as errors."""
    undecided: tuple[str, ...] = ()
    """Undecided limits, one line each: listed after the reasons, and annotated as warnings."""
    about: str = ""
    """What the results are of, in one line below the verdict: the commit and its date."""
    judges: bool = True
    """Whether the verdict says something, so that it is shown."""
    error: ExitCode | None = None
    """Exit code if it differs from that of the verdict: 0 for pass, else 1."""
    warnings: tuple[str, ...] = ()
    """Annotated as warnings."""
    notes: tuple[str, ...] = ()
    """Annotated as notices."""
    places: Mapping[str, tuple[Path, int]] = field(default_factory=dict)
    """File and line to which a reason refers, by the reason."""
    annotations: tuple[Annotation, ...] = ()
    """Further annotations, with a file and line or a title of their own."""
    blocks: tuple[Block, ...] = ()
    """Tables and lists, in order."""
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    """Content of further files by name, such as tables as CSV and figures."""

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of the command."""
        if self.error is not None:
            return self.error
        return ExitCode.PASS if self.verdict == "pass" else ExitCode.FAIL

    @property
    def all_reasons(self) -> tuple[str, ...]:
        """Why the verdict is not pass, worst first."""
        return (*self.reasons, *self.undecided)

    @property
    def document(self) -> dict[str, Any]:
        """Content of results.json."""
        return results_document(self.verdict, self.results, self.all_reasons)

    @property
    def brief(self) -> Brief | None:
        """Content of a comment on a pull request; None if the report has nothing for comments."""
        brief = [block for block in self.blocks if block.brief]
        if not brief:
            return None
        tables = [block for block in brief if isinstance(block, Table)]
        return Brief(
            verdict=self.verdict,
            sentence=self.sentence,
            about=self.about,
            reasons=cut(self.all_reasons, MOST_LINES, RESULTS_FILE),
            tables=tuple(BriefTable(table.columns, table.rows[:ROWS_IN_BRIEF]) for table in tables if table.rows),
            lines=tuple(line for block in brief if isinstance(block, Lines) for line in block.lines[:LINES_IN_BRIEF]),
        )

    @property
    def line(self) -> str:
        """The verdict, if there is one to tell, in one line."""
        return f"{self.verdict}: {self.sentence}" if self.judges else self.sentence

    def log(self) -> str:
        """Return the text of the log above the verdict."""
        return "\n\n".join(
            f"{one_line(block.title)}\n{text}" if block.title else text
            for block in self.blocks
            if block.only in (None, "log") and (text := block.plain())
        )

    def markdown(self) -> str:
        """Return the summary: the verdict, its reasons, then the blocks."""
        parts = [f"## {escape_markdown(self.title)}: {escape_markdown(self.line)}\n"]
        if self.about:
            parts.append(f"{escape_markdown(self.about)}\n")
        if self.all_reasons:
            parts.append(Lines(self.all_reasons).markdown())
        for block in self.blocks:
            if block.only in ("log", "comment") or not (text := block.markdown()):
                continue
            title = escape_markdown(block.title)
            if block.folded:
                text = f"<details><summary>{title}</summary>\n\n{text}\n</details>\n"
            elif title:
                text = f"### {title}\n\n{text}"
            parts.append(text)
        return "\n".join(parts)

    def all_annotations(self) -> list[Annotation]:
        """Return all annotations, failures first."""
        warnings = (*self.undecided, *self.warnings)
        listed = ((self.reasons, Level.ERROR), (warnings, Level.WARNING), (self.notes, Level.NOTICE))
        own = [Annotation(line, level, *self.places.get(line, ())) for lines, level in listed for line in lines]
        return [replace(each, title=each.title or self.title) for each in (*self.annotations, *own)]

    def written(self) -> dict[str, str | bytes]:
        """Return the content of all files by their names."""
        texts = {
            RESULTS_FILE: results_text(self.verdict, self.results, self.all_reasons),
            JUNIT_FILE: junit_xml(self.suites),
        }
        if self.brief is not None:
            texts[BRIEF_FILE] = self.brief.text
        return {**self.files, **texts, SUMMARY_FILE: self.markdown()}

    def write(self, folder: Path) -> None:
        """Write all files into a folder; raises :class:`calibration.base.errors.InfrastructureError`."""
        for name, content in self.written().items():
            write_atomically(folder / name, content)


MAX_OUTPUT_CHARACTERS = 100_000
"""Limit of an output that is a list or a mapping: as an environment variable of a later step it may have 128 KiB."""
_FILE_OF_OUTPUT = {"results": RESULTS_FILE, "summary": SUMMARY_FILE}
"""Outputs that are paths of files, empty if no files are written."""


def publish(report: Report, runner: Runner, folder: Path | None = None) -> ExitCode:
    """Write the files of a report into a folder if one is given, show the report, and return its exit code.

    The verdict is the last line of the log. Raises :class:`InfrastructureError` if something cannot be written.
    """
    if folder is not None:
        report.write(folder)
    show(report, runner, folder)
    return report.exit_code


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


def remove_results(folder: Path | None, names: Iterable[str]) -> None:
    """Remove files of an earlier run from a folder, if there is one: they might be mistaken for current results.

    From then on nothing is written through links in the folder.

    Raises :class:`InfrastructureError` if one cannot be removed.
    """
    if folder is None:
        return
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
