"""What a sweep found of one system from one kind of start: the share that converges, by the noise of the start."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product, takewhile

from calibration.errors import ExitCode
from calibration.pipeline.matrix.cell import OUR_METHOD, CellResult
from calibration.pipeline.system import NoiseGrid

Noise = tuple[float, float]
"""Translation (m) and rotation (rad)."""


@dataclass(frozen=True)
class Pair:
    """The starts, one a seed, with one pair of noises."""

    cells: tuple[CellResult, ...]

    @property
    def converged(self) -> int:
        """How many do."""
        return sum(cell.verdict == "pass" for cell in self.cells)

    @property
    def always(self) -> bool:
        """Whether all of them do."""
        return self.converged == len(self.cells)

    @property
    def share(self) -> float:
        """From 0 to 1."""
        return self.converged / len(self.cells)

    @property
    def percent(self) -> str:
        """The share in whole percent; 100 only where all converge, 0 only where none does."""
        if 0 < self.converged < len(self.cells):
            return str(min(max(round(100 * self.share), 1), 99))
        return "100" if self.always else "0"

    @property
    def lost(self) -> tuple[int, ...]:
        """The seeds of those that do not."""
        return tuple(cell.seed for cell in self.cells if cell.verdict == "fail" and cell.seed is not None)

    @property
    def reason(self) -> str:
        """The first reason of the first start that does not converge; empty where all do."""
        return next((cell.reasons[0] for cell in self.cells if cell.verdict == "fail" and cell.reasons), "")


@dataclass(frozen=True)
class Largest:
    """The largest levels up to which every start of the sweep converges; None where not even the one without noise."""

    translation: float | None
    """m, with no rotation noise."""
    rotation: float | None
    """rad, with no translation noise."""
    diagonal: Noise | None
    """Both at once, grown from 0 in proportion to their last levels: every pair of levels up to it converges."""


@dataclass(frozen=True)
class ConvergenceMap:
    """One system, calibrated by one method from one kind of start."""

    system: str
    method: str
    start: str
    judged: bool
    """Whether it has a part in the verdict; our engine beside the team's software has none."""
    translations: tuple[float, ...]
    """The levels, m, from 0."""
    rotations: tuple[float, ...]
    """The levels, rad, from 0."""
    pairs: Mapping[Noise, Pair]
    """By noise; every combination of the levels."""

    @property
    def name(self) -> str:
        """What messages and tables call it."""
        method = () if self.method == OUR_METHOD and self.judged else (self.method,)
        return ", ".join((self.system, *method, self.start))

    @cached_property
    def largest(self) -> Largest:
        """Up to where every start converges."""
        return Largest(
            _last(self.translations, lambda t: self.pairs[t, 0.0].always),
            _last(self.rotations, lambda r: self.pairs[0.0, r].always),
            self._diagonal(),
        )

    def _diagonal(self) -> Noise | None:
        """The far corner of the largest box of the sweep's proportions in which every pair converges."""
        shares = {_share(level, levels) for levels in (self.translations, self.rotations) for level in levels}

        def box(share: float) -> tuple[list[float], list[float]]:
            axes = (self.translations, self.rotations)
            t, r = ([level for level in levels if _share(level, levels) <= share] for levels in axes)
            return t, r

        def converges(share: float) -> bool:
            t, r = box(share)
            return all(self.pairs[pair].always for pair in product(t, r))

        share = _last(sorted(shares), converges)
        if share is None:
            return None
        t, r = box(share)
        return t[-1], r[-1]

    @property
    def error(self) -> ExitCode | None:
        """What could not be done: a failing world anywhere, bad input where there is no noise to blame for it."""
        errors = [cell.error for cell in self.pairs[0.0, 0.0].cells]
        errors += [cell.error for pair in self.pairs.values() for cell in pair.cells if cell.error == ExitCode.WORLD]
        return max((error for error in errors if error is not None), default=None)


def maps_of(cells: Sequence[CellResult], noise: NoiseGrid) -> tuple[ConvergenceMap, ...]:
    """The maps of a sweep's cells, system by system, in the order in which they first come.

    Args:
        cells: in any order; every combination of the grid for every map.
        noise: its levels begin with 0.
    """
    found: dict[tuple[str, str, str], dict[tuple[float | None, float | None, int | None], CellResult]] = {}
    for cell in cells:
        of = found.setdefault((cell.system, cell.method, cell.start or ""), {})
        of[cell.translation_noise, cell.rotation_noise, cell.seed] = cell
    systems = list(dict.fromkeys(system for system, _, _ in found))
    with_software = {system for system, method, _ in found if method != OUR_METHOD}
    return tuple(
        ConvergenceMap(
            system,
            method,
            start,
            method != OUR_METHOD or system not in with_software,
            noise.translations,
            noise.rotations,
            {
                (t, r): Pair(tuple(of[t, r, seed] for seed in noise.seeds))
                for t, r in product(noise.translations, noise.rotations)
            },
        )
        for (system, method, start), of in sorted(found.items(), key=lambda item: systems.index(item[0][0]))
    )


def _last(levels: Sequence[float], good: Callable[[float], bool]) -> float | None:
    """The last of the levels before the first that is not good."""
    return next(reversed(list(takewhile(good, levels))), None)


def _share(level: float, levels: Sequence[float]) -> float:
    """Of the last level; rounded, so that the same share of two axes is the same number."""
    return round(level / levels[-1], 9) if levels[-1] else 0.0
