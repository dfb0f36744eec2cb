"""Report of ``static-analysis``, and its findings as SARIF 2.1.0, for GitHub's code scanning and editors."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args
from urllib.parse import quote, unquote

from calibration.addons.analysis.analysers.own_checks import JSON_FILE, PICTURE_FILE, RosGraph
from calibration.addons.analysis.analysers.programs import BADGE_FILE, grade_badge
from calibration.addons.analysis.copies import Compared, Located
from calibration.addons.analysis.results import (
    CATEGORIES,
    SEVERITIES,
    AnalysisResults,
    CodeFinding,
    GraphSummary,
    Metrics,
    Severity,
)
from calibration.base import InputError, read_bytes, shorten
from calibration.ci.report import Lines, Outcome, Report, Table, count_of, outcome_of_check, verdict_of
from calibration.ci.workflow.runner import Annotation, Level

TITLE = "static-analysis"
MAX_FINDINGS_SHOWN = 100
MAX_FILES_SHOWN = 20
_LEVEL_OF_SEVERITY = {"error": Level.ERROR, "warning": Level.WARNING, "note": Level.NOTICE}


def report(results: AnalysisResults, sarif: str, graph: RosGraph | None, root: Path, folder: Path | None) -> Report:
    """Return the report.

    Args:
        results: the results.
        sarif: the same as SARIF.
        graph: of the ROS nodes, if there are any.
        root: of the repository, for annotations.
        folder: of the files, if they are written.
    """
    categories = Counter((finding.category, finding.severity) for finding in results.findings)
    return Report(
        title="Static analysis",
        verdict=verdict_of(not results.problems),
        sentence=_verdict_sentence(results),
        reasons=tuple(results.problems),
        results=results,
        annotations=tuple(
            Annotation(
                finding.message, _LEVEL_OF_SEVERITY[finding.severity], root / finding.path, finding.line, finding.rule
            )
            for finding in gravest_first(results.new)
        ),
        blocks=(
            _findings_table(results.new, f"{len(results.new)} new" if results.base else "New"),
            Table(
                ("category", *SEVERITIES, "all"),
                tuple(
                    (name, *(str(categories[name, each]) for each in SEVERITIES), str(results.by_category[name]))
                    for name in CATEGORIES
                    if results.by_category[name]
                ),
                title="Findings",
            ),
            Table(("file", "findings"), _files_with_most_findings(results), title="Files with most findings"),
            *_metrics_table(results.metrics),
            *_graph_blocks(results.graph),
            Lines(results.remarks),
            Lines(
                tuple(f"not analysed: {path}: {why}" for path, why in results.left_out.items()), most=MAX_FILES_SHOWN
            ),
            _findings_table(results.unchanged, "Not new", folded=True),
            _findings_table(results.fixed, "Fixed", folded=True),
        ),
        suites={TITLE: _junit_cases(results)},
        outputs={
            "new": len(results.new),
            "fixed": len(results.fixed),
            "findings": len(results.findings),
            "suppressed": len(results.suppressed),
            "per-thousand-lines": results.per_thousand_lines,
            "grade": results.metrics.grade if results.metrics else None,
            "sarif": None if folder is None else folder / SARIF_FILE,
        },
        files={
            SARIF_FILE: sarif,
            **({JSON_FILE: graph.document, PICTURE_FILE: graph.picture} if graph else {}),
            **({BADGE_FILE: grade_badge(results.metrics.grade)} if results.metrics else {}),
        },
    )


def gravest_first(findings: Sequence[CodeFinding]) -> list[CodeFinding]:
    """Sort findings for a report: errors first, security before other warnings."""
    return sorted(findings, key=lambda each: (SEVERITIES.index(each.severity), each.category != "security", each.place))


def _verdict_sentence(results: AnalysisResults) -> str:
    parts = [*results.problems] or [count_of(len(results.findings), "finding")]
    if results.base is not None and not results.problems:
        parts = [f"{len(results.new)} new, {len(results.fixed)} fixed, {len(results.unchanged)} not new"]
    if results.suppressed:
        parts.append(f"{len(results.suppressed)} suppressed")
    return "; ".join([*parts, f"{count_of(results.files, 'file')} analysed"])


def _findings_table(findings: Sequence[CodeFinding], title: str, folded: bool = False) -> Table:
    rows = tuple(
        (each.place, each.severity, each.category, each.rule, shorten(each.message, 200))
        for each in gravest_first(findings)
    )
    header = ("place", "severity", "category", "rule", "finding")
    return Table(header, rows, MAX_FINDINGS_SHOWN, title=title, folded=folded)


def _files_with_most_findings(results: AnalysisResults) -> tuple[tuple[str, str], ...]:
    counts = Counter(finding.path for finding in results.findings)
    return tuple((path, str(count)) for path, count in counts.most_common(MAX_FILES_SHOWN))


def _metrics_table(metrics: Metrics | None) -> tuple[Table, ...]:
    if metrics is None:
        return ()
    rows = (
        ("grade", metrics.grade, "A to F"),
        ("weighted findings in a thousand lines", f"{metrics.weighted_findings:g}", "error 5, warning 1, note 0.2"),
        ("functions", str(metrics.functions), f"mean complexity {metrics.mean_complexity:g}"),
        ("too complex", f"{metrics.complex_percent:g} %", "above 10 %: one grade worse"),
        ("duplicate", f"{metrics.duplicate_percent:g} %", "above 10 %: one grade worse"),
    )
    return (Table(("metric", "value", ""), rows, title="Metrics"),)


def _graph_blocks(graph: GraphSummary | None) -> tuple[Table | Lines, ...]:
    """Return the blocks about the graph: what a change connects or cuts."""
    if graph is None:
        return ()
    rows = [*(("connected", each) for each in graph.connected), *(("cut", each) for each in graph.cut)]
    size = f"{count_of(graph.nodes, 'ROS node')}, {count_of(graph.connections, 'connection')}, see {PICTURE_FILE}"
    unresolved = f"; {len(graph.unresolved)} names are known only at run time" if graph.unresolved else ""
    table = Table(("change", "connection"), tuple(rows), MAX_FINDINGS_SHOWN, title="ROS graph")
    return (table, Lines((f"{size}{unresolved}",)))


def _junit_cases(results: AnalysisResults) -> list[Outcome]:
    """Return the cases of JUnit: each limit, and each analyser, which passes where it has run."""
    limits = [replace(outcome_of_check(check, TITLE), name=f"{check.subject}") for check in results.checks]
    return [*limits, *(Outcome(name=f"{tool.name} {tool.version}".strip(), group=TITLE) for tool in results.tools)]


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
