"""Findings of an earlier state from its ``findings.sarif``, where its commit cannot be analysed again."""

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args
from urllib.parse import unquote

from calibration.addons.analysis.comparison import Compared
from calibration.addons.analysis.finding import Finding, Located, Severity
from calibration.addons.analysis.sarif import FINGERPRINT, fingerprints
from calibration.base.errors import InputError
from calibration.base.files import read_bytes

MAX_SARIF_BYTES = 100_000_000


def read_earlier(path: Path) -> list[tuple[str, Finding]]:
    """Read the fingerprints and findings of a file that an earlier analysis has written.

    Raises:
        InputError: it cannot be read, or is no such file.
    """
    data = read_bytes(path, MAX_SARIF_BYTES, "the findings of an earlier analysis (findings.sarif)")
    try:
        return [_read_result(result) for run in json.loads(data)["runs"] for result in run["results"]]
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError):
        raise InputError(
            f"{path}: findings.sarif of an earlier static-analysis was expected, found another document"
        ) from None


def _read_result(result: dict[str, Any]) -> tuple[str, Finding]:
    place = result["locations"][0]["physicalLocation"]
    severity = result["level"]
    line = place["region"]["startLine"]
    if severity not in get_args(Severity) or not isinstance(line, int):
        raise ValueError
    path, message = unquote(place["artifactLocation"]["uri"]), result["message"]["text"]
    finding = Finding(str(path), line, str(result["ruleId"]), "error-prone", severity, str(message))
    return str(result["partialFingerprints"][FINGERPRINT]), finding


def compare_with_earlier(now: Sequence[Located], earlier: Sequence[tuple[str, Finding]]) -> Compared:
    """Compare findings with earlier ones by their fingerprints: rule, file, and content of the line.

    Code that has moved to another file is new here, as the earlier state has only its fingerprints.
    """
    known = Counter(fingerprint for fingerprint, _ in earlier)
    new, unchanged = [], []
    for each, fingerprint in zip(now, fingerprints(now), strict=True):
        if known[fingerprint] > 0:
            known[fingerprint] -= 1
            unchanged.append(each.finding)
        else:
            new.append(each.finding)
    fixed = []
    for fingerprint, finding in earlier:
        if known[fingerprint] > 0:
            known[fingerprint] -= 1
            fixed.append(finding)
    return Compared(tuple(new), tuple(unchanged), tuple(fixed))
