"""Many scenarios of t2rgb: collected, calibrated, held against their truth."""

from collections.abc import Iterator
from functools import partial

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT
from benchmarks.timing import seconds
from calibration.ci.execution.tasks import Task, run_tasks, single_threaded_opencv
from calibration.robot.simulation.scenarios.run import run_scenario
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.scenario_set import read_scenario_set
from calibration.robot.simulation.scenarios.statistics import Statistics
from calibration.robot.simulation.system import read_system


def measure(quick: bool) -> Iterator[Row]:
    """Scenarios a second on all cores, and how far their calibrations are from the truth."""
    count = 10 if quick else 40
    scenarios = read_scenario_set(ROOT / "datasets" / "scenarios.yml", read_system(ROOT / "datasets" / "t2rgb"))
    results: list[ScenarioResult] = []

    def run() -> None:
        drawn = [scenarios.scenario(1, index) for index in range(count)]
        tasks = [Task.call(each.id, partial(run_scenario, scenarios, each)) for each in drawn]
        with single_threaded_opencv():
            results.extend(run_tasks(tasks).values())

    took = seconds(run)
    report = Statistics(results)
    errors = report.percentiles("translation_mm")
    note = f"{count} scenarios of t2rgb with 12 poses each"
    yield Row("scenarios/scenarios per second", count / took, "1/s", Bar(low=100 / 120), note)
    yield Row("scenarios/calibrate", 100 * len(report.calibrated) / count, "%", Bar(low=100))
    squares = [each.error_sigmas**2 for each in report.calibrated if each.error_sigmas is not None]
    mean = sum(squares) / max(1, len(squares))
    beyond = f"{len(report.beyond_error_bars)} findings; by the noise of the labels alone 24 and 7, of 20"
    yield Row("scenarios/mean squared error in stated deviations", mean, "", Bar(0.4, 2.5), beyond)
    if errors:
        yield Row(
            "scenarios/median error", errors[50], "mm", None, f"95 %: {errors[95]:.3g} mm, worst: {errors[100]:.3g} mm"
        )
