"""Worlds that are run for real: two cameras, few poses."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.ci.execution.tasks import Task, run_tasks, single_threaded_opencv
from calibration.engine.estimation.options import ALL_EXACT
from calibration.robot.simulation.capture import Requirements
from calibration.robot.simulation.motion import Motion, read_motion
from calibration.robot.simulation.scenarios.run import find_driver, pending_result, run_scenario, world_assumptions
from calibration.robot.simulation.scenarios.scenario import Scenario, ScenarioResult, content_hash, parse_id
from calibration.robot.simulation.scenarios.scenario_set import ScenarioSet, read_scenario_set
from calibration.robot.simulation.scenarios.statistics import Statistics
from calibration.robot.simulation.system import read_system
from tests.robot.simulation.scenarios.conftest import ReadSet

SWAYING = """
light: {ambient: {uniform: [0.7, 0.8]}}
assembly: {translation_mm: {normal: [0, 2]}}
motion: {poses: 5, sway_mm: {log_uniform: [0.01, 10]}}
"""
LENIENT = Requirements(stillness=1)
SCENARIOS = 16


def run_scenarios(
    scenarios: ScenarioSet,
    indices: Sequence[int],
    jobs: int,
    motion: Motion | None = None,
    requirements: Requirements | None = None,
) -> list[ScenarioResult]:
    """The scenarios of seed 1 with these numbers."""
    drawn = [scenarios.scenario(1, index) for index in indices]
    tasks = [Task.call(each.id, partial(run_scenario, scenarios, each, motion, requirements)) for each in drawn]
    with single_threaded_opencv():
        return list(run_tasks(tasks, workers=jobs).values())


@pytest.fixture(scope="module")
def swaying(small: Path, tmp_path_factory: pytest.TempPathFactory) -> ScenarioSet:
    path: Path = tmp_path_factory.mktemp("set") / "scenarios.yml"
    path.write_text(SWAYING)
    return read_scenario_set(path, read_system(small))


@pytest.fixture(scope="module")
def results(swaying: ScenarioSet) -> list[ScenarioResult]:
    return run_scenarios(swaying, range(SCENARIOS), 2, requirements=LENIENT)


@pytest.mark.thorough
def test_every_scenario_is_collected_and_calibrated(results: list[ScenarioResult]) -> None:
    assert [result.id for result in results] == [f"s1-{i:05d}" for i in range(SCENARIOS)]
    for result in results:
        assert result.reasons == ()
        assert result.converged
        assert (result.poses, result.kept) == (5, 5 - len(result.lost or {}))
        assert result.detection is not None
        assert list(result.detection) == ["left_camera", "right_camera"]
        assert result.corner_rms_px is not None
        assert 0 < result.corner_rms_px < 0.2
        assert result.translation_mm is not None
        assert result.sigma_mm is not None
        assert 0 < result.sigma_mm < 20


def test_neither_order_nor_workers_nor_company_matter(swaying: ScenarioSet, results: list[ScenarioResult]) -> None:
    some = [7, 2]
    again = run_scenarios(swaying, some, 1, requirements=LENIENT)
    assert again == [results[i] for i in some]


def test_an_id_replays_its_row_of_the_whole(swaying: ScenarioSet, results: list[ScenarioResult]) -> None:
    scenario = swaying.scenario(*parse_id("s1-00004"))
    assert run_scenario(swaying, scenario, requirements=LENIENT) == results[4]
    assert results[4].hash == content_hash(swaying.system, scenario)


def test_error_bars_contain_what_the_sway_does(results: list[ScenarioResult]) -> None:
    squares = [result.error_sigmas**2 for result in results if result.error_sigmas is not None]
    assert len(squares) == SCENARIOS
    assert 0.3 < sum(squares) / SCENARIOS < 3  # by the noise of the labels alone it is hundreds
    assert Statistics(results).beyond_error_bars == []


BENT = "light: {ambient: 0.75}\npattern: {bow_mm: 15}\nmotion: {poses: 8, sway_mm: 0.01}"


def test_patterns_are_as_flat_as_the_set_says(read_set: ReadSet) -> None:
    bent = world_assumptions(read_set(BENT))
    assert bent == replace(ALL_EXACT, flatness=pytest.approx(0.015))
    assert world_assumptions(read_set("light: {ambient: 0.75}")) == ALL_EXACT


def test_a_driver_is_the_part_without_which_the_error_is_least(
    read_set: ReadSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenarios = read_set(BENT)
    result = replace(pending_result(scenarios, scenarios.scenario(1, 0)), converged=True, error_sigmas=9.0)
    motions = []

    def repeated(_: ScenarioSet, scenario: Scenario, motion: Motion, *__: object) -> ScenarioResult:
        motions.append(motion)
        bent = "pattern_1.bow_x_mm" in scenario.values or "pattern_1.bow_y_mm" in scenario.values
        return replace(result, error_sigmas=8.0 if bent else 1.0)

    monkeypatch.setattr("calibration.robot.simulation.scenarios.run.run_scenario", repeated)
    assert find_driver(scenarios, result).startswith("pattern (pattern_1.bow_x_mm 15, pattern_1.bow_y_mm 15), ")
    assert len(motions) == 3
    assert all(motion is motions[0] for motion in motions)
    assert find_driver(scenarios, replace(result, error_sigmas=1.5)).startswith("none")


@pytest.mark.thorough
def test_a_bent_pattern_is_the_driver_where_it_is_taken_for_flat(
    read_set: ReadSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenarios = read_set(BENT)
    monkeypatch.setattr("calibration.robot.simulation.scenarios.run.world_assumptions", lambda _: ALL_EXACT)
    result = run_scenario(scenarios, scenarios.scenario(1, 0))
    assert result.error_sigmas is not None
    assert result.error_sigmas > 2.5
    assert find_driver(scenarios, result).startswith("pattern ")


def test_what_was_planted_drives_the_error(results: list[ScenarioResult]) -> None:
    first, *others = Statistics(results).drivers
    assert first.parameter == "motion.sway_mm"
    assert first.correlation > 0.7
    assert first.stands_out
    assert not any(driver.stands_out for driver in others)


def test_a_still_scenario_calibrates_although_it_was_put_together_badly(read_set: ReadSet) -> None:
    scenarios = read_set(
        "assembly: {translation_mm: {uniform: [5, 20]}, rotation_deg: {uniform: [1, 3]}}\nmotion: {poses: 6}"
    )
    (result,) = run_scenarios(scenarios, [0], 1)
    assert result.translation_mm is not None
    assert result.translation_mm < 0.5


def test_a_scenario_without_a_motion_does_not_lose_the_others(read_set: ReadSet) -> None:
    scenarios = read_set("occluders: {count: {choice: [0, 40]}, size_m: 1.5}\nmotion: {poses: 4}")
    counts = [scenarios.scenario(1, i).values["occluders.count"] for i in range(10)]
    indices = [counts.index(0), counts.index(40)]
    open_scenario, walled = run_scenarios(scenarios, indices, 2)
    assert open_scenario.converged
    assert not walled.converged
    assert (walled.poses, walled.kept, walled.translation_mm) == (0, 0, None)
    assert len(walled.reasons) == 1


def test_a_dark_scenario_fails_without_collections(read_set: ReadSet) -> None:
    scenarios = read_set("light: {ambient: 0, intensity: 0}\nmotion: {poses: 2}")
    (result,) = run_scenarios(scenarios, [3], 1)
    assert (result.poses, result.kept, result.converged) == (2, 0, False)
    assert result.detection == {"left_camera": 0, "right_camera": 0}
    assert result.lost is not None
    assert list(result.lost) == ["000", "001"]
    assert result.reasons == ("no pose gave a collection",)


def test_a_given_motion_is_played_in_every_scenario(swaying: ScenarioSet, small: Path) -> None:
    motion = read_motion(small / "motion.json").take([0, 3, 5])
    first, second = run_scenarios(swaying, [0, 1], 1, motion, LENIENT)
    assert (first.poses, second.poses) == (3, 3)
    assert first.hash == content_hash(swaying.system, swaying.scenario(1, 0), motion)
    wrong = replace(motion, positions=None, orientations=None, joints={"elbow": motion.positions[:, 0]})  # type: ignore[index]
    (refused,) = run_scenarios(swaying, [0], 1, wrong)
    assert not refused.converged
    assert "found no position and orientation" in refused.reasons[0]


def test_constraints_that_cannot_be_kept_end_it_before_the_first_scenario(read_set: ReadSet) -> None:
    scenarios = read_set("motion: {sway_mm: {uniform: [0, 1]}}\nconstraints: [{parameter: motion.sway_mm, min: 2}]")
    with pytest.raises(InputError, match=r"constraints\.0"):
        run_scenarios(scenarios, [0, 1], 1)
