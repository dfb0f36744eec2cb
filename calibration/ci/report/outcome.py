"""Result of one unit of work: a calibration, a collected dataset, a scenario, a rule over a table."""

from dataclasses import dataclass
from typing import Annotated, Literal

from calibration.base.errors import ExitCode
from calibration.base.records import Converted
from calibration.base.verdict import Check, Verdict, verdict_of

ErrorCode = Annotated[ExitCode, Converted(Literal[2, 3], lambda code, _place: ExitCode(code))]
"""Exit code of work that failed because of bad input (2) or infrastructure (3), in results.json."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of one unit of work, as JUnit shows it."""

    name: str
    group: str = ""
    """Group in reports, such as a system."""
    reasons: tuple[str, ...] = ()
    """Reasons of a failure, one line each."""
    is_undecided: bool = False
    """Whether the reasons are undecided limits: to JUnit a failure of its own type."""
    error: ErrorCode | None = None
    """Exit code if the work failed because of bad input (2) or infrastructure (3)."""
    skipped: str | None = None
    """Reason why the work was skipped, if that is not a failure."""
    seconds: float | None = None
    """Duration; None if it was not measured."""
    file: str | None = None
    """The user's file to which the outcome refers."""
    line: int | None = None
    """Line in this file, from 1."""

    @property
    def verdict(self) -> Verdict:
        """Fail if there is a reason or an error."""
        return verdict_of(not self.reasons and self.error is None)


def outcome_of_check(check: Check, group: str) -> Outcome:
    """Convert a check to an outcome, for JUnit."""
    return Outcome(name=check.subject, group=group, reasons=() if check.passed else (str(check),))
