"""Findings as SARIF 2.1.0, for GitHub's code scanning and editors; and those of an earlier ``findings.sarif``."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args
from urllib.parse import quote, unquote

from calibration.addons.analysis.comparison import Compared, Located
from calibration.addons.analysis.results import CodeFinding, Severity
from calibration.base.errors import InputError
from calibration.base.files import read_bytes

SARIF_FILE = "findings.sarif"
SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
FINGERPRINT = "ruleAndContent/v1"


def fingerprints(findings: Iterable[Located]) -> list[str]:
    """Return fingerprints that do not change when code moves: of rule, file, content, and index among equal ones."""
    seen: Counter[tuple[str, str, str]] = Counter()
    prints = []
    for each in findings:
        key = (each.finding.rule, each.finding.path, each.content)
        text = "\0".join((*key, str(seen[key])))
        seen[key] += 1
        prints.append(hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest())
    return prints


def sarif(
    findings: Sequence[Located],
    versions: Mapping[str, str],
    new: frozenset[CodeFinding] | None = None,
    suppressed: Mapping[CodeFinding, str] | None = None,
) -> str:
    """Write a log with one run for each analyser.

    Args:
        findings: all of them.
        versions: version of each analyser that ran, by name.
        new: the new ones; None if there is nothing to compare with.
        suppressed: reasons of the accepted ones.
    """
    entries: dict[str, list[tuple[CodeFinding, str]]] = {name: [] for name in sorted(versions)}
    for each, fingerprint in zip(findings, fingerprints(findings), strict=True):
        entries.setdefault(each.finding.rule.partition("/")[0], []).append((each.finding, fingerprint))
    runs = [_run_document(name, versions[name], entries[name], new, suppressed or {}) for name in sorted(versions)]
    log = {"$schema": SARIF_SCHEMA, "version": "2.1.0", "runs": runs}
    return json.dumps(log, indent=1, ensure_ascii=True) + "\n"


def _run_document(
    name: str,
    version: str,
    entries: Sequence[tuple[CodeFinding, str]],
    new: frozenset[CodeFinding] | None,
    suppressed: Mapping[CodeFinding, str],
) -> dict[str, Any]:
    rules = {finding.rule: finding for finding, _ in entries}
    driver: dict[str, Any] = {"name": name, "rules": [_rule_document(rules[rule]) for rule in sorted(rules)]}
    if version:
        driver["version"] = version
    return {
        "tool": {"driver": driver},
        "automationDetails": {"id": f"static-analysis/{name}/"},
        "columnKind": "unicodeCodePoints",
        "results": [_result_document(finding, fingerprint, new, suppressed) for finding, fingerprint in entries],
    }


def _rule_document(finding: CodeFinding) -> dict[str, Any]:
    return {
        "id": finding.rule,
        "defaultConfiguration": {"level": finding.severity},
        "properties": {"tags": [finding.category]},
    }


def _result_document(
    finding: CodeFinding, fingerprint: str, new: frozenset[CodeFinding] | None, suppressed: Mapping[CodeFinding, str]
) -> dict[str, Any]:
    uri = quote(finding.path.encode("utf-8", "surrogateescape"))
    entry: dict[str, Any] = {
        "ruleId": finding.rule,
        "level": finding.severity,
        "message": {"text": finding.message or finding.rule},
        "locations": [{"physicalLocation": {"artifactLocation": {"uri": uri}, "region": {"startLine": finding.line}}}],
        "partialFingerprints": {FINGERPRINT: fingerprint},
    }
    if new is not None:
        entry["baselineState"] = "new" if finding in new else "unchanged"
    if finding in suppressed:
        entry["suppressions"] = [{"kind": "external", "justification": suppressed[finding]}]
    return entry


MAX_SARIF_BYTES = 100_000_000


def read_earlier(path: Path) -> list[tuple[str, CodeFinding]]:
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


def _read_result(result: dict[str, Any]) -> tuple[str, CodeFinding]:
    place = result["locations"][0]["physicalLocation"]
    severity = result["level"]
    line = place["region"]["startLine"]
    if severity not in get_args(Severity) or not isinstance(line, int):
        raise ValueError
    path, message = unquote(place["artifactLocation"]["uri"]), result["message"]["text"]
    finding = CodeFinding(str(path), line, str(result["ruleId"]), "error-prone", severity, str(message))
    return str(result["partialFingerprints"][FINGERPRINT]), finding


def compare_with_earlier(now: Sequence[Located], earlier: Sequence[tuple[str, CodeFinding]]) -> Compared:
    """Compare findings with earlier ones by their fingerprints: rule, file, and content of the line.

    Code that has moved to another file is new here, as the earlier state has only its fingerprints.
    """
    known = dict(earlier)
    found = {fingerprint: each.finding for fingerprint, each in zip(fingerprints(now), now, strict=True)}
    return Compared(
        tuple(finding for fingerprint, finding in found.items() if fingerprint not in known),
        tuple(finding for fingerprint, finding in found.items() if fingerprint in known),
        tuple(finding for fingerprint, finding in known.items() if fingerprint not in found),
    )
