"""Results of many worlds of one system: each is collected, calibrated and judged; the verdict over all."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from calibration.errors import ExitCode
from calibration.pipeline.collection.request import ScenarioRequest
from calibration.pipeline.collection.results import CollectionChecks, truth_checks
from calibration.report import Verdict, at_least, count_of, verdict_of
from calibration.simulation.scenarios.scenario import ScenarioResult
from calibration.simulation.scenarios.statistics import Statistics


@dataclass(frozen=True)
class ScenarioResults:
    """What came of the worlds, and the verdict on them."""

    system: str
    request: ScenarioRequest
    statistics: Statistics
    errors: Mapping[str, ExitCode] = field(default_factory=dict)
    """The worlds that could not be run, by id: because of bad input (2) or a failing world (3). They have failed."""

    @cached_property
    def failed(self) -> dict[str, list[str]]:
        """The worlds that do not pass, by id, and why."""
        checks = self.request.collection.checks
        return {result.id: why for result in self.statistics.results if (why := world_reasons(result, checks))}

    @property
    def success_rate(self) -> float:
        """The share of the worlds that pass."""
        return round(1 - len(self.failed) / len(self.statistics.results), 6)

    @property
    def reasons(self) -> list[str]:
        """Why the verdict is fail; nothing where it is pass."""
        check = at_least("success rate", self.success_rate, self.request.minimum_success_rate)
        return [] if check.passed else [str(check)]

    @property
    def verdict(self) -> Verdict:
        """Pass if enough worlds pass."""
        return verdict_of(not self.reasons)

    @property
    def exit_code(self) -> ExitCode:
        """The verdict's; where it is fail and some could not be run, that of these: who knows what they would be."""
        if self.verdict == "pass":
            return ExitCode.PASS
        return max(self.errors.values(), default=ExitCode.FAIL)

    @property
    def title(self) -> str:
        """Such as "100 worlds of t2rgb"."""
        return f"{count_of(len(self.statistics.results), 'world')} of {self.system}"


def world_reasons(result: ScenarioResult, checks: CollectionChecks) -> list[str]:
    """Why a world does not pass; nothing where it does."""
    if not result.converged:
        return list(result.reasons) or ["it does not calibrate"]
    limits = [at_least("collections", result.kept, checks.minimum_collections)]
    if checks.minimum_detection_rate is not None:
        for name, rate in (result.detection or {}).items():
            limits.append(at_least(f"detection rate of {name}", rate, checks.minimum_detection_rate))
    limits += truth_checks(result, checks)
    return [str(check) for check in limits if not check.passed]
