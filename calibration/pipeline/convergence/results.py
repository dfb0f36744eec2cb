"""What a sweep of the start's noise found, and its verdict."""

from collections.abc import Sequence
from dataclasses import dataclass

from calibration.errors import ExitCode, exit_code_of
from calibration.pipeline.convergence.convergence_map import ConvergenceMap, Noise
from calibration.pipeline.system import NoiseGrid
from calibration.report import Check, Verdict, at_least, verdict_of


@dataclass(frozen=True)
class Minimums:
    """The noise up to which every start has to converge; None where nothing is asked."""

    translation: float | None = None
    """m, with no rotation noise."""
    rotation: float | None = None
    """rad, with no translation noise."""


@dataclass(frozen=True)
class ConvergenceResults:
    """What came of a sweep."""

    noise: NoiseGrid
    maps: tuple[ConvergenceMap, ...]
    minimums: Minimums = Minimums()

    @property
    def judged(self) -> list[ConvergenceMap]:
        """The maps that have a part in the verdict."""
        return [each for each in self.maps if each.judged]

    @property
    def checks(self) -> list[Check]:
        """The largest noises against what is asked."""
        return [check for each in self.judged for check in _checks(each, self.minimums)]

    @property
    def reasons(self) -> list[str]:
        """Why the verdict is fail; nothing where it is pass."""
        lost = [reason for each in self.judged if (reason := without_noise(each))]
        failed = [cell for each in self.judged for pair in each.pairs.values() for cell in pair.cells]
        world = [f"{cell.name}: {cell.reasons[0]}" for cell in failed if cell.error == ExitCode.WORLD]
        return [*lost, *world, *(str(check) for check in self.checks if not check.passed)]

    @property
    def verdict(self) -> Verdict:
        """Pass when every map converges without noise, and as far as is asked."""
        return verdict_of(bool(self.judged) and not self.reasons)

    @property
    def exit_code(self) -> ExitCode:
        """2 or 3 where something could not be done because of bad input or a failing world, else the verdict's."""
        return exit_code_of(self.verdict == "pass", (each.error for each in self.judged))

    @property
    def largest_translation(self) -> float | None:
        """The largest noise up to which every start of every map converges, m; None where one does not without."""
        return least([each.largest.translation for each in self.judged])

    @property
    def largest_rotation(self) -> float | None:
        """The same in rad."""
        return least([each.largest.rotation for each in self.judged])

    @property
    def largest_diagonal(self) -> Noise | None:
        """The same of both at once."""
        found = [each.largest.diagonal for each in self.judged]
        translation = least([noise[0] if noise else None for noise in found])
        rotation = least([noise[1] if noise else None for noise in found])
        return None if translation is None or rotation is None else (translation, rotation)


def least(values: Sequence[float | None]) -> float | None:
    """The smallest of the values; None where one of them is missing, or all."""
    known = [value for value in values if value is not None]
    return min(known) if known and len(known) == len(values) else None


def without_noise(of: ConvergenceMap) -> str:
    """Why a map does not even converge from the start without noise; empty where it does."""
    pair = of.pairs[0.0, 0.0]
    if pair.always:
        return ""
    return f"{of.name}: the start without noise does not converge: {pair.reason or 'for no reason that is known'}"


def _checks(of: ConvergenceMap, minimums: Minimums) -> list[Check]:
    asked = (
        ("translation", of.largest.translation, minimums.translation, "m"),
        ("rotation", of.largest.rotation, minimums.rotation, "rad"),
    )
    return [
        at_least(f"{of.name}: largest {what} noise that always converges", found, minimum, unit)
        for what, found, minimum, unit in asked
        if minimum is not None
    ]
