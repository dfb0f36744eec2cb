"""Convergence map of one system and one kind of initial guess: the share that converges, by noise; and all of a run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product, takewhile

from calibration.base import ExitCode, exit_code_of
from calibration.base.records import computed, field, result
from calibration.ci.report import Check, Verdict, at_least, verdict_of
from calibration.ci.report.junit import ErrorCode
from calibration.pipeline.matrix.cell_result import OUR_METHOD, CellResult
from calibration.pipeline.system import NoiseGrid

Noise = tuple[float, float]
"""Translation (m) and rotation (rad)."""


@result
class LostStart:
    """Initial guess that does not converge."""

    seed: int | None = field("Seed of the noise.")
    reasons: tuple[str, ...] = field("Reasons of the failure.")
    error: ErrorCode | None = field("2 or 3 if it could not run.")


@result
class Pair:
    """Cells of one pair of noises, one per seed."""

    translation_noise: float = field("Of the starts.", unit="m")
    rotation_noise: float = field("Of the starts.", unit="rad")
    cells: tuple[CellResult, ...]

    @property
    @computed()
    def starts(self) -> int:
        """Number of initial guesses."""
        return len(self.cells)

    @property
    @computed()
    def converged(self) -> int:
        """Number of those that converge."""
        return sum(cell.verdict != "fail" for cell in self.cells)

    @property
    def always(self) -> bool:
        """Whether all of them converge."""
        return self.converged == self.starts

    @property
    @computed()
    def share(self) -> float:
        """Share that converges, 0 to 1, rounded down: 1 only if all converge."""
        return self.converged * 1_000_000 // self.starts / 1_000_000

    @property
    def percent(self) -> str:
        """Share in whole percent; 100 only if all converge, 0 only if none does."""
        if 0 < self.converged < self.starts:
            return str(min(max(round(100 * self.converged / self.starts), 1), 99))
        return "100" if self.always else "0"

    @property
    @computed("lost")
    def lost_starts(self) -> tuple[LostStart, ...]:
        """Initial guesses that do not converge."""
        return tuple(LostStart(cell.seed, cell.reasons, cell.error) for cell in self.cells if cell.verdict == "fail")

    @property
    def lost(self) -> tuple[int, ...]:
        """Seeds of the initial guesses that do not converge."""
        return tuple(cell.seed for cell in self.lost_starts if cell.seed is not None)

    @property
    def reason(self) -> str:
        """First reason of the first one that does not converge; empty if all do."""
        return next((cell.reasons[0] for cell in self.lost_starts if cell.reasons), "")


@result
class NoisePair:
    """Translation and rotation noise at once."""

    translation_noise: float = field("Of the start.", unit="m")
    rotation_noise: float = field("Of the start.", unit="rad")


@result
class Largest:
    """Largest noise levels up to which every initial guess converges; null if the one without noise does not."""

    translation: float | None = field("With no rotation noise.", unit="m", key="translation_noise")
    rotation: float | None = field("With no translation noise.", unit="rad", key="rotation_noise")
    diagonal: Noise | None
    """Both at once, in proportion to their largest levels: every pair of levels up to it converges."""

    @property
    @computed("diagonal")
    def diagonal_pair(self) -> NoisePair | None:
        """Largest noises of both kinds at once, in the ratio of the levels: every pair up to them converges."""
        return None if self.diagonal is None else NoisePair(*self.diagonal)

    @classmethod
    def of_all(cls, several: Sequence["Largest"]) -> "Largest":
        """Return the minimum of several."""
        diagonals = [largest.diagonal for largest in several]
        translation, rotation = (least([noise and noise[axis] for noise in diagonals]) for axis in (0, 1))
        return cls(
            least([largest.translation for largest in several]),
            least([largest.rotation for largest in several]),
            None if translation is None or rotation is None else (translation, rotation),
        )


def least(values: Sequence[float | None]) -> float | None:
    """Return the smallest of the values; None if one of them is missing, or all."""
    known = [value for value in values if value is not None]
    return min(known) if known and len(known) == len(values) else None


@result
class ConvergenceMap:
    """Convergence of one system, calibrated by one method from one kind of initial guess."""

    system: str = field("Its name.")
    method: str = field("calibration-ci, or software: the team's own.")
    start: str = field("given or linear.")
    judged: bool = field(
        "Whether it counts for the verdict; our engine as a reference for the team's software does not."
    )
    translations: tuple[float, ...]
    """Translation levels, m, from 0."""
    rotations: tuple[float, ...]
    """Rotation levels, rad, from 0."""
    pairs: Mapping[Noise, Pair]
    """Pairs by noise; every combination of the levels."""

    @property
    @computed("pairs")
    def all_pairs(self) -> tuple[Pair, ...]:
        """Pairs in order, every combination of the levels."""
        return tuple(self.pairs.values())

    @property
    def name(self) -> str:
        """Name in messages and tables."""
        method = () if self.method == OUR_METHOD and self.judged else (self.method,)
        return ", ".join((self.system, *method, self.start))

    @cached_property
    @computed()
    def largest(self) -> Largest:
        """Largest noise levels up to which everything converges."""
        return Largest(
            _last_good_level(self.translations, lambda t: self.pairs[t, 0.0].always),
            _last_good_level(self.rotations, lambda r: self.pairs[0.0, r].always),
            self._largest_diagonal(),
        )

    def _largest_diagonal(self) -> Noise | None:
        """Return the corner of the largest box, in the sweep's proportions, in which every pair converges."""
        shares = {
            _share_of_last_level(level, levels) for levels in (self.translations, self.rotations) for level in levels
        }

        def box(share: float) -> tuple[list[float], list[float]]:
            axes = (self.translations, self.rotations)
            t, r = ([level for level in levels if _share_of_last_level(level, levels) <= share] for levels in axes)
            return t, r

        def converges(share: float) -> bool:
            t, r = box(share)
            return all(self.pairs[pair].always for pair in product(t, r))

        share = _last_good_level(sorted(shares), converges)
        if share is None:
            return None
        t, r = box(share)
        return t[-1], r[-1]

    @property
    def error(self) -> ExitCode | None:
        """Exit code of an infrastructure failure anywhere, or of bad input without noise, which cannot be its cause."""
        errors = [cell.error for cell in self.pairs[0.0, 0.0].cells]
        errors += [
            cell.error for pair in self.pairs.values() for cell in pair.cells if cell.error == ExitCode.INFRASTRUCTURE
        ]
        return max((error for error in errors if error is not None), default=None)


def maps_of(cells: Sequence[CellResult], noise: NoiseGrid) -> tuple[ConvergenceMap, ...]:
    """Return the maps of a sweep's cells, in the order of their first cells.

    Args:
        cells: in any order; every combination of the grid for every map.
        noise: the grid; its levels begin with 0.
    """
    cells_of_map: dict[tuple[str, str, str], dict[tuple[float | None, float | None, int | None], CellResult]] = {}
    for cell in cells:
        by_noise = cells_of_map.setdefault((cell.system, cell.method, cell.start or ""), {})
        by_noise[cell.translation_noise, cell.rotation_noise, cell.seed] = cell
    systems = list(dict.fromkeys(system for system, _, _ in cells_of_map))
    with_software = {system for system, method, _ in cells_of_map if method != OUR_METHOD}
    return tuple(
        ConvergenceMap(
            system,
            method,
            start,
            method != OUR_METHOD or system not in with_software,
            noise.translations,
            noise.rotations,
            {
                (t, r): Pair(t, r, tuple(by_noise[t, r, seed] for seed in noise.seeds))
                for t, r in product(noise.translations, noise.rotations)
            },
        )
        for (system, method, start), by_noise in sorted(
            cells_of_map.items(), key=lambda item: systems.index(item[0][0])
        )
    )


def _last_good_level(levels: Sequence[float], good: Callable[[float], bool]) -> float | None:
    """Return the last level before the first that is not good."""
    return next(reversed(list(takewhile(good, levels))), None)


def _share_of_last_level(level: float, levels: Sequence[float]) -> float:
    """Return the ratio of a level to the last one, rounded, so that equal ratios of two axes are equal numbers."""
    return round(level / levels[-1], 9) if levels[-1] else 0.0


@dataclass(frozen=True)
class Minimums:
    """Required noise up to which every initial guess converges; None for no requirement."""

    translation: float | None = None
    """m, without rotation noise."""
    rotation: float | None = None
    """rad, without translation noise."""


@result
class ConvergenceResults:
    """Results of convergence."""

    noise: NoiseGrid = field("Swept noise: every combination.", key="grid")
    maps: tuple[ConvergenceMap, ...] = field("One for each system, method and kind of start.")
    minimums: Minimums = Minimums()
    figures: tuple[str, ...] = field("Files; none where matplotlib is not installed.", default=())
    notes: tuple[str, ...] = field("Notes on the files.", default=())

    @property
    def judged(self) -> list[ConvergenceMap]:
        """The maps that count for the verdict."""
        return [map_ for map_ in self.maps if map_.judged]

    @property
    @computed()
    def checks(self) -> tuple[Check, ...]:
        """Largest noises against the required ones."""
        return tuple(check for map_ in self.judged for check in _checks_of_minimums(map_, self.minimums))

    @property
    def reasons(self) -> list[str]:
        """Reasons of a fail verdict; empty if it is pass."""
        lost = [reason for each in self.judged if (reason := without_noise(each))]
        failed = [cell for each in self.judged for pair in each.pairs.values() for cell in pair.cells]
        world = [f"{cell.name}: {cell.reasons[0]}" for cell in failed if cell.error == ExitCode.INFRASTRUCTURE]
        return [*lost, *world, *(str(check) for check in self.checks if not check.passed)]

    @property
    def verdict(self) -> Verdict:
        """Pass if every map converges without noise, and up to the required noise."""
        return verdict_of(bool(self.judged) and not self.reasons)

    @property
    def exit_code(self) -> ExitCode:
        """2 or 3 after bad input or an infrastructure failure, else the verdict's."""
        return exit_code_of(self.verdict == "pass", (each.error for each in self.judged))

    @property
    @computed()
    def largest(self) -> Largest:
        """Minimum over the judged maps."""
        return Largest.of_all([each.largest for each in self.judged])


def without_noise(map_: ConvergenceMap) -> str:
    """Return the reason why a map does not converge even without noise; empty if it does."""
    pair = map_.pairs[0.0, 0.0]
    if pair.always:
        return ""
    return f"{map_.name}: the start without noise does not converge: {pair.reason or 'for no reason that is known'}"


def _checks_of_minimums(map_: ConvergenceMap, minimums: Minimums) -> list[Check]:
    limits = (
        ("translation", map_.largest.translation, minimums.translation, "m"),
        ("rotation", map_.largest.rotation, minimums.rotation, "rad"),
    )
    return [
        at_least(f"{map_.name}: largest {kind} noise that always converges", largest, minimum, unit)
        for kind, largest, minimum, unit in limits
        if minimum is not None
    ]
