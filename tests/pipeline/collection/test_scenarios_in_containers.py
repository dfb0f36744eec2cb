"""Scenarios that ran in containers: the same report as here, and what is made of those that were lost or lie."""

import json
import shutil
import tempfile
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from calibration import __version__
from calibration.__main__ import main
from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.base.records.schema import schema_of
from calibration.ci.execution.job import OUTPUT, Job
from calibration.ci.execution.job_check import check_jobs
from calibration.ci.execution.outcome import JobOutcome
from calibration.pipeline.collection.collecting import collect_dataset, collect_scenarios
from calibration.pipeline.collection.request import CollectionRequest, ScenarioRequest
from calibration.pipeline.collection.results import ScenarioResults
from calibration.pipeline.collection.scenario_report import report
from calibration.pipeline.collection.scenarios import SCENARIO_FILE, ScenarioDone, ScenarioFile, ScenarioFolder
from calibration.pipeline.containers import INPUT_FOLDER, Applications
from tests.pipeline.targets import at
from tests.small import first_poses

SET = """
assembly: {translation_mm: {normal: [0, 3]}}
motion: {poses: 3}
"""
SCENARIOS = 3

Change = Callable[[Path, dict[str, Any]], None]
"""Changes what a job left (its folder), and the fields of its outcome."""


class RunsHere:
    """A backend that runs the command of each job in this process, with its folders in the place of a container's."""

    ran: dict[str, tuple[int, Path]] = {}  # noqa: RUF012
    """# results of commands by their inputs, so that none runs twice"""
    kept: Path

    def __init__(self, **changes: Change) -> None:
        self.changes, self.jobs = changes, list[Job]()

    def run(self, jobs: Sequence[Job], folder: Path, workers: int | None = None) -> Generator[tuple[int, JobOutcome]]:
        check_jobs(jobs)
        self.jobs += jobs
        return self._outcomes(jobs, folder)

    def _outcomes(self, jobs: Sequence[Job], folder: Path) -> Generator[tuple[int, JobOutcome]]:
        for number, job in reversed(list(enumerate(jobs))):  # they come in any order
            place = folder / job.name
            artifacts = place / "artifacts"
            artifacts.mkdir(parents=True)
            (place / "logs").mkdir()
            [container] = job.containers
            [mount] = container.mounts
            code = self._run(container.command, mount.source, artifacts)
            (place / "logs" / "scenario.log").write_text(f"began\nended with {code}\n\n")
            fields: dict[str, Any] = {}
            if code not in container.success:
                fields = {"exit_code": ExitCode.FAIL, "reasons": (f"container 'scenario' ended with exit code {code}",)}
            self.changes.get(job.name.replace("-", "_"), lambda *_: None)(place, fields)
            yield number, JobOutcome(job.name, place, **fields)

    def _run(self, command: Sequence[str], inputs: Path, artifacts: Path) -> int:
        files = [(str(path.relative_to(inputs)), path.read_bytes()) for path in sorted(inputs.rglob("*.*"))]
        key = repr((command, files))
        if key not in self.ran:
            words = [word.replace(INPUT_FOLDER, str(inputs)).replace(OUTPUT, str(artifacts)) for word in command]
            assert words[0] == "calibration"
            code = main(words[1:])
            self.ran[key] = code, Path(tempfile.mkdtemp(dir=self.kept))
            shutil.copytree(artifacts, self.ran[key][1], dirs_exist_ok=True)
        code, left = self.ran[key]
        shutil.copytree(left, artifacts, dirs_exist_ok=True)
        return code


@pytest.fixture(autouse=True, scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> None:
    RunsHere.kept = tmp_path_factory.mktemp("ran")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figure out, whose drawing takes longer than a scenario."""
    monkeypatch.setattr("calibration.pipeline.collection.scenario_report.figure", lambda *_: b"a picture")


@pytest.fixture
def asked(small: Path, tmp_path: Path) -> ScenarioRequest:
    path = tmp_path / "my scenarios.yml"
    path.write_text(SET)
    return ScenarioRequest(CollectionRequest(small, seed=5, scenario_set=path), SCENARIOS)


def set_file(asked: ScenarioRequest) -> Path:
    assert asked.collection.scenario_set is not None
    return asked.collection.scenario_set


def written(found: ScenarioResults, output: Path) -> ScenarioResults:
    report(found, output).write(output)
    return found


def run(
    asked: ScenarioRequest,
    output: Path,
    backend: RunsHere | None = None,
    begin: Callable[[str, int], None] = lambda *_: None,
    done: ScenarioDone = lambda *_: None,
    **how: bool,
) -> ScenarioResults:
    applications = Applications(image="robot:1", seconds=60)
    collection = replace(asked.collection, applications=applications, target=at(backend or RunsHere()))
    there = replace(asked, collection=collection)
    return written(collect_scenarios(there, ScenarioFolder(output, **how), None, begin, done), output)


def run_here(asked: ScenarioRequest, output: Path) -> ScenarioResults:
    return written(collect_scenarios(asked, ScenarioFolder(output), 1), output)


def snapshot(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_the_same_report_and_the_same_datasets_as_here(
    asked: ScenarioRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    backend, begun, told = RunsHere(), list[tuple[str, int]](), list[str]()
    found = run(
        asked,
        tmp_path / "there",
        backend,
        lambda *begin: begun.append(begin),
        lambda _count, _total, result: told.append(result.id),
    )
    run_here(asked, tmp_path / "here")
    assert snapshot(tmp_path / "there") == snapshot(tmp_path / "here")
    assert (found.exit_code, begun) == (ExitCode.PASS, [("small", SCENARIOS)])
    assert told == ["s5-00002", "s5-00001", "s5-00000"]
    assert {path.name for path in (tmp_path / "there").iterdir() if path.is_dir()} == {"scenarios", "logs"}
    assert (tmp_path / "there" / "logs" / "s5-00001" / "scenario.log").read_text() == "began\nended with 0\n\n"

    alone = replace(asked.collection, number=1)
    collect_dataset(alone, tmp_path / "one", jobs=1)
    kept = snapshot(tmp_path / "there" / "scenarios" / "s5-00001")
    assert kept == snapshot(tmp_path / "one")
    assert {"dataset.json", "ground_truth.json", "contact_sheet.png", SCENARIO_FILE} <= kept.keys()
    jsonschema.validate(json.loads(kept[SCENARIO_FILE]), schema_of(ScenarioFile))
    assert [job.seconds for job in backend.jobs] == [60, 60, 60]
    assert capsys.readouterr().err == ""


def test_a_robot_a_configuration_a_motion_and_a_requirement_of_its_own(
    asked: ScenarioRequest, small: Path, tmp_path: Path
) -> None:
    system = tmp_path / "my robot"
    shutil.copytree(small, system, ignore=shutil.ignore_patterns("*.json"))
    robot, config = tmp_path / "r.urdf", tmp_path / "c.yml"
    (system / "robot.urdf").rename(robot)
    (system / "config.yml").rename(config)
    motion = first_poses(small, 3, tmp_path / "m.json")
    collection = CollectionRequest(
        system, robot=robot, config=config, motion=str(motion), seed=5, stillness=0.0017, scenario_set=set_file(asked)
    )
    asked = replace(asked, collection=collection, count=1)
    run(asked, tmp_path / "there")
    run_here(asked, tmp_path / "here")
    assert snapshot(tmp_path / "there") == snapshot(tmp_path / "here")
    asked = replace(asked, collection=replace(collection, motion="generate:3"))
    run(asked, tmp_path / "there", overwrite=True)
    run_here(asked, tmp_path / "here")
    assert snapshot(tmp_path / "there") == snapshot(tmp_path / "here")


def lost(place: Path, outcome: dict[str, Any]) -> None:
    shutil.rmtree(place / "artifacts")
    outcome |= {"exit_code": ExitCode.INFRASTRUCTURE, "reasons": ("the host i-1 was lost",)}


def killed(place: Path, outcome: dict[str, Any]) -> None:
    outcome |= {"exit_code": ExitCode.FAIL, "reasons": ("container 'scenario' ran out of memory",)}


def test_a_lost_scenario_loses_no_other_and_is_no_pass(asked: ScenarioRequest, tmp_path: Path) -> None:
    found = run(asked, tmp_path / "out", RunsHere(s5_00001=lost))
    assert found.failed == {"s5-00001": ["the host i-1 was lost"]}
    assert (found.verdict, found.exit_code, found.success_rate) == ("fail", ExitCode.INFRASTRUCTURE, 0.666667)
    assert [each.id for each in found.statistics.ran] == ["s5-00000", "s5-00002"]
    document = json.loads((tmp_path / "out" / "results.json").read_text())
    assert document["errors"] == {"s5-00001": 3}
    assert [each["converged"] for each in document["scenarios"]] == [True, False, True]
    assert document["scenarios"][1]["values"].keys() == document["scenarios"][0]["values"].keys()
    assert 'errors="1"' in (tmp_path / "out" / "junit.xml").read_text()
    assert sorted(path.name for path in (tmp_path / "out" / "scenarios").iterdir()) == ["s5-00000", "s5-00002"]
    enough = run(replace(asked, minimum_success_rate=0.6), tmp_path / "rate", RunsHere(s5_00001=lost))
    assert enough.exit_code == ExitCode.PASS
    assert enough.failed.keys() == {"s5-00001"}


def test_only_what_is_missing_is_run_again(asked: ScenarioRequest, tmp_path: Path) -> None:
    output = tmp_path / "out"
    run(asked, output, RunsHere(s5_00001=lost, s5_00002=killed))
    with pytest.raises(
        InputError, match=r"out/scenarios: exists already; --overwrite replaces the scenarios, --resume runs"
    ):
        run(asked, output)
    again, told = RunsHere(), list[str]()
    found = run(asked, output, again, done=lambda _count, _total, each: told.append(each.id), resume=True)
    assert told == ["s5-00000", "s5-00002", "s5-00001"]  # those that are kept, then those that come
    assert [job.name for job in again.jobs] == ["s5-00001", "s5-00002"]
    assert found.exit_code == ExitCode.PASS
    assert found.statistics.results == run(asked, tmp_path / "at once").statistics.results
    nothing = RunsHere()
    run(asked, output, nothing, resume=True)
    assert nothing.jobs == []
    run(replace(asked, collection=replace(asked.collection, seed=6), count=1), output, overwrite=True)
    assert [path.name for path in (output / "scenarios").iterdir()] == ["s6-00000"]


def test_what_was_another_scenario_is_not_kept(asked: ScenarioRequest, tmp_path: Path) -> None:
    asked = replace(asked, count=1)
    run(asked, tmp_path / "out")
    set_file(asked).write_text(SET.replace("3]", "4]"))
    again = RunsHere()
    found = run(asked, tmp_path / "out", again, resume=True)
    assert len(again.jobs) == 1
    strict = replace(asked, collection=replace(asked.collection, stillness=0.001))
    run(strict, tmp_path / "out", again, resume=True)
    assert len(again.jobs) == 2
    assert found.exit_code == ExitCode.PASS


def edited(**changes: object) -> Change:
    """Change ``scenario.json``: the fields of the result, or ``_version`` and the like beside it."""

    def change(place: Path, outcome: dict[str, Any]) -> None:
        path = place / "artifacts" / "dataset" / SCENARIO_FILE
        document = json.loads(path.read_text())
        for key, value in changes.items():
            target = document if key.startswith("_") else document["result"]
            target[key.removeprefix("_")] = value
        path.write_text(json.dumps(document))

    return change


def rewritten(text: str | None) -> Change:
    def change(place: Path, outcome: dict[str, Any]) -> None:
        path = place / "artifacts" / "dataset" / SCENARIO_FILE
        path.unlink()
        if text is not None:
            path.write_text(text)

    return change


def silent(place: Path, outcome: dict[str, Any]) -> None:
    shutil.rmtree(place)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (killed, "container 'scenario' ran out of memory"),
        (rewritten(None), "the image left no scenario.json (it needs calibration-ci): ended with 0"),
        (silent, "the image left no scenario.json (it needs calibration-ci)"),
        (rewritten("{"), "scenario.json: this is no JSON"),
        (rewritten("[" * 100_000), "scenario.json: this is no JSON"),
        (rewritten('{"schema": NaN}'), "scenario.json: this is no JSON"),
        (rewritten("[]"), "scenario.json: found an empty list, expected keys: schema, version, stillness_m, result"),
        (edited(poses=-1), "scenario.json: result.poses: found -1, expected a whole number from 0 to 100000"),
        (edited(rms_px="x"), "scenario.json: result.rms_px: found 'x', expected a number"),
        (
            edited(corner_rms_px=float("1e308")),
            "scenario.json: result.corner_rms_px: found 1e+308, expected a number",
        ),
        (edited(more=1), "scenario.json: result: unknown key 'more'"),
        (edited(id="s5-00007"), "scenario.json: it is of another scenario: id: found s5-00007, expected s5-00000"),
        (edited(hash="0" * 12), "scenario.json: it is of another scenario: hash: found 000000000000"),
        (edited(_stillness_m=1), "scenario.json: it is of another scenario: stillness: found 1.0, expected 0.002"),
        (
            edited(_version="0.0.0\n::error::x"),
            f"made by calibration-ci 0.0.0 ::error::x, this is {__version__}: another version makes other scenarios",
        ),
    ],
)
def test_what_a_container_leaves_is_checked(
    asked: ScenarioRequest, tmp_path: Path, change: Change, reason: str
) -> None:
    found = run(replace(asked, count=1), tmp_path / "out", RunsHere(s5_00000=change))
    [why] = found.failed["s5-00000"]
    assert reason in why
    assert "\n" not in why
    assert found.exit_code == ExitCode.FAIL
    assert not (tmp_path / "out" / "scenarios").exists()


def test_numbers_are_our_own(asked: ScenarioRequest, tmp_path: Path) -> None:
    lies = edited(translation_mm=0.0, converged=True, rms_px=0.0, values={"assembly.x": 1}, reasons=["fine"])

    def broken(place: Path, outcome: dict[str, Any]) -> None:
        (place / "artifacts" / "dataset" / "dataset.json").write_text("{}")

    found = run(replace(asked, count=2), tmp_path / "out", RunsHere(s5_00000=lies, s5_00001=broken))
    first, second = found.statistics.results
    assert first == run(replace(asked, count=1), tmp_path / "honest").statistics.results[0]
    assert not second.converged
    assert second.reasons[0].startswith("dataset.json: ")


def test_a_scenario_without_a_collection_is_a_result(asked: ScenarioRequest, tmp_path: Path) -> None:
    set_file(asked).write_text("motion: {poses: 3, sway_mm: 50}\n")  # nothing is still
    asked = replace(asked, count=1)
    found = run(asked, tmp_path / "out")
    assert found.failed == {"s5-00000": ["no pose gave a collection"]}
    run_here(asked, tmp_path / "here")
    assert snapshot(tmp_path / "out") == snapshot(tmp_path / "here")
    again = RunsHere()
    run(asked, tmp_path / "out", again, resume=True)
    assert again.jobs == []  # it is none that is missing

    unsaid = RunsHere(s5_00000=edited(reasons=[]))
    assert run(asked, tmp_path / "unsaid", unsaid).failed == found.failed


def test_a_scenario_in_which_no_motion_is_found_is_a_result(
    asked: ScenarioRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    set_file(asked).write_text("motion: {poses: 4, nearest_m: 900, farthest_m: 990}\n")
    asked = replace(asked, count=1)
    found = run(asked, tmp_path / "out")
    assert "error" in capsys.readouterr().err
    run_here(asked, tmp_path / "here")
    assert snapshot(tmp_path / "out") == snapshot(tmp_path / "here")
    assert (found.exit_code, found.errors) == (ExitCode.FAIL, {})
    assert [path.name for path in (tmp_path / "out" / "scenarios" / "s5-00000").iterdir()] == [SCENARIO_FILE]


def test_bad_input_before_anything_runs(asked: ScenarioRequest, tmp_path: Path) -> None:
    backend = RunsHere()
    sound = set_file(asked).read_text()
    set_file(asked).write_text("motion: {pose: 4}\n")
    with pytest.raises(InputError, match="pose"):
        run(asked, tmp_path / "out", backend)
    assert backend.jobs == []
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").write_text("")
    set_file(asked).write_text(sound)
    with pytest.raises(InfrastructureError, match="file: cannot be written: "):
        run(asked, tmp_path / "file", backend)
    assert backend.jobs == []


def test_a_place_that_cannot_be_written(asked: ScenarioRequest, tmp_path: Path) -> None:
    output = tmp_path / "out"
    output.mkdir()
    (output / "scenarios").write_text("in the way")
    with pytest.raises(InfrastructureError, match="out: cannot be written: File exists"):
        run(replace(asked, count=1), output, resume=True)
    assert sorted(path.name for path in output.iterdir()) == ["logs", "scenarios"]


def test_an_interruption_keeps_what_is_done(asked: ScenarioRequest, tmp_path: Path) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(asked, tmp_path / "out", done=interrupt)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"scenarios", "logs"}
    assert [path.name for path in (tmp_path / "out" / "scenarios").iterdir()] == ["s5-00002"]


@pytest.mark.thorough
def test_scenarios_here_that_are_interrupted_go_on_unless_they_are_others(
    asked: ScenarioRequest, tmp_path: Path
) -> None:
    def interrupt(count: int, *_: object) -> None:
        if count == 2:
            raise KeyboardInterrupt

    def run_again(asked: ScenarioRequest) -> list[int]:
        with pytest.raises(KeyboardInterrupt):
            collect_scenarios(asked, ScenarioFolder(tmp_path / "out"), 1, done=interrupt)
        seen: list[int] = []
        found = collect_scenarios(asked, ScenarioFolder(tmp_path / "out"), 1, done=lambda count, *_: seen.append(count))
        written(found, tmp_path / "out")
        return seen

    run_here(asked, tmp_path / "at once")
    assert run_again(asked) == [1, 2, 3]
    assert snapshot(tmp_path / "out") == snapshot(tmp_path / "at once")
    assert not [path for path in (tmp_path / "out").iterdir() if path.is_dir()]

    with pytest.raises(KeyboardInterrupt):
        collect_scenarios(asked, ScenarioFolder(tmp_path / "out"), 1, done=interrupt)
    kept = snapshot(tmp_path / "out" / ".unfinished")
    assert len([name for name in kept if name.endswith(".result.json")]) == 2
    set_file(asked).write_text(SET.replace("3]", "4]"))
    run_here(asked, tmp_path / "fresh")
    run_here(asked, tmp_path / "out")
    assert snapshot(tmp_path / "out") == snapshot(tmp_path / "fresh") != snapshot(tmp_path / "at once")
