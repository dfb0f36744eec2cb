"""Runs of the same tests together: which always fail, and which are flaky."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

from calibration.addons.image_tests.judging import JudgedRun
from calibration.base.flake_rate import FlakeRate
from calibration.base.records import field, result
from calibration.ci.report.xunit_reading import CaseOutcome


@result
class RepeatedTest:
    """A test that failed in at least one run."""

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


def failing_tests(attempts: Sequence[Sequence[JudgedRun]]) -> tuple[RepeatedTest, ...]:
    """Return the tests that failed at least once, those that always fail first, then the most frequent.

    Args:
        attempts: of each run its attempts: the run, and its retries.
    """
    failures: dict[str, list[tuple[int, CaseOutcome]]] = defaultdict(list)
    ran: dict[str, int] = defaultdict(int)
    for number, run in enumerate(attempts, start=1):
        for attempt in run:
            for name, case in _case_by_name(attempt.cases).items():
                ran[name] += case.state != "skipped"
                if case.state == "failed":
                    failures[name].append((number, case))
    found = [
        RepeatedTest(
            name,
            FlakeRate(len(failed), ran[name]),
            failed[0][1].message,
            failed[0][1].file,
            failed[0][1].line,
            tuple(dict.fromkeys(number for number, _ in failed)),
        )
        for name, failed in failures.items()
    ]
    return tuple(sorted(found, key=lambda test: (test.flaky, -test.rate.share, test.name)))


def _case_by_name(cases: Iterable[CaseOutcome]) -> Mapping[str, CaseOutcome]:
    """Return the outcome of each test; of cases of one name the first that failed, else the last."""
    found: dict[str, CaseOutcome] = {}
    for case in cases:
        if case.name not in found or found[case.name].state != "failed":
            found[case.name] = case
    return found
