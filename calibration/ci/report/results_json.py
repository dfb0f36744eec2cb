"""Documents of a report: results.json, which begins with the same keys for every command, and comment.json.

A stage of an add-on has a result of its own in that of a run.
comment.json is the content of a comment on a pull request, which a job with a token writes later.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

from calibration.base import CalibrationError, InputError, parse_json, read_bytes
from calibration.base.records import computed, field, read, result, value_of
from calibration.base.verdict import Verdict, verdict_of

_Record = TypeVar("_Record")
RESULTS_FILE = "results.json"
SCHEMA_NUMBER: Literal[1] = 1
"""Version of the format of results.json. Keys may be added; renaming one requires a new number."""
MAX_RESULTS_BYTES = 64 * 1024**2
"""Size limit of a results file that is read."""


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
    try:
        document = parse_json(read_bytes(path, MAX_RESULTS_BYTES, f"results of {command}"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is not a results file: {error}") from None
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
    try:
        document = parse_json(read_bytes(path, MAX_BRIEF_BYTES, "a report in brief"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is not a report in brief: {error}") from None
    brief = read(Brief, document, str(path))
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
