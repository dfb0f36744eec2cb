"""The verdict over many scenarios, and what it leaves in files."""

import csv
import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.base import ExitCode
from calibration.commands.collect_data_sim import command
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import (
    MAX_SCENARIOS,
    CollectionChecks,
    CollectionLimits,
    CollectionRequest,
    ScenarioRequest,
)
from calibration.pipeline.collection.results import ScenarioResults, scenario_reasons
from calibration.pipeline.collection.scenario_report import replay, report, scenario_line
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.statistics import Statistics

GOOD = ScenarioResult(
    "s1-00000",
    "0123456789ab",
    {"motion.sway_mm": 0.1},
    poses=12,
    lost={"003": ("left: moved",)},
    detection={"left": 0.9},
    converged=True,
    rms_px=0.1,
    translation_mm=1.0,
    rotation_deg=0.1,
)
USUAL = CollectionChecks().with_usual_limits()
FAR = replace(GOOD, id="s1-00001", translation_mm=7.0)
BROKEN = replace(
    GOOD, id="s1-00002", converged=False, translation_mm=None, rotation_deg=None, reasons=("nothing seen",)
)


def results(*found: ScenarioResult, rate: float = 1.0, **checks: Any) -> ScenarioResults:
    collection = CollectionRequest(
        Path("my robot"), seed=1, checks=CollectionChecks(**checks), scenario_set=Path("scenarios.yml")
    )
    request = ScenarioRequest(collection, len(found), rate)
    return ScenarioResults("robot", request, Statistics(found))


def test_a_scenario_passes_within_its_limits() -> None:
    assert scenario_reasons(GOOD, USUAL) == []
    assert scenario_reasons(BROKEN, USUAL) == ["nothing seen"]
    assert scenario_reasons(replace(BROKEN, reasons=()), USUAL) == ["it does not calibrate"]
    assert scenario_reasons(FAR, USUAL) == ["translation error against the truth: found 7 mm, expected at most 5 mm"]
    strict = CollectionChecks(minimum_collections=12, minimum_detection_rate=0.95, limits=CollectionLimits(5, 0.05))
    assert [reason.partition(":")[0] for reason in scenario_reasons(GOOD, strict)] == [
        "collections",
        "detection rate of left",
        "rotation error against the truth",
    ]
    assert scenario_reasons(replace(GOOD, translation_mm=None), USUAL) != []
    assert scenario_reasons(replace(GOOD, joint_mm=4.0, joint_deg=0.4), USUAL) == [
        "joint rotation error against the truth: found 0.4 deg, expected at most 0.3 deg"
    ]


def test_every_scenario_has_to_pass_unless_a_rate_is_given() -> None:
    assert results(GOOD).exit_code == ExitCode.PASS
    assert results(GOOD, FAR).exit_code == ExitCode.FAIL
    assert results(GOOD, FAR).reasons == ["success rate: found 0.5, expected at least 1"]
    assert results(GOOD, FAR, rate=0.5).exit_code == ExitCode.PASS
    assert results(GOOD, FAR, BROKEN, rate=0.5).exit_code == ExitCode.FAIL
    assert results(FAR, limits=CollectionLimits(10)).exit_code == ExitCode.PASS


def test_what_it_leaves(tmp_path: Path) -> None:
    found = report(results(GOOD, FAR, BROKEN), tmp_path)
    found.write(tmp_path)
    assert found.notes == ()
    assert {path.name for path in tmp_path.iterdir()} == {
        *("results.json", "scenarios.csv", "scenarios.png", "summary.md", "junit.xml")
    }
    document = json.loads((tmp_path / "results.json").read_text())
    assert document == json.loads(json.dumps(found.document))
    assert document["failed"].keys() == {"s1-00001", "s1-00002"}
    assert document["worst"][0] == "s1-00002"
    rows = list(csv.DictReader((tmp_path / "scenarios.csv").read_text().splitlines()))
    assert [row["id"] for row in rows] == ["s1-00000", "s1-00001", "s1-00002"]
    assert 'tests="3" failures="2"' in (tmp_path / "junit.xml").read_text()
    assert "success rate: found 0.3333, expected at least 1" in found.markdown()


def test_without_what_draws_the_figure_there_is_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    found = report(results(GOOD), tmp_path)
    found.write(tmp_path)
    assert found.notes == ("the figure needs matplotlib: pip install matplotlib",)
    assert not (tmp_path / "scenarios.png").exists()
    assert (tmp_path / "results.json").exists()


def test_the_command_that_replays_is_one_that_the_command_line_takes() -> None:
    words = shlex.split(replay(results(GOOD), "s1-00017"))
    assert words[:2] == ["calibration", "collect-data-sim"]
    context = command.make_context("collect-data-sim", words[2:])
    assert context.params["scenario"] == "s1-00017"
    assert context.params["system"] == "my robot"
    assert context.params["scenario_set"] == Path("scenarios.yml")


def test_lines_of_the_progress() -> None:
    assert scenario_line(GOOD) == "s1-00000: 11/12 collections, 1 mm, 0.1 deg"
    assert scenario_line(BROKEN) == "s1-00002: nothing seen"
    assert MAX_SCENARIOS >= 10_000


def test_a_scenario_does_not_go_on_with_what_another_set_made_of_its_id(small: Path, tmp_path: Path) -> None:
    def files(folder: Path) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def scenario(name: str) -> CollectionRequest:
        return CollectionRequest(small, scenario_set=tmp_path / f"{name}.yml")

    for name, noise in (("a", 1), ("b", 5)):
        text = f"cameras: {{noise_levels: {noise}}}\nmotion: {{poses: 4}}\n"
        (tmp_path / f"{name}.yml").write_text(text)
    with pytest.raises(KeyboardInterrupt):
        collect_dataset(scenario("a"), tmp_path / "out", jobs=1, done=interrupt)
    assert (tmp_path / "out" / ".unfinished").exists()
    for folder in ("out", "fresh"):
        collect_dataset(scenario("b"), tmp_path / folder, jobs=1)
    assert files(tmp_path / "out") == files(tmp_path / "fresh")
