"""The team's applications many times: each dataset judged by itself, one report over all."""

import json
import shlex
import shutil
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.base import ExitCode, InputError
from calibration.ci.execution.job import OUTPUT, Job
from calibration.ci.execution.outcome import JobOutcome
from calibration.commands.collect_data_sim import command
from calibration.pipeline.collection.collecting import collect_dataset, collect_scenarios
from calibration.pipeline.collection.request import CollectionChecks, CollectionRequest, ScenarioRequest
from calibration.pipeline.collection.results import ScenarioResults
from calibration.pipeline.collection.scenario_report import replay, report
from calibration.pipeline.collection.scenarios import ScenarioFolder
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from tests.pipeline.collection.applications import applications_from
from tests.pipeline.targets import at

T2RGB = Path(__file__).parents[3] / "datasets" / "t2rgb"
ENTRY = {
    "image": "robot:1",
    "containers": {
        "simulation": {"command": "simulate --seed {seed} --scenario {scenario}", "essential": False},
        "robot": {"command": "collect --motion {motion} --out {output}/set{scenario}", "after": ["simulation"]},
    },
    "dataset": "{output}/set{scenario}",
}

Leave = Callable[[Path], dict[str, Any] | None]
"""Leaves a dataset in a folder; returns the fields of the outcome, if it is a bad one."""


class Leaves:
    """Backend whose jobs leave configured files, by their number."""

    def __init__(self, *leave: Leave) -> None:
        self.leave, self.jobs = leave, list[Job]()

    def run(self, jobs: Sequence[Job], folder: Path, workers: int | None = None) -> Generator[tuple[int, JobOutcome]]:
        self.jobs += jobs
        for place, job in enumerate(jobs):
            number = int(job.name.rpartition("-")[2])
            artifacts = folder / job.name / "artifacts"
            artifacts.mkdir(parents=True)
            (folder / job.name / "logs").mkdir()
            (folder / job.name / "logs" / "robot.log").write_text(f"scenario {number}\n")
            yield (
                place,
                JobOutcome(job.name, folder / job.name, **(self.leave[number](artifacts / f"set{number}") or {})),
            )


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("collected")
    collect_dataset(CollectionRequest(T2RGB, motion="generate:4", seed=3), folder)
    for path in [path for path in folder.iterdir() if path.suffix != ".jpg" and path.name != "dataset.json"]:
        path.unlink()
    return folder


@pytest.fixture
def good(collected: Path) -> Leave:
    def leave(folder: Path) -> None:
        shutil.copytree(collected, folder)

    return leave


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.pipeline.collection.scenario_report.figure", lambda *_: b"a picture")


def lost(folder: Path) -> dict[str, Any]:
    return {"exit_code": ExitCode.INFRASTRUCTURE, "reasons": ("the host was lost",)}


def failed(folder: Path) -> dict[str, Any]:
    return {"exit_code": ExitCode.FAIL, "reasons": ("container 'robot' ended with exit code 3",)}


def hostile(folder: Path) -> None:
    folder.mkdir()
    (folder / "dataset.json").write_text("[" * 10_000)


def run(
    request: ScenarioRequest, backend: Leaves, output: Path, resume: bool = False, told: list[str] | None = None
) -> ScenarioResults:
    def done(_count: int, _total: int, result: ScenarioResult) -> None:
        if told is not None:
            told.append(result.id)

    request = replace(request, collection=replace(request.collection, target=at(backend)))
    found = collect_scenarios(request, ScenarioFolder(output, resume), done=done)
    report(found, output).write(output)
    return found


def asked(count: int, *options: str, **entry: Any) -> ScenarioRequest:
    applications = applications_from({**ENTRY, **entry}, Path(), "x")
    request = CollectionRequest(T2RGB, applications, name="t2rgb", seed=3, checks=CollectionChecks(3))
    return ScenarioRequest(request, count, 0.5, options)


def test_each_dataset_is_judged_by_itself(good: Leave, tmp_path: Path) -> None:
    backend, told = Leaves(good, failed, lost, good, hostile), list[str]()
    found = run(asked(5), backend, tmp_path, told=told)
    commands = [{c.name: c.command for c in job.containers} for job in backend.jobs]
    assert [words["simulation"][2::2] for words in commands] == [("3", str(i)) for i in range(5)]
    assert commands[4]["robot"][-1] == f"{OUTPUT}/set4"
    assert told == [f"s3-0000{i}" for i in range(5)]
    [seen] = {mount.source for job in backend.jobs for c in job.containers for mount in c.mounts}
    assert seen.name == "in"  # one folder for all: it goes to the cloud once

    assert found.failed.keys() == {"s3-00001", "s3-00002", "s3-00004"}
    assert found.failed["s3-00001"] == ["container 'robot' ended with exit code 3"]
    assert found.failed["s3-00004"][0].startswith("dataset.json")
    assert (found.errors, found.exit_code) == ({"s3-00002": ExitCode.INFRASTRUCTURE}, ExitCode.INFRASTRUCTURE)
    document = json.loads((tmp_path / "results.json").read_text())
    assert (document["seed"], document["system"], document["success_rate"]) == (3, "t2rgb", 0.4)
    assert document["scenarios"][3]["translation_mm"] < 0.5
    assert len({each["hash"] for each in document["scenarios"]}) == 5
    kept = {path.name: {file.name for file in path.iterdir()} for path in (tmp_path / "scenarios").iterdir()}
    assert kept.keys() == {"s3-00000", "s3-00001", "s3-00003", "s3-00004"}
    assert {"dataset.json", "ground_truth.json", "results.json", "scenario.json", "contact_sheet.png"} <= kept[
        "s3-00000"
    ]
    assert "dataset.json" not in kept["s3-00004"]
    assert (tmp_path / "logs" / "s3-00002" / "robot.log").read_text() == "scenario 2\n"


def test_only_what_is_missing_runs_again(good: Leave, tmp_path: Path) -> None:
    run(asked(3), Leaves(good, failed, lost), tmp_path)
    again = Leaves(good, good, good)
    found = run(asked(3), again, tmp_path, resume=True)
    assert [job.name for job in again.jobs] == ["s3-00002"]  # a failure of the software is a result
    assert (found.success_rate, found.exit_code) == (0.666667, ExitCode.PASS)
    other = Leaves(good, good, good)
    run(asked(3, image="robot:2"), other, tmp_path, resume=True)
    assert len(other.jobs) == 3


def test_without_a_system_or_a_motion(good: Leave, tmp_path: Path) -> None:
    applications = applications_from({**ENTRY, "containers": {"robot": {"command": "run"}}}, Path(), "x")
    request = ScenarioRequest(CollectionRequest(applications=applications, name="theirs", truth="dataset"), 1)
    backend = Leaves(good)
    found = run(request, backend, tmp_path)
    assert found.exit_code == ExitCode.PASS
    assert backend.jobs[0].containers[0].mounts == ()
    with pytest.raises(InputError, match="exists already"):
        run(request, backend, tmp_path)


def test_the_command_that_collects_one_again(good: Leave, tmp_path: Path) -> None:
    request = asked(1, "--applications", "my apps.yml")
    words = shlex.split(replay(run(request, Leaves(good), tmp_path), "s3-00000"))
    context = command.make_context("collect-data-sim", words[2:])
    assert context.params["applications"] == Path("my apps.yml")
    assert (context.params["scenario"], context.params["scenario_set"]) == ("s3-00000", None)
