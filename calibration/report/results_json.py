"""results.json, which has the same head for every command: schema, verdict and reasons."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.errors import CalibrationError
from calibration.files import read_bytes
from calibration.json_file import parse_json
from calibration.report.verdict import Verdict

RESULTS_FILE = "results.json"
SCHEMA_NUMBER = 1
"""Number of the form of results.json. Keys may be added; none is renamed without a new number."""
MOST_BYTES = 64 * 1024**2
"""Size of the largest results file that is read."""


def results_document(verdict: Verdict, results: Mapping[str, Any], reasons: Sequence[str] = ()) -> dict[str, Any]:
    """Return results with the head; reasons that are among the results stay where they are."""
    head: dict[str, Any] = {"schema": SCHEMA_NUMBER, "verdict": verdict}
    return {**head, **({} if "reasons" in results else {"reasons": list(reasons)}), **results}


def results_text(document: Mapping[str, Any]) -> str:
    """Return a document as JSON; raises ``ValueError`` for a number that is not finite."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def reasons_in(folder: Path) -> tuple[str, ...]:
    """Return the reasons in the results of any command; none if it left no results, or not in this form."""
    try:
        document = parse_json(read_bytes(folder / RESULTS_FILE, MOST_BYTES, "results"))
        return tuple(map(str, document["reasons"]))
    except (CalibrationError, ValueError, KeyError, TypeError, RecursionError):
        return ()
