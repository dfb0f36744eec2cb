"""Results of repeated runs, and the verdict on them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from calibration.base.errors import ExitCode, exit_code_of
from calibration.base.records import computed, field, result
from calibration.base.text import count_of
from calibration.base.verdict import Verdict
from calibration.ci.report.junit import ErrorCode, Outcome
from calibration.ci.report.repeated import RepeatedFailure, repeated_failures
from calibration.ci.report.xunit_reading import CaseOutcome
from calibration.pipeline.repetition.comparison import (
    FirstDifference,
    Spread,
    first_differences,
    spreads_of_results,
    stage_times,
)
from calibration.pipeline.repetition.repetition import Repetition
from calibration.pipeline.repetition.settings import Repetitions

THE_RUN = "the run"
"""Name of an outcome that stands for a run itself."""
MAX_NAMED_FAILURES = 100
"""Limit of the failures that reasons name."""


@result(kw_only=True)
class RunResult:
    """One of the repeated runs."""

    verdict: Verdict = field("Its verdict; fail if it was cut short.")
    folder: str = field("Folder with its own results, relative to the output folder.")
    seconds: Mapping[str, float] = field("Duration of each stage.")
    whole_seconds: float = field("Duration of the run.")
    outputs: Mapping[str, Mapping[str, str]] = field("Hashes of what each stage has left, by stage and name.")
    cut_short: str | None = field("Why it ended early; null if it is complete.", default=None)
    error: ErrorCode | None = field("Exit code of a run that failed because of bad input or infrastructure.")


@result(kw_only=True)
class RepeatedResults:
    """Results of repeated runs."""

    asked: int = field("Number of runs that were asked for.")
    runs: tuple[RunResult, ...] = field("The runs, in order.")
    times: tuple[Spread, ...] = field("Duration of each stage, and of the whole run, over the complete runs.")
    spreads: tuple[Spread, ...] = field("Results that are not equal in all complete runs.")
    equal: int = field("Number of results that are equal in all of them, to the last bit.")
    differences: tuple[FirstDifference, ...] = field("From which stage on runs differ.")
    failures: tuple[RepeatedFailure, ...] = field("What failed at least once; what always fails first.")
    undecided: tuple[RepeatedFailure, ...] = field("What was undecided, and so did not pass, at least once.")
    max_flake_rate: float | None = field("Largest share of runs in which something flaky may fail.", default=None)
    unjudged: tuple[str, ...] = field("Units for which a largest spread is set, and no two runs have a result.")
    undecided_passes: bool = field("Whether an undecided spread counts as passed.", default=False)

    @property
    def _was_stopped(self) -> bool:
        """Whether the last run ended all: it has then not failed by itself."""
        known = {number for each in self.failures if each.name == THE_RUN for number in each.runs}
        return self.runs[-1].cut_short is not None and len(self.runs) not in known

    @property
    @computed()
    def reasons(self) -> list[str]:
        """Reasons of a fail verdict, one line each, worst first."""
        lines = []
        if self._was_stopped:
            missing = self.asked - len(self.runs)
            lines.append(f"run {len(self.runs)} was cut short: {self.runs[-1].cut_short}")
            lines += [f"{missing} of {count_of(self.asked, 'run')} were not made"] if missing else []
        failing = [each for each in self.failures if not each.is_within(self.max_flake_rate)]
        lines += [f"{each.name} {each}" for each in failing[:MAX_NAMED_FAILURES]]
        if (more := len(failing) - MAX_NAMED_FAILURES) > 0:
            lines.append(f"and {more} more failed")
        return lines + [str(spread.check) for spread in self.spreads if spread.verdict == "fail"]

    @property
    def undecided_lines(self) -> list[str]:
        """What is undecided, one line each."""
        undecided = [each for each in self.undecided if not each.is_within(self.max_flake_rate)]
        lines = [f"{each.name}, in {each.rate.failed} of {each.rate.runs} runs: {each.message}" for each in undecided]
        reaching = [spread for spread in self.spreads if spread.verdict == "undecided"]
        lines += [f"undecided: {each.check} for sure: more runs decide" for each in reaching]
        return lines + [f"undecided: max-spread: no two runs have a result in {unit}" for unit in self.unjudged]

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail if there is a reason, else undecided if a run or a spread is."""
        if self.reasons:
            return "fail"
        undecided = bool(self.undecided_lines) or any(run.verdict == "undecided" for run in self.runs)
        return "undecided" if undecided else "pass"

    @property
    def passes(self) -> bool:
        """Whether the verdict is pass, or undecided only where that counts as passed."""
        return not self.reasons and (not self.undecided_lines or (self.undecided_passes and not self.undecided))

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of the verdict; if it is not pass, 2 or 3 where a run failed because of input or infrastructure."""
        return exit_code_of(self.passes, () if self.passes else (run.error for run in self.runs))


def repeated_results(
    settings: Repetitions, runs: Sequence[Repetition], output: Path, undecided_passes: bool = False
) -> RepeatedResults:
    """Compare runs.

    Args:
        settings: how many were asked for, and what is allowed.
        runs: the runs, in order.
        output: folder to which paths are relative.
        undecided_passes: whether an undecided spread counts as passed.
    """
    complete = [run for run in runs if run.cut_short is None]
    spreads = spreads_of_results(complete, settings.max_spread)
    limited = set(settings.max_spread.limit_of_unit if settings.max_spread else ())
    varying = tuple(spread for spread in spreads if spread.largest > 0)
    return RepeatedResults(
        asked=settings.repeat,
        runs=tuple(
            RunResult(
                verdict=run.verdict,
                folder=str(run.folder.relative_to(output)),
                seconds={stage: round(seconds, 3) for stage, seconds in run.seconds.items()},
                whole_seconds=round(run.whole_seconds, 3),
                outputs=run.outputs,
                cut_short=run.cut_short,
                error=run.error,
            )
            for run in runs
        ),
        times=stage_times(complete),
        spreads=varying,
        equal=len(spreads) - len(varying),
        differences=first_differences(runs),
        failures=repeated_failures([_cases(run.outcomes, undecided=False)] for run in runs),
        undecided=repeated_failures([_cases(run.outcomes, undecided=True)] for run in runs),
        max_flake_rate=settings.max_flake_rate,
        unjudged=tuple(sorted(limited - {spread.unit for spread in spreads})),
        undecided_passes=undecided_passes,
    )


def _cases(outcomes: Sequence[Outcome], *, undecided: bool) -> Iterator[CaseOutcome]:
    """Yield the outcomes as cases that fail where they have failed, or only where they are undecided."""
    for each in outcomes:
        failed = each.verdict == "fail" and each.is_undecided == undecided
        message = each.reasons[0] if each.reasons else ""
        yield CaseOutcome(each.name, message if failed else "", state="failed" if failed else "passed")
