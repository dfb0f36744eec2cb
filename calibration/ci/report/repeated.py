"""Failures over repeated runs of the same work: which always fail, and which are flaky."""

from collections import defaultdict
from collections.abc import Iterable

from calibration.base.flake_rate import FlakeRate
from calibration.base.records import field, result
from calibration.ci.report.xunit_reading import CaseOutcome


@result
class RepeatedFailure:
    """What failed in at least one run: a test, a cell."""

    name: str
    rate: FlakeRate = field("How often it failed, of the runs in which it ran.")
    message: str = field("Why it failed, in the first of these runs.", default="")
    file: str | None = field("File in the repository, if it is known.", default=None)
    line: int | None = field("Line in this file.", default=None)
    runs: tuple[int, ...] = field("Numbers of the runs in which it failed, from 1.", default=())

    @property
    def flaky(self) -> bool:
        """Whether it passed in other runs."""
        return self.rate.failed < self.rate.runs

    def is_within(self, max_flake_rate: float | None) -> bool:
        """Return whether it is flaky, and fails in no larger share of the runs than is allowed."""
        return self.flaky and max_flake_rate is not None and self.rate.share <= max_flake_rate

    def __str__(self) -> str:
        message = f": {self.message}" if self.message else ""
        if self.flaky:
            return f"is flaky, {self.rate}{message}"
        every = f" in each of {self.rate.runs} runs" if self.rate.runs > 1 else ""
        return f"failed{every}{message}"


def repeated_failures(runs: Iterable[Iterable[Iterable[CaseOutcome]]]) -> tuple[RepeatedFailure, ...]:
    """Return what failed at least once: first what always fails, then the most frequent.

    Args:
        runs: of each run its attempts, of each attempt its outcomes, of which each name counts once.
    """
    failures: dict[str, list[tuple[int, CaseOutcome]]] = defaultdict(list)
    ran: dict[str, int] = defaultdict(int)
    for number, attempts in enumerate(runs, start=1):
        for cases in attempts:
            for name, case in _case_by_name(cases).items():
                ran[name] += case.state != "skipped"
                if case.state == "failed":
                    failures[name].append((number, case))
    found = [
        RepeatedFailure(
            name,
            FlakeRate(len(failed), ran[name]),
            failed[0][1].message,
            failed[0][1].file,
            failed[0][1].line,
            tuple(dict.fromkeys(number for number, _ in failed)),
        )
        for name, failed in failures.items()
    ]
    return tuple(sorted(found, key=lambda each: (each.flaky, -each.rate.share, each.name)))


def _case_by_name(cases: Iterable[CaseOutcome]) -> dict[str, CaseOutcome]:
    """Return the outcome of each name; of several the first that failed, else the last."""
    found: dict[str, CaseOutcome] = {}
    for case in cases:
        if case.name not in found or found[case.name].state != "failed":
            found[case.name] = case
    return found
