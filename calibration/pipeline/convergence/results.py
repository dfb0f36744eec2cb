"""Results of a sweep over the initial guess's noise, and its verdict."""

from dataclasses import dataclass

from calibration.base.errors import ExitCode, exit_code_of
from calibration.base.records import computed, field, result
from calibration.ci.report import Check, Verdict, at_least, verdict_of
from calibration.pipeline.convergence.convergence_map import ConvergenceMap, Largest
from calibration.pipeline.system import NoiseGrid


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
        return [each for each in self.maps if each.judged]

    @property
    @computed()
    def checks(self) -> tuple[Check, ...]:
        """Largest noises against the required ones."""
        return tuple(check for each in self.judged for check in _checks(each, self.minimums))

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


def without_noise(of: ConvergenceMap) -> str:
    """Return the reason why a map does not converge even without noise; empty if it does."""
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
