"""Findings of the analysers in a common form, and results of ``static-analysis``, with their document."""

from collections import Counter
from collections.abc import Mapping
from typing import Literal

from calibration.base.records import computed, field, result
from calibration.ci.report import Check, count_of
from calibration.ci.report.report import StageResult

Category = Literal[
    "error-prone",
    "security",
    "performance",
    "unused code",
    "complexity",
    "style",
    "documentation",
    "compatibility",
]
CATEGORIES: tuple[Category, ...] = Category.__args__  # type: ignore[attr-defined]
Severity = Literal["error", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = Severity.__args__  # type: ignore[attr-defined]


@result
class CodeFinding:
    """Fault at a line of a file."""

    path: str = field("The file, in the repository.")
    line: int = field("The first line of the file is 1.")
    rule: str = field("The analyser and its rule: ruff/F401.")
    category: Category
    severity: Severity
    message: str

    @property
    def place(self) -> str:
        """File and line."""
        return f"{self.path}:{self.line}"


@result
class Tool:
    """An analyser that ran."""

    name: str
    version: str = field("Empty where it has none of its own.")
    files: int = field("Number of files that it analysed.")


@result
class Suppressed:
    """A finding that the team has accepted."""

    finding: CodeFinding
    reason: str = field("Why.")


@result
class GraphSummary:
    """Nodes of ROS packages that launch files start, and what connects them."""

    nodes: int
    connections: int = field("Number of pairs of nodes with a topic, service or action in common.")
    connected: tuple[str, ...] = field("Connections that the change makes, such as `/scan: /lidar -> /follower`.")
    cut: tuple[str, ...] = field("Connections that it cuts.")
    unresolved: tuple[str, ...] = field("What is known only when the nodes run; it makes no finding.")


@result
class Metrics:
    """Metrics of the code in Python, C and C++, and a grade."""

    functions: int
    mean_complexity: float = field("Mean cyclomatic complexity of the functions.")
    complex_percent: float = field("Share of functions with a cyclomatic complexity above 15, in percent.")
    duplicate_percent: float = field("Share of duplicate code, in percent, as lizard counts it.")
    weighted_findings: float = field(
        "Findings in a thousand lines that are not empty: 5 for an error, 1 for a warning, 0.2 for a note."
    )
    grade: str = field(
        "A up to 1 weighted finding in a thousand lines, B 5, C 10, D 20, E 40, F beyond; one worse if more than 10 "
        "percent of the functions are too complex, and if more than 10 percent of the code is duplicate."
    )


@result
class AnalysisResults:
    """Results of static-analysis."""

    tools: tuple[Tool, ...] = field("The analysers that had files to look at.")
    files: int = field("Number of files that at least one of them analysed.")
    code_lines: int = field("Number of non-empty lines of these files.")
    left_out: Mapping[str, str] = field("Reason why a file was not analysed, by path.")
    base: str | None = field(
        "Base commit of the change, or the file of earlier findings; null if there is nothing to compare with."
    )
    new: tuple[CodeFinding, ...] = field("New findings of the change.")
    unchanged: tuple[CodeFinding, ...] = field("Findings of the base too; all findings if there is no base.")
    fixed: tuple[CodeFinding, ...] = field("Fixed findings, at their lines in the base.")
    suppressed: tuple[Suppressed, ...] = field("Accepted findings.")
    remarks: tuple[str, ...] = field("Suppressions that have ended or cover nothing; why there is no base.")
    checks: tuple[Check, ...] = field("The limits.")
    metrics: Metrics | None = field("Metrics and grade; null if they are not asked for.", default=None)
    graph: GraphSummary | None = field("Graph of the ROS nodes; null if there is no ROS package.", default=None)

    @property
    def findings(self) -> tuple[CodeFinding, ...]:
        """Findings that are not accepted, the new ones first."""
        return self.new + self.unchanged

    @property
    @computed()
    def by_category(self) -> dict[str, int]:
        """Number of findings of each category."""
        counts = Counter(finding.category for finding in self.findings)
        return {category: counts[category] for category in CATEGORIES}

    @property
    @computed()
    def per_thousand_lines(self) -> float | None:
        """Number of findings per thousand lines; null if there are no lines."""
        return round(1000 * len(self.findings) / self.code_lines, 2) if self.code_lines else None

    @property
    @computed()
    def problems(self) -> list[str]:
        """Reasons of a fail verdict, one line each; empty if it is pass."""
        return [str(check) for check in self.checks if not check.passed]


@result(kw_only=True)
class Analysed(StageResult):
    """Static analysis of the repository."""

    heading = "Static analysis"

    findings: int = field("Number of findings that are not accepted.")
    new: int | None = field("Those that the change brings in; null if there is no base to compare with.")

    @property
    def sentence(self) -> str:
        """Return the number of findings, for the line of the verdict."""
        count = count_of(self.findings, "finding")
        return f"{count} in the code" if self.new is None else f"{count} in the code, {self.new} new"
