"""Settings of an analysis: options of the command, and the section ``analysis`` of calibration.yml."""

from pathlib import Path

from calibration.base.records import field, record

SUPPRESSIONS_FILE = ".static-analysis.yml"
"""Default path of the accepted findings, in the root of the repository."""


@record
class AnalysisSettings:
    """Settings of the static analysis: the files, the tools, and the limits of findings."""

    paths: tuple[str, ...] = field("Folders and files of the repository to analyse (all in git).", default=())
    exclude: tuple[str, ...] = field("Patterns of git for files that are not analysed.", default=())
    tools: tuple[str, ...] = field(
        "Only these of ruff, cppcheck, shellcheck, yamllint, zizmor, lizard, xml, urdf, ros (all).", default=()
    )
    base: str | None = field("Branch or commit that the change goes to (what the event says).", default=None)
    base_sarif: Path | None = field(
        "findings.sarif of an earlier analysis to compare with, in place of a commit.", default=None
    )
    max_new: tuple[str, ...] = field(
        "Most new findings of a severity, a category or all (error=0 security=0).", default=("error=0", "security=0")
    )
    max_total: tuple[str, ...] = field("Most findings, new or not, in the same form (no limit).", default=())
    max_file: tuple[str, ...] = field("Most findings of any one file, in the same form (no limit).", default=())
    suppressions: Path | None = field(f"File of what is accepted ({SUPPRESSIONS_FILE}, if there is one).", default=None)
    metrics: bool = field(
        "Measure complexity and duplication, and grade the code; 10 s for 100 000 lines.", default=False
    )
    timeout: str = field("Time limit of one program, such as 5m (5m).", default="5m")
