"""Findings as SARIF 2.1.0, for GitHub's code scanning and editors."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from urllib.parse import quote

from calibration.addons.analysis.finding import Finding, Located

SARIF_FILE = "findings.sarif"
SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
FINGERPRINT = "ruleAndContent/v1"
_LEVEL_OF_SEVERITY = {"error": "error", "warning": "warning", "note": "note"}


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
    new: frozenset[Finding] | None = None,
    suppressed: Mapping[Finding, str] | None = None,
) -> str:
    """Write a log with one run for each analyser.

    Args:
        findings: all of them.
        versions: version of each analyser that ran, by name.
        new: the new ones; None if there is nothing to compare with.
        suppressed: reasons of the accepted ones.
    """
    entries = list(zip(findings, fingerprints(findings), strict=True))
    runs = [
        _run_document(
            name, version, [each for each in entries if _analyser_of_finding(each[0]) == name], new, suppressed or {}
        )
        for name, version in sorted(versions.items())
    ]
    log = {"$schema": SARIF_SCHEMA, "version": "2.1.0", "runs": runs}
    return json.dumps(log, indent=1, ensure_ascii=True) + "\n"


def _analyser_of_finding(each: Located) -> str:
    return each.finding.rule.partition("/")[0]


def _run_document(
    name: str,
    version: str,
    entries: Sequence[tuple[Located, str]],
    new: frozenset[Finding] | None,
    suppressed: Mapping[Finding, str],
) -> dict[str, Any]:
    rules = {each.finding.rule: each.finding for each, _ in entries}
    driver: dict[str, Any] = {"name": name, "rules": [_rule_document(rules[rule]) for rule in sorted(rules)]}
    if version:
        driver["version"] = version
    return {
        "tool": {"driver": driver},
        "automationDetails": {"id": f"static-analysis/{name}/"},
        "columnKind": "unicodeCodePoints",
        "results": [_result_document(each.finding, fingerprint, new, suppressed) for each, fingerprint in entries],
    }


def _rule_document(finding: Finding) -> dict[str, Any]:
    return {
        "id": finding.rule,
        "defaultConfiguration": {"level": _LEVEL_OF_SEVERITY[finding.severity]},
        "properties": {"tags": [finding.category]},
    }


def _result_document(
    finding: Finding, fingerprint: str, new: frozenset[Finding] | None, suppressed: Mapping[Finding, str]
) -> dict[str, Any]:
    uri = quote(finding.path.encode("utf-8", "surrogateescape"))
    entry: dict[str, Any] = {
        "ruleId": finding.rule,
        "level": _LEVEL_OF_SEVERITY[finding.severity],
        "message": {"text": finding.message or finding.rule},
        "locations": [{"physicalLocation": {"artifactLocation": {"uri": uri}, "region": {"startLine": finding.line}}}],
        "partialFingerprints": {FINGERPRINT: fingerprint},
    }
    if new is not None:
        entry["baselineState"] = "new" if finding in new else "unchanged"
    if finding in suppressed:
        entry["suppressions"] = [{"kind": "external", "justification": suppressed[finding]}]
    return entry
