"""Report of a command: its verdict, results, outputs, annotations and text, its documents, and its publishing.

results.json begins with the same keys for every command; a stage of an add-on has a result of its own in that of a run.
comment.json is the content of a comment on a pull request, which a job with a token writes later.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from itertools import accumulate, takewhile
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

from calibration.base import (
    CalibrationError,
    ExitCode,
    InfrastructureError,
    InputError,
    escape_markdown,
    follow_no_links,
    one_line,
    read_json,
    write_atomically,
)
from calibration.base.records import computed, field, read, result, value_of
from calibration.base.verdict import Verdict, verdict_of
from calibration.ci.report.blocks import MOST_LINES, RESULTS_FILE, Block, Lines, Table, cut
from calibration.ci.report.junit import Outcome, junit_xml
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

_Record = TypeVar("_Record")
SCHEMA_NUMBER: Literal[1] = 1
"""Version of the format of results.json. Keys may be added; renaming one requires a new number."""
MAX_RESULTS_BYTES = 64 * 1024**2
"""Size limit of a results file that is read."""
SUMMARY_FILE, JUNIT_FILE = "summary.md", "junit.xml"
FILES = (RESULTS_FILE, SUMMARY_FILE, JUNIT_FILE)
"""Files of every report."""
ROWS_IN_BRIEF, LINES_IN_BRIEF = 50, 10
"""Limits of the rows of a table, and of the lines of a block, in the brief report."""


@result
class Head:
    """Keys at the beginning of every results.json."""

    schema: Literal[1] = field("Version of this format; keys may be added, renaming one requires a new version.")
    verdict: Verdict = field("Whether all requirements are met; undecided if the data cannot tell.")
    reasons: tuple[str, ...] = field("Why the verdict is not pass, one line each, worst first.", default=())


def results_document(verdict: Verdict, results: Any, reasons: Sequence[str] = ()) -> dict[str, Any]:
    """Return the document of results, a record or a mapping, with the head; keys of the results take precedence."""
    head, document = value_of(Head(SCHEMA_NUMBER, verdict, tuple(reasons))), value_of(results)
    return {**{key: value for key, value in head.items() if key not in document}, **document}


def results_text(verdict: Verdict, results: Any, reasons: Sequence[str] = ()) -> str:
    """Return the text of results.json; raises ``ValueError`` for a number that is not finite."""
    return json.dumps(results_document(verdict, results, reasons), indent=1, allow_nan=False) + "\n"


def read_results_file(kind: type[_Record], path: Path, command: str) -> tuple[_Record, dict[str, Any]]:
    """Read a results.json of this version or an older one: as a record, and as the parsed document.

    Args:
        kind: type of the record.
        path: path of the file.
        command: command that writes the file, for messages.

    Raises:
        InputError: it cannot be read, has another schema number, or a value has a wrong type.
    """
    document = read_json(path, MAX_RESULTS_BYTES, f"results of {command}")
    if isinstance(document, dict) and (found := document.get("schema", SCHEMA_NUMBER)) != SCHEMA_NUMBER:
        expected = f"expected {SCHEMA_NUMBER}: another version has written it"
        raise InputError(f"{path}: schema: found {found!r:.80}, {expected}")
    return read(kind, document, str(path)), document


def reasons_in(folder: Path) -> tuple[str, ...]:
    """Return the reasons in the results of any command; empty if there are no valid results."""
    try:
        return read_results_file(Head, folder / RESULTS_FILE, "a command")[0].reasons
    except CalibrationError:
        return ()


BRIEF_FILE = "comment.json"
MAX_BRIEF_BYTES = 4 * 1024**2


@result
class BriefTable:
    """A table of strings."""

    columns: tuple[str, ...] = field("The header.")
    rows: tuple[tuple[str, ...], ...] = field("Rows with as many cells as the header.", default=())


@result(kw_only=True)
class Brief:
    """Brief results of a command."""

    schema: Literal[1] = field("Version of this format.", default=1)
    verdict: Verdict = field("Whether all requirements are met; undecided if the data cannot tell.")
    sentence: str = field("The verdict's numbers in one line.")
    about: str = field("What the results are of: the commit and its date.", default="")
    reasons: tuple[str, ...] = field("Why the verdict is not pass, worst first.", default=())
    tables: tuple[BriefTable, ...] = field("Tables of the comment.", default=())
    lines: tuple[str, ...] = field("What else counts, one line each: findings, tests, time.", default=())

    @property
    def text(self) -> str:
        """Content of the file."""
        return json.dumps(value_of(self), indent=1) + "\n"


def read_brief(path: Path) -> Brief:
    """Read a brief report, which may be untrusted.

    Raises:
        InputError: it cannot be read, is too large, or is not a brief report.
    """
    brief = read(Brief, read_json(path, MAX_BRIEF_BYTES, "a report in brief"), str(path))
    for table in brief.tables:
        if any(len(row) != len(table.columns) for row in table.rows):
            raise InputError(f"{path}: tables: found a row that is not as long as its header")
    return brief


@result(kw_only=True)
class StageResult(ABC):
    """Result of a stage of an add-on, which is part of the verdict of a run."""

    heading: ClassVar[str]
    """What the stage did, for the report."""

    folder: str = field("The folder with its own files, relative to the output folder.")
    reasons: tuple[str, ...] = field("Reasons of a fail verdict.", default=())

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail if there is a reason."""
        return verdict_of(not self.reasons)

    @property
    @abstractmethod
    def sentence(self) -> str:
        """Return the result in a few words, for the verdict's line."""

    def line(self, output: Path) -> str:
        """Return its line of the report: where its own summary is in the output folder."""
        return f"{self.heading}: {output / self.folder / 'summary.md'}"


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
    suites: Mapping[str, Sequence[Outcome]] = dataclass_field(default_factory=dict)
    """Outcomes for JUnit, by suite."""
    outputs: Mapping[str, OutputValue | None] = dataclass_field(default_factory=dict)
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
    places: Mapping[str, tuple[Path, int]] = dataclass_field(default_factory=dict)
    """File and line to which a reason refers, by the reason."""
    annotations: tuple[Annotation, ...] = ()
    """Further annotations, with a file and line or a title of their own."""
    blocks: tuple[Block, ...] = ()
    """Tables and lists, in order."""
    files: Mapping[str, str | bytes] = dataclass_field(default_factory=dict)
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
