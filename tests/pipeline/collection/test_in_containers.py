"""Datasets collected by applications: the inputs of their containers, and the use of their outputs."""

import json
import shutil
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.base import ExitCode, InputError
from calibration.ci.execution.job import OUTPUT, Artifact, Job
from calibration.ci.execution.outcome import ContainerOutcome, End, JobOutcome
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionChecks, CollectionRequest
from calibration.pipeline.collection.results import CollectionResults
from calibration.pipeline.containers import INPUT_FOLDER, MOTION_PATH, PLAYER_PATH, REPORT_PATH, collection_job
from tests.pipeline.collection.applications import applications_from
from tests.pipeline.targets import at

DATASETS = Path(__file__).parents[3] / "datasets"
ENTRY = {
    "image": "robot:1",
    "ros": 1,
    "containers": {
        "simulation": {"command": "roslaunch simulation.launch seed:={seed}"},
        "robot": {"command": "roslaunch robot.launch out:={output}/dataset", "after": ["simulation"]},
    },
    "player": "ros1",
}


class LeavesBehind:
    """A backend whose containers leave these files in the output folder, and end so."""

    def __init__(self, leave: Callable[[Path], None], outcome: dict[str, Any] | None = None) -> None:
        self.leave, self.outcome, self.jobs = leave, outcome or {}, list[Job]()
        self.seen: list[set[str]] = []
        """The files of each mount."""

    def run(self, jobs: Sequence[Job], folder: Path, workers: int | None = None) -> Generator[tuple[int, JobOutcome]]:
        self.jobs += jobs
        self.seen = [
            {path.name for path in mount.source.iterdir()}
            for container in jobs[0].containers
            for mount in container.mounts
        ]
        place = folder / jobs[0].name
        (place / "artifacts").mkdir(parents=True)
        (place / "logs").mkdir()
        (place / "logs" / "robot.log").write_text("hello\n")
        self.leave(place / "artifacts")
        yield 0, JobOutcome(jobs[0].name, place, **self.outcome)


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three poses, as a robot application would leave it: no truth, no system."""
    folder = tmp_path_factory.mktemp("collected")
    collect_dataset(CollectionRequest(DATASETS / "t2rgb", motion="generate:4", seed=3), folder)
    names = [path for path in folder.iterdir() if path.suffix != ".jpg" and path.name != "dataset.json"]
    for path in names:
        path.unlink()
    return folder


def copying(dataset: Path, report: object = None) -> Callable[[Path], None]:
    def leave(artifacts: Path) -> None:
        shutil.copytree(dataset, artifacts / "dataset")
        if report is not None:
            (artifacts / Path(REPORT_PATH).name).write_text(json.dumps(report))

    return leave


def test_the_number_of_the_collection_is_passed(collected: Path, tmp_path: Path) -> None:
    entry = {**ENTRY, "dataset": "{output}/set-{seed}-{scenario}"}

    def leave(artifacts: Path) -> None:
        shutil.copytree(collected, artifacts / "set-3-7")

    backend = LeavesBehind(leave)
    asked = CollectionRequest(DATASETS / "t2rgb", applications_from(entry, Path(), "x"), name="fresh", seed=3, number=7)
    assert collect_dataset(replace(asked, target=at(backend)), tmp_path / "out").verdict == "pass"
    assert backend.jobs[0].containers[-1].artifacts[0] == Artifact(f"{OUTPUT}/set-3-7")


def request(**changes: Any) -> CollectionRequest:
    applications = applications_from(ENTRY, Path(), "simulation.fresh")
    return CollectionRequest(DATASETS / "t2rgb", applications, name="fresh", **{"seed": 3, **changes})


def test_the_containers_and_our_player() -> None:
    job = collection_job(applications_from(ENTRY, Path(), "x"), "collection", "t2rgb", 3, inputs=DATASETS)
    containers = {container.name: container for container in job.containers}
    assert list(containers) == ["master", "simulation", "robot", "player"]
    assert containers["simulation"].command[-1] == "seed:=3"
    assert containers["robot"].command[-1] == f"out:={OUTPUT}/dataset"
    player = containers["player"]
    assert set(player.after) == {"master", "simulation", "robot"}
    assert player.image == "robot:1"
    assert (containers["robot"].success, player.success) == ((), (0,))  # roslaunch answers 0 whatever has died
    assert {mount.target for mount in player.mounts} == {INPUT_FOLDER}
    assert {PLAYER_PATH, MOTION_PATH} <= set(player.command)
    assert player.artifacts == (Artifact(f"{OUTPUT}/dataset"), Artifact(REPORT_PATH, required=False))
    assert all(not mount.writable for container in job.containers for mount in container.mounts)


def test_one_of_the_containers_plays() -> None:
    entry = {**ENTRY, "dataset": "/data/set"}
    del entry["player"]
    job = collection_job(applications_from(entry, Path(), "x"), "collection", "t2rgb", 3)
    assert [container.name for container in job.containers] == ["master", "simulation", "robot"]
    assert job.containers[-1].artifacts == (Artifact("/data/set"),)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ros": "none"}, "x: player: ros1 needs a ROS master; add ros: 1"),
        ({"containers": {"robot": {"command": "run {sed}"}}}, "did you mean 'seed'"),
        ({"containers": {"master": {"command": "run"}}}, "master"),
        ({"containers": {"robot": {"command": "run", "after": ["robt"]}}}, "robt"),
        ({"dataset": "data"}, "data"),
        ({"timeout": "x"}, "x: timeout: found 'x', expected a time"),
    ],
)
def test_errors_are_raised_before_anything_runs(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        applications_from({**ENTRY, **changes}, Path(), "x")


def test_the_dataset_is_checked_and_calibrated(collected: Path, tmp_path: Path) -> None:
    report = [{"pose": n, "saved": n != 3, "answer": "" if n != 3 else "no board\nseen"} for n in range(1, 6)]
    backend = LeavesBehind(copying(collected, report))
    results = collect_dataset(request(target=at(backend)), tmp_path / "out")
    assert results.verdict == "pass"
    assert results.proof is not None
    assert results.proof.translation_mm is not None
    assert results.proof.translation_mm < 0.5
    assert [record.number for record in results.lost] == [2]
    assert "no board" in results.lost[0].lost[0]
    assert [record.number for record in results.kept] == [0, 1, 3, 4]
    document = json.loads((tmp_path / "out" / "results.json").read_text())
    assert (document["poses"], document["kept"], document["corner_rms_px"]) == (5, 4, None)
    assert document["sensors"]["left_camera"]["detected"] >= 3
    left = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"dataset.json", "ground_truth.json", "motion.json", "contact_sheet.png", "logs", "robot.urdf"} <= left
    assert not [name for name in left if name.startswith(".")]
    assert (tmp_path / "out" / "logs" / "robot.log").read_text() == "hello\n"
    [job] = backend.jobs
    assert job.seconds == 3600
    assert backend.seen == 3 * [{"motion.json", "player.py"}]  # a folder, as no cloud mounts files


def test_collections_are_named_as_the_dataset_names_them(collected: Path, tmp_path: Path) -> None:
    results = collect_dataset(request(target=at(LeavesBehind(copying(collected)))), tmp_path / "out")
    assert [record.key for record in results.records] == ["000", "001", "002", "003"]
    assert "000,1,yes" in (tmp_path / "out" / "poses.csv").read_text()


def test_a_collection_again_replaces_all_of_the_earlier_one(collected: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    collect_dataset(request(target=at(LeavesBehind(copying(collected)))), output)
    (output / "logs" / "old.log").write_text("old")
    with pytest.raises(InputError, match="exists already"):
        collect_dataset(request(target=at(LeavesBehind(copying(collected)))), output)
    collect_dataset(request(target=at(LeavesBehind(copying(collected)))), output, overwrite=True)
    assert [path.name for path in (output / "logs").iterdir()] == ["robot.log"]


@pytest.mark.parametrize(
    ("code", "error"),
    [
        (ExitCode.FAIL, None),
        (ExitCode.BAD_INPUT, ExitCode.BAD_INPUT),
        (ExitCode.INFRASTRUCTURE, ExitCode.INFRASTRUCTURE),
    ],
)
def test_failed_applications_give_a_reason(tmp_path: Path, code: ExitCode, error: ExitCode | None) -> None:
    outcome = {"exit_code": code, "reasons": ("robot: exited with code 3",)}
    results = collect_dataset(request(target=at(LeavesBehind(lambda _: None, outcome))), tmp_path / "out")
    assert results.exit_code == code
    assert results.error == error
    assert results.reasons == ["robot: exited with code 3"]
    document = json.loads((tmp_path / "out" / "results.json").read_text())
    assert (document["verdict"], document["dataset"], document["contact_sheet"]) == ("fail", None, None)
    assert (tmp_path / "out" / "logs" / "robot.log").exists()


def reasons_of(dataset: Path, tmp_path: Path, **changes: Any) -> CollectionResults:
    return collect_dataset(request(target=at(LeavesBehind(copying(dataset))), **changes), tmp_path / "out")


def changed(collected: Path, tmp_path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    folder = tmp_path / "changed"
    shutil.copytree(collected, folder)
    document = json.loads((folder / "dataset.json").read_text())
    change(document)
    (folder / "dataset.json").write_text(json.dumps(document))
    return folder


def test_a_dataset_that_is_none_has_failed(collected: Path, tmp_path: Path) -> None:
    broken = changed(collected, tmp_path, lambda document: document.pop("sensors"))
    results = reasons_of(broken, tmp_path)
    assert (results.verdict, results.error) == ("fail", None)
    assert results.reasons[0].startswith("dataset.json")
    assert not (tmp_path / "out" / "dataset.json").exists()


def test_a_sensor_that_the_system_has_is_missed(collected: Path, tmp_path: Path) -> None:
    def drop(document: dict[str, Any]) -> None:
        for place in (document["sensors"], document["calibration_config"]["sensors"]):
            del place["left_camera"]
        for collection in document["collections"].values():
            for place in (collection["data"], *collection["labels"].values()):
                del place["left_camera"]

    results = reasons_of(changed(collected, tmp_path, drop), tmp_path)
    assert results.reasons == ["dataset.json: missing sensor 'left_camera' (it has right_camera)"]


def test_a_file_outside_of_the_folder_is_not_drawn(collected: Path, tmp_path: Path) -> None:
    def leave(document: dict[str, Any]) -> None:
        for collection in document["collections"].values():
            collection["data"]["left_camera"]["data_file"] = "../../../etc/passwd"

    results = reasons_of(changed(collected, tmp_path, leave), tmp_path)
    assert {r.collection["data"]["left_camera"]["data_file"] for r in results.kept} == {"missing"}


def test_checks_and_truth(collected: Path, tmp_path: Path) -> None:
    few = reasons_of(collected, tmp_path, checks=CollectionChecks(minimum_collections=9))
    assert few.reasons == ["collections: found 4, expected at least 9"]
    shutil.rmtree(tmp_path / "out")
    free = reasons_of(collected, tmp_path, truth="none")
    assert free.verdict == "pass"
    assert free.proof is not None
    assert free.proof.translation_mm is None


def test_without_a_system_nothing_is_known_of_it(collected: Path, tmp_path: Path) -> None:
    entry = {**ENTRY, "ros": "none"}
    del entry["player"]
    asked = CollectionRequest(applications=applications_from(entry, Path(), "x"), name="theirs", truth="dataset")
    results = collect_dataset(replace(asked, target=at(LeavesBehind(copying(collected)))), tmp_path / "out")
    assert results.verdict == "pass"
    assert not results.contact_sheet
    assert results.motion == "the motion of the applications"


@pytest.mark.parametrize("report", ["[", '{"a": 1}', '[{"pose": "x"}]', "[" * 100_000])
def test_a_report_that_is_none_is_refused(collected: Path, tmp_path: Path, report: str) -> None:
    def leave(artifacts: Path) -> None:
        shutil.copytree(collected, artifacts / "dataset")
        (artifacts / Path(REPORT_PATH).name).write_text(report)

    results = collect_dataset(request(target=at(LeavesBehind(leave))), tmp_path / "out")
    assert results.reasons == [".player.json: this is no report of the player"]


def test_our_player_needs_a_motion_of_a_pattern(tmp_path: Path) -> None:
    asked = CollectionRequest(applications=applications_from(ENTRY, Path(), "x"), name="fresh")
    with pytest.raises(InputError, match="our player needs a motion"):
        collect_dataset(replace(asked, target=at(LeavesBehind(lambda _: None))), tmp_path / "out")
    with pytest.raises(InputError, match="a motion is only generated for a system"):
        collect_dataset(replace(asked, motion="generate:3"), tmp_path)
    with pytest.raises(InputError, match="moves joints"):
        collect_dataset(replace(asked, system=DATASETS / "riwbot"), tmp_path)


def recorded(collected: Path, output: Path, end: End, code: int | None = None) -> CollectionResults:
    """Collect with a recorder that leaves a bag, and ends so."""

    def leave(artifacts: Path) -> None:
        copying(collected)(artifacts)
        (artifacts / "messages").mkdir()
        (artifacts / "messages" / "robot.bag").write_bytes(b"#ROSBAG V2.0\n")

    outcome = {"containers": (ContainerOutcome("recorder", end, code),)}
    applications = applications_from({**ENTRY, "record": {"size": "500m"}}, Path(), "x")
    asked = CollectionRequest(DATASETS / "t2rgb", applications, name="fresh", seed=3)
    return collect_dataset(replace(asked, target=at(LeavesBehind(leave, outcome))), output)


def test_the_recorded_bag_is_kept_beside_the_dataset(collected: Path, tmp_path: Path) -> None:
    assert recorded(collected, tmp_path / "out", End.STOPPED).verdict == "pass"
    assert (tmp_path / "out/messages/robot.bag").exists()


def test_a_bag_that_became_too_large_fails_the_collection(collected: Path, tmp_path: Path) -> None:
    results = recorded(collected, tmp_path / "out", End.EXITED, 3)
    assert results.verdict == "fail"
    assert "has reached 500 MiB" in results.failures[0]


def test_a_recording_needs_ros() -> None:
    entry = {key: value for key, value in ENTRY.items() if key not in ("ros", "player")}
    with pytest.raises(InputError, match=r"x: .*record needs ros: 1 or 2"):
        applications_from({**entry, "record": {}}, Path(), "x")
