"""Report of ``static-analysis``."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calibration.addons.analysis.analysers.ros import JSON_FILE, PICTURE_FILE, RosGraph
from calibration.addons.analysis.metrics import BADGE_FILE, grade_badge
from calibration.addons.analysis.results import (
    CATEGORIES,
    SEVERITIES,
    AnalysisResults,
    CodeFinding,
    GraphSummary,
    Metrics,
)
from calibration.addons.analysis.sarif import SARIF_FILE
from calibration.base.text import shorten
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
