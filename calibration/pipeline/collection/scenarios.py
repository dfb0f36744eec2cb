"""Many worlds of one system: each is collected, calibrated and judged, and the report over all of them."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from calibration.errors import ExitCode, InputError
from calibration.files import write_atomically
from calibration.pipeline.collection.collecting import (
    CollectionRequest,
    Done,
    collect_play,
    read_or_generate,
    require_opencv,
)
from calibration.pipeline.collection.in_containers import ContainerRequest
from calibration.pipeline.collection.results import Check, CollectionChecks, CollectionResults, truth_checks
from calibration.pipeline.collection.world_file import write_world
from calibration.report import Outcome

if TYPE_CHECKING:
    from calibration.simulation.motion.sequence import Motion
    from calibration.simulation.scenarios.report import Report
    from calibration.simulation.scenarios.result import ScenarioResult
    from calibration.simulation.system import System

FILE, TABLE_FILE, SUMMARY_FILE, FIGURE_FILE = "results.json", "worlds.csv", "summary.md", "worlds.png"
JUNIT_FILE = "junit.xml"
REPORT_FILES = (FILE, TABLE_FILE, SUMMARY_FILE, FIGURE_FILE, JUNIT_FILE)
MAX_SCENARIOS = 100_000
WORST_SHOWN = 5


@dataclass(frozen=True)
class ScenarioRequest:
    """Which worlds are run."""

    collection: CollectionRequest | ContainerRequest
    """The system, the seed of the worlds, and what each of them has to keep to; a motion, if all have the same."""
    scenario_set: Path | None
    """Of our own simulation's worlds; None for the team's applications, which know themselves what varies."""
    count: int
    minimum_success_rate: float = 1.0
    """The share of the worlds that has to pass."""
    applications: tuple[str, ...] = ()
    """The options of the command that say what the team's applications are."""

    @property
    def own(self) -> CollectionRequest:
        """The collection by our own simulation."""
        if not isinstance(self.collection, CollectionRequest):
            raise AssertionError("the team's applications collect")
        return self.collection

    @property
    def theirs(self) -> ContainerRequest:
        """The collection by the team's applications."""
        if not isinstance(self.collection, ContainerRequest):
            raise AssertionError("our own simulation collects")
        return self.collection

    @property
    def set_file(self) -> Path:
        """The scenario set of our own simulation."""
        if self.scenario_set is None:
            raise AssertionError("the worlds of our own simulation are of a set")
        return self.scenario_set


@dataclass(frozen=True)
class ScenarioResults:
    """What came of the worlds, and the verdict on them."""

    system: str
    request: ScenarioRequest
    report: "Report"
    notes: tuple[str, ...] = field(default=())
    """What could not be made, and why."""
    errors: Mapping[str, ExitCode] = field(default_factory=dict)
    """The worlds that could not be run, by id: because of bad input (2) or a failing world (3). They have failed."""

    @cached_property
    def failed(self) -> "dict[str, list[str]]":
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


def world_reasons(result: "ScenarioResult", checks: CollectionChecks) -> list[str]:
    """Why a world does not pass; nothing where it does."""
    if not result.converged:
        return list(result.reasons) or ["it does not calibrate"]
    limits = [Check("collections", result.kept, checks.minimum_collections, at_least=True)]
    if checks.minimum_detection_rate is not None:
        for name, rate in (result.detection or {}).items():
            limits.append(Check(f"detection rate of {name}", rate, checks.minimum_detection_rate, at_least=True))
    limits += truth_checks(result, checks)
    return [str(check) for check in limits if not check.passed]


def run_worlds(
    request: ScenarioRequest,
    output: Path,
    jobs: int | None = None,
    begin: Callable[[str, int], None] | None = None,
    done: "Callable[[ScenarioResult], None] | None" = None,
) -> ScenarioResults:
    """Run the worlds 0 to count - 1 of a seed, and leave the report in a folder.

    Args:
        request: which worlds.
        output: the folder for results, table, summary and figure.
        jobs: processes; None for one a core.
        begin: called with the system's name and the number of worlds when everything was read and checked.
        done: called after each world.

    Raises:
        InputError: an input is wrong.
        WorldError: a file cannot be written, or a process died.
    """
    require_opencv()
    from calibration.execution.tasks import run_tasks
    from calibration.simulation.collection.collecting import single_threaded_opencv
    from calibration.simulation.scenarios.report import Report
    from calibration.simulation.scenarios.run import scenario_task
    from calibration.simulation.scenarios.scenario_set import read_scenario_set
    from calibration.simulation.system import read_system

    of = request.own
    system = read_system(of.system, of.robot, of.configuration)
    worlds = read_scenario_set(request.set_file, system)
    motion = None if of.motion is None else read_or_generate(of, system)
    if begin:
        begin(system.name, request.count)
    tasks = [
        scenario_task(worlds, worlds.scenario(of.seed, index), motion, of.requirements)
        for index in range(request.count)
    ]
    with single_threaded_opencv():
        found = list(
            run_tasks(tasks, workers=jobs, done=lambda _count, _total, result: done(result) if done else None).values()
        )
    results = ScenarioResults(system.name, request, Report(found))
    return write_scenario_results(results, output)


def collect_world(
    request: CollectionRequest,
    scenario_set: Path,
    scenario: str,
    output: Path,
    overwrite: bool = False,
    jobs: int | None = None,
    begin: "Callable[[System, Motion], None] | None" = None,
    done: Done | None = None,
) -> CollectionResults:
    """Collect one world alone, with all its images, as `calibration.pipeline.collection.collect_dataset` does.

    What came of it stands in ``world.json`` too, also where no motion is found for it.

    Args:
        request: the system, and what the dataset has to keep to; the id says the seed.
        scenario_set: the YAML file.
        scenario: the id of the world.
        output: the folder.
        overwrite: whether a dataset that it has is replaced.
        jobs: processes; None for one a core.
        begin: called when everything was read and checked.
        done: called after each pose.

    Raises:
        InputError, WorldError: as `collect_dataset`.
    """
    require_opencv()
    from calibration.simulation.collection.checks import Requirements
    from calibration.simulation.collection.dataset_folder import refuse_existing
    from calibration.simulation.scenarios.run import prepare, seen, unseen
    from calibration.simulation.scenarios.scenario import parse_id
    from calibration.simulation.scenarios.scenario_set import read_scenario_set
    from calibration.simulation.system import read_system

    refuse_existing(output, overwrite)
    seed, index = parse_id(scenario)
    system = read_system(request.system, request.robot, request.configuration)
    worlds = read_scenario_set(scenario_set, system)
    motion = None if request.motion is None else read_or_generate(replace(request, seed=seed), system)
    world = worlds.scenario(seed, index)
    result = unseen(worlds, world, motion)
    stillness = (request.requirements or Requirements()).stillness
    try:
        played = prepare(worlds, world, motion)
    except InputError as error:
        write_world(replace(result, reasons=(str(error),)), stillness, output)
        raise
    if begin:
        begin(played.system, played.motion)
    found = collect_play(played, request.requirements, request.checks, output, overwrite, jobs, done, result.hash)
    write_world(seen(result, found.records, found.proof), stillness, output)
    return found


def write_scenario_results(results: ScenarioResults, output: Path) -> ScenarioResults:
    """Write the report; the results with a note where there can be no figure.

    Raises:
        WorldError: a file cannot be written.
    """
    from calibration.simulation.scenarios.figure import figure
    from calibration.simulation.scenarios.report import table

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
    from calibration.simulation.scenarios.report import document

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
    from calibration.simulation.scenarios.report import markdown

    text = markdown(
        results.report, f"{results.title}: {results.verdict}", lambda each: replay(results, each), WORST_SHOWN
    )
    return "\n\n".join([*results.reasons, text]) + "\n"


def replay(results: ScenarioResults, scenario: str) -> str:
    """The command that collects one of the worlds."""
    import shlex

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
