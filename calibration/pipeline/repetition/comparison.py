"""Runs of the same work beside each other: how much their numbers vary, and the first stage whose outputs differ."""

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from statistics import fmean, stdev

import numpy as np

from calibration.base.arrays import Array
from calibration.base.records import computed, field, result
from calibration.base.text import count_of, shorten
from calibration.base.verdict import Check, Verdict, at_most
from calibration.engine.geometry import rotations
from calibration.pipeline.repetition.repetition import Outputs, Repetition
from calibration.pipeline.repetition.settings import MaxSpread

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
