"""Results of repeated runs: how much their numbers vary, the first stage whose outputs differ, and the verdict."""

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean, stdev

import numpy as np

from calibration.base import ExitCode, count_of, exit_code_of, shorten
from calibration.base.arrays import Array
from calibration.base.records import computed, field, result
from calibration.base.verdict import Check, Verdict, at_most
from calibration.ci.report.junit import CaseOutcome, ErrorCode, Outcome, RepeatedFailure, repeated_failures
from calibration.engine.geometry import rotations
from calibration.pipeline.repetition.repetition import MaxSpread, Outputs, Repetition, Repetitions

GUARD_BAND = 2.0
"""Standard errors of a spread within which it does not decide on its limit, as of other limits."""
MAX_NAMED_OUTPUTS = 3
"""Limit of the outputs that a line on a difference names."""


@result(kw_only=True)
class Spread:
    """Spread of one number, or of one transform, over repeated runs."""

    name: str = field("Of what: a stage, or a cell and its result.")
    unit: str = field("Unit of the numbers.")
    runs: int = field("Number of runs that have it.")
    mean: float | None = field("Mean; null for a transform.")
    standard_deviation: float = field("Standard deviation of a run (n - 1).")
    largest: float = field("Largest distance of a run from the mean.")
    limit: float | None = field("Largest standard deviation that passes.", default=None)

    @property
    def check(self) -> Check | None:
        """Comparison with its limit; None without one."""
        if self.limit is None:
            return None
        return at_most(f"{self.name}, spread over {self.runs} runs", self.standard_deviation, self.limit, self.unit)

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail above the limit, undecided where so few runs may have been below it by chance."""
        if self.check is None or self.limit is None:
            return "pass"
        if not self.check.passed:
            return "fail"
        error = self.standard_deviation / math.sqrt(2 * (self.runs - 1))
        return "undecided" if self.standard_deviation + GUARD_BAND * error > self.limit else "pass"


@result(kw_only=True)
class FirstDifference:
    """First stage in which runs differ from the others."""

    runs: tuple[int, ...] = field("Numbers of the runs that differ, from 1.")
    reference: int = field("Number of the run that they differ from: the first of the largest group of equal ones.")
    stage: str = field("First stage with other outputs.")
    outputs: tuple[str, ...] = field("Names of its outputs that differ: cells, datasets.")

    def __str__(self) -> str:
        who = f"run {self.runs[0]} differs" if len(self.runs) == 1 else f"runs {number_ranges(self.runs)} differ"
        names, more = ", ".join(self.outputs[:MAX_NAMED_OUTPUTS]), len(self.outputs) - MAX_NAMED_OUTPUTS
        rest = f" and {count_of(more, 'more output')}" if more > 0 else ""
        return f"{who} from run {self.reference} from the stage {self.stage} on: {shorten(names, 200)}{rest}"


def number_ranges(numbers: Sequence[int]) -> str:
    """Return rising numbers, with consecutive ones as ranges: ``2-5, 9``."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][-1] + 1:
            ranges[-1].append(number)
        else:
            ranges.append([number])
    return ", ".join(str(each[0]) if len(each) == 1 else f"{each[0]}-{each[-1]}" for each in ranges)


def stage_times(runs: Sequence[Repetition]) -> tuple[Spread, ...]:
    """Return the spread of the time of each stage, and of the whole run."""
    times: dict[str, list[float]] = defaultdict(list)
    for run in runs:
        for stage, seconds in run.seconds.items():
            times[stage].append(seconds)
    whole = [run.whole_seconds for run in runs]
    return tuple(_spread_of(name, "s", values) for name, values in (*times.items(), ("whole run", whole)) if values)


def spreads_of_results(runs: Sequence[Repetition], limits: MaxSpread | None) -> tuple[Spread, ...]:
    """Return the spread of every number and transform that at least two runs have."""
    limit_of_unit = limits.limit_of_unit if limits else {}
    numbers: dict[tuple[str, str], list[float]] = defaultdict(list)
    poses: dict[str, list[Array]] = defaultdict(list)
    for run in runs:
        for key, number in run.numbers.items():
            numbers[key].append(number)
        for name, T in run.poses.items():
            poses[name].append(T)
    found = [_spread_of(name, unit, each, limit_of_unit.get(unit)) for (name, unit), each in numbers.items()]
    found += [
        spread for name, each in poses.items() for spread in _spreads_of_poses(name, np.stack(each), limit_of_unit)
    ]
    return tuple(spread for spread in found if spread.runs > 1)


def _spread_of(name: str, unit: str, values: Sequence[float], limit: float | None = None) -> Spread:
    mean = values[0] if len(set(values)) == 1 else fmean(values)  # equal to the last bit: no rounding of a sum
    return Spread(
        name=name,
        unit=unit,
        runs=len(values),
        mean=mean,
        standard_deviation=stdev(values, mean) if len(values) > 1 else 0.0,
        largest=max(abs(value - mean) for value in values),
        limit=limit,
    )


def _spreads_of_poses(name: str, T: Array, limit_of_unit: Mapping[str, float]) -> Iterator[Spread]:
    """Yield the spreads of transforms (n, 4, 4) in mm and degrees, by their distances from the mean transform."""
    equal = bool((T[0] == T).all())
    R = T[:, :3, :3]
    mean = R[0] @ rotations.exp(rotations.log(R[0].T @ R).mean(axis=0))
    lengths = 1e3 * np.linalg.norm(T[:, :3, 3] - T[:, :3, 3].mean(axis=0), axis=-1)
    angles = np.degrees(rotations.angle(mean.T @ R))
    for unit, distances in (("mm", lengths), ("deg", angles)):
        distances = np.zeros(len(T)) if equal else distances
        yield Spread(
            name=name,
            unit=unit,
            runs=len(T),
            mean=None,
            standard_deviation=float(np.sqrt((distances**2).sum() / max(len(T) - 1, 1))),
            largest=float(distances.max()),
            limit=limit_of_unit.get(unit),
        )


def first_differences(runs: Sequence[Repetition]) -> tuple[FirstDifference, ...]:
    """Return from which stage on complete runs differ from most others, those of one kind together.

    Outputs that no two of several runs have in common, such as files that name their time, are told by themselves: they
    would hide what else differs.
    """
    outputs = {number: run.outputs for number, run in enumerate(runs, start=1) if run.cut_short is None}
    if len(outputs) < 2:
        return ()
    unlike = _unlike_in_all(tuple(outputs.values()))
    found = _grouped_differences({number: _picked(each, unlike) for number, each in outputs.items()})
    rest = {number: _picked(each, unlike, inside=False) for number, each in outputs.items()}
    return (*found, *_grouped_differences(rest))


def _unlike_in_all(outputs: Sequence[Outputs]) -> frozenset[tuple[str, str]]:
    """Return stage and name of the outputs that differ between all runs, if these are more than two."""
    keys = {(stage, name) for each in outputs for stage, names in each.items() for name in names}
    hashes = {key: {each.get(key[0], {}).get(key[1]) for each in outputs} for key in keys}
    return frozenset(key for key, found in hashes.items() if len(found) == len(outputs) > 2)


def _picked(outputs: Outputs, keys: Collection[tuple[str, str]], *, inside: bool = True) -> Outputs:
    """Return the outputs of these stages and names, or all others."""
    return {
        stage: {name: found for name, found in each.items() if ((stage, name) in keys) == inside}
        for stage, each in outputs.items()
    }


def _grouped_differences(outputs: Mapping[int, Outputs]) -> Iterator[FirstDifference]:
    keys = {
        number: frozenset((stage, name, found) for stage, names in each.items() for name, found in names.items())
        for number, each in outputs.items()
    }
    [(most, _)] = Counter(keys.values()).most_common(1)
    reference = next(number for number, key in keys.items() if key == most)
    groups: dict[tuple[str, tuple[str, ...]], list[int]] = defaultdict(list)
    for number, key in keys.items():
        if key != most:
            groups[_first_difference(outputs[number], outputs[reference])].append(number)
    for (stage, names), numbers in groups.items():
        yield FirstDifference(runs=tuple(numbers), reference=reference, stage=stage, outputs=names)


def _first_difference(run: Outputs, reference: Outputs) -> tuple[str, tuple[str, ...]]:
    """Return the first stage whose outputs differ, and their names."""
    for stage in dict.fromkeys((*reference, *run)):
        one, other = run.get(stage, {}), reference.get(stage, {})
        if names := tuple(name for name in dict.fromkeys((*other, *one)) if one.get(name) != other.get(name)):
            return stage, names
    raise AssertionError("the runs have the same outputs")


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
