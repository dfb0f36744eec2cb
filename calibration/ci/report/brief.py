"""Brief report, ``comment.json``: content of a comment on a pull request, which a job with a token writes later."""

import json
from pathlib import Path
from typing import Literal

from calibration.base.documents import parse_json
from calibration.base.errors import InputError
from calibration.base.files import read_bytes
from calibration.base.records import field, read, result, value_of
from calibration.base.verdict import Verdict

BRIEF_FILE = "comment.json"
_MOST_BYTES = 4 * 1024**2


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
        document = parse_json(read_bytes(path, _MOST_BYTES, "a report in brief"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is not a report in brief: {error}") from None
    brief = read(Brief, document, str(path))
    for table in brief.tables:
        if any(len(row) != len(table.columns) for row in table.rows):
            raise InputError(f"{path}: tables: found a row that is not as long as its header")
    return brief
