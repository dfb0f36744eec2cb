"""A report in brief, ``comment.json``: what a comment on a pull request shows, to be written where a token is."""

import json
from pathlib import Path
from typing import Literal

from calibration.errors import InputError
from calibration.files import read_bytes
from calibration.json_file import parse_json
from calibration.records import field, read, result, value_of
from calibration.report.verdict import Verdict

BRIEF_FILE = "comment.json"
_MOST_BYTES = 4 * 1024**2


@result
class BriefTable:
    """A table of texts."""

    columns: tuple[str, ...] = field("The header.")
    rows: tuple[tuple[str, ...], ...] = field("As many texts each as the header.", default=())


@result(kw_only=True)
class Brief:
    """What a command has found, in brief."""

    schema: Literal[1] = field("Number of this form.", default=1)
    verdict: Verdict = field("Whether everything that was asked for holds.")
    sentence: str = field("The verdict's numbers in one line.")
    reasons: tuple[str, ...] = field("Why the verdict is fail.", default=())
    tables: tuple[BriefTable, ...] = field("The tables that matter.", default=())

    @property
    def text(self) -> str:
        """The content of the file."""
        return json.dumps(value_of(self), indent=1) + "\n"


def read_brief(path: Path) -> Brief:
    """Read a report in brief, which may be a stranger's.

    Raises:
        InputError: it cannot be read, is too large, or is none.
    """
    try:
        document = parse_json(read_bytes(path, _MOST_BYTES, "a report in brief"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is not a report in brief: {error}") from None
    brief = read(Brief, document, str(path))
    for table in brief.tables:
        if any(len(row) != len(table.columns) for row in table.rows):
            raise InputError(f"{path}: tables: found a row that is not as long as its header")
    return brief
