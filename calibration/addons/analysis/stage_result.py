"""Result of the stage analyse, in results.json of the pipeline."""

from pathlib import Path

from calibration.base.records import computed, field, result
from calibration.ci.report import Verdict, count_of, verdict_of


@result(kw_only=True)
class Analysed:
    """Static analysis of the repository."""

    findings: int = field("Number of findings that are not accepted.")
    new: int | None = field("Those that the change brings in; null if there is no base to compare with.")
    folder: str = field("The folder with its results, relative to the output folder.")
    reasons: tuple[str, ...] = field("Limits that are exceeded.", default=())

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail if a limit is exceeded."""
        return verdict_of(not self.reasons)

    @property
    def sentence(self) -> str:
        """Return the number of findings, for the line of the verdict."""
        count = count_of(self.findings, "finding")
        return f"{count} in the code" if self.new is None else f"{count} in the code, {self.new} new"

    def line(self, output: Path) -> str:
        """Return the path of the analysis' own summary, for the report."""
        return f"Static analysis: {output / self.folder / 'summary.md'}"
