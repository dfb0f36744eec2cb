"""Many worlds of one system: each is collected, calibrated and judged, and the report over all of them."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from calibration.errors import ExitCode, InputError
from calibration.files import write_atomically
from calibration.pipeline.collection.request import ScenarioRequest
from calibration.pipeline.collection.results import Check, CollectionChecks, truth_checks
from calibration.report import Outcome
from calibration.simulation.scenarios.figure import figure
from calibration.simulation.scenarios.report import Report, document, markdown, table
from calibration.simulation.scenarios.result import ScenarioResult

FILE, TABLE_FILE, SUMMARY_FILE, FIGURE_FILE = "results.json", "worlds.csv", "summary.md", "worlds.png"
JUNIT_FILE = "junit.xml"
REPORT_FILES = (FILE, TABLE_FILE, SUMMARY_FILE, FIGURE_FILE, JUNIT_FILE)
WORST_SHOWN = 5


@dataclass(frozen=True)
class ScenarioResults:
    """What came of the worlds, and the verdict on them."""

    system: str
    request: ScenarioRequest
    report: Report
    notes: tuple[str, ...] = field(default=())
    """What could not be made, and why."""
    errors: Mapping[str, ExitCode] = field(default_factory=dict)
    """The worlds that could not be run, by id: because of bad input (2) or a failing world (3). They have failed."""

    @cached_property
    def failed(self) -> dict[str, list[str]]:
        """The worlds that do not pass, by id, and why."""
        checks = self.request.collection.checks
        return {result.id: why for result in self.report.results if (why := world_reasons(result, checks))}

    @property
    def success_rate(self) -> float:
        """The share of the worlds that pass."""
        return round(1 - len(self.failed) / len(self.report.results), 6)

    @property
    def reasons(self) -> list[str]:
        """Why the verdict is fail; nothing where it is pass."""
        check = Check("success rate", self.success_rate, self.request.minimum_success_rate, at_least=True)
        return [] if check.passed else [str(check)]

    @property
    def verdict(self) -> Literal["pass", "fail"]:
        """Pass when enough worlds pass."""
        return "fail" if self.reasons else "pass"

    @property
    def exit_code(self) -> ExitCode:
        """The verdict's; where it is fail and some could not be run, that of these: who knows what they would be."""
        if self.verdict == "pass":
            return ExitCode.PASS
        return max(self.errors.values(), default=ExitCode.FAIL)

    @property
    def title(self) -> str:
        """Such as "100 worlds of t2rgb"."""
        worlds = len(self.report.results)
        return f"{worlds} world{'' if worlds == 1 else 's'} of {self.system}"


def world_reasons(result: ScenarioResult, checks: CollectionChecks) -> list[str]:
    """Why a world does not pass; nothing where it does."""
    if not result.converged:
        return list(result.reasons) or ["it does not calibrate"]
    limits = [Check("collections", result.kept, checks.minimum_collections, at_least=True)]
    if checks.minimum_detection_rate is not None:
        for name, rate in (result.detection or {}).items():
            limits.append(Check(f"detection rate of {name}", rate, checks.minimum_detection_rate, at_least=True))
    limits += truth_checks(result, checks)
    return [str(check) for check in limits if not check.passed]


def write_scenario_results(results: ScenarioResults, output: Path) -> ScenarioResults:
    """Write the report; the results with a note where there can be no figure.

    Raises:
        WorldError: a file cannot be written.
    """
    checks = results.request.collection.checks
    try:
        drawn = figure(results.report, results.title, checks.max_translation_mm, checks.max_rotation_deg)
        write_atomically(output / FIGURE_FILE, drawn)
    except InputError as error:  # what draws it is not installed
        results = replace(results, notes=(str(error),))
    text = json.dumps(scenario_document(results), indent=1, allow_nan=False) + "\n"
    write_atomically(output / FILE, text)
    write_atomically(output / TABLE_FILE, table(results.report.results))
    write_atomically(output / SUMMARY_FILE, scenario_markdown(results))
    write_atomically(output / JUNIT_FILE, _junit(results))
    return results


def scenario_document(results: ScenarioResults) -> dict[str, Any]:
    """The content of ``results.json``."""
    return {
        "schema": 1,
        "verdict": results.verdict,
        "system": results.system,
        "seed": results.request.collection.seed,
        "success_rate": results.success_rate,
        "reasons": results.reasons,
        "failed": results.failed,
        "errors": dict(results.errors),
        **document(results.report, WORST_SHOWN),
    }


def scenario_markdown(results: ScenarioResults) -> str:
    """The report for people."""
    text = markdown(
        results.report, f"{results.title}: {results.verdict}", lambda each: replay(results, each), WORST_SHOWN
    )
    return "\n\n".join([*results.reasons, text]) + "\n"


def replay(results: ScenarioResults, scenario: str) -> str:
    """The command that collects one of the worlds."""
    of, request = results.request.collection, results.request
    words = ["calibration", "collect-data-sim", "--system", str(of.system or results.system)]
    words += [*request.applications, "--scenario", scenario]
    options = (("scenario-set", request.scenario_set), ("robot", of.robot), ("config", of.configuration))
    for option, value in (*options, ("motion", of.motion)):
        words += [f"--{option}", str(value)] if value is not None else []
    return shlex.join([*words, "--output", scenario])


def _junit(results: ScenarioResults) -> str:
    from calibration.report.junit import junit_xml  # XML is slow to import

    outcomes = [
        Outcome(
            name=result.id,
            group=results.system,
            reasons=tuple(results.failed.get(result.id, ())),
            error=results.errors.get(result.id),
        )
        for result in results.report.results
    ]
    return junit_xml({f"worlds of {results.system}": outcomes})
