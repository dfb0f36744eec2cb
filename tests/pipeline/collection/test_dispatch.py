"""A dataset collected, proven and judged: its files, and the reasons of a red verdict."""

import csv
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import jsonschema
import pytest

from calibration.base import ExitCode, InfrastructureError, InputError, escape_markdown, write_atomically
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.report import SCHEMA_FILE, report
from calibration.pipeline.collection.request import CollectionChecks, CollectionLimits, CollectionRequest
from calibration.pipeline.collection.results import CollectionResults
from calibration.robot.simulation import record as poses
from calibration.robot.simulation.proof import JointProof, Proof
from tests.pipeline.conftest import DATASETS
from tests.small import first_poses

POSES = 5


@pytest.fixture(scope="module")
def motion(small: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first poses of the system's motion; the second is far above the cameras."""
    path = first_poses(small, POSES, tmp_path_factory.mktemp("motion") / "some.json")
    some = json.loads(path.read_text())
    some["2"]["position"]["z"] += 5
    path.write_text(json.dumps(some))
    return path


@pytest.fixture(scope="module")
def request_(small: Path, motion: Path) -> CollectionRequest:
    return CollectionRequest(small, motion=str(motion))


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("collected")


@pytest.fixture(scope="module")
def results(request_: CollectionRequest, output: Path) -> CollectionResults:
    return collect_dataset(request_, output)


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_good_one_passes(results: CollectionResults) -> None:
    assert results.verdict == "pass"
    assert results.exit_code == ExitCode.PASS
    assert len(results.kept) == POSES - 1
    assert results.proof is not None
    assert results.proof.translation_mm is not None
    assert results.proof.translation_mm < 1
    assert report(results, Path()).line.startswith(
        f"pass: small: {POSES - 1} of {POSES} collections kept, calibrates with 0."
    )


def test_the_folder_has_all_files(results: CollectionResults, output: Path) -> None:
    files = snapshot(output)
    assert {"dataset.json", "ground_truth.json", "motion.json", "results.json", "poses.csv", "summary.md"} <= set(files)
    assert {"contact_sheet.png", "junit.xml", "left_camera_000.jpg", "right_camera_004.jpg"} <= set(files)
    assert "left_camera_001.jpg" not in files  # lost
    assert not any(name.startswith(".") for name in files)
    document = json.loads(files["results.json"])
    jsonschema.validate(document, json.loads(SCHEMA_FILE.read_text()))
    assert document["lost"] == [{"pose": 2, "reasons": list(results.records[1].lost)}]
    rows = list(csv.DictReader(files["poses.csv"].decode().splitlines()))
    assert [row["Kept"] for row in rows] == ["yes", "no", "yes", "yes", "yes"]
    assert rows[1]["Reasons"].startswith("left_camera: ")
    assert f"pose 2 lost: {escape_markdown(results.records[1].lost[0])}" in files["summary.md"].decode()
    assert b'failures="0"' in files["junit.xml"]


def test_the_contact_sheet_shows_every_pose(results: CollectionResults, output: Path) -> None:
    sheet = cv2.imread(str(output / "contact_sheet.png"))
    assert sheet is not None
    red = (sheet[..., 2].astype(int) - sheet[..., 1] > 100) & (sheet[..., 2].astype(int) - sheet[..., 0] > 100)
    height, width = red.shape
    assert 1000 < width < 2400
    columns = red.any(axis=0)
    assert columns.any()  # the frame of the lost pose
    assert len({tuple(colour) for colour in sheet[::4, ::4].reshape(-1, 3).tolist()}) > 200  # images, not blanks
    assert height > 300


def test_the_same_bytes_again_and_with_other_processes(
    results: CollectionResults, request_: CollectionRequest, output: Path, tmp_path: Path
) -> None:
    collect_dataset(request_, tmp_path / "one", jobs=1)
    collect_dataset(request_, tmp_path / "three", jobs=3)
    assert snapshot(tmp_path / "one") == snapshot(tmp_path / "three") == snapshot(output)


def test_an_interrupted_one_leaves_no_dataset_and_goes_on(
    results: CollectionResults,
    request_: CollectionRequest,
    output: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done: list[int] = []

    def interrupt(count: int, *_: object) -> None:
        done.append(count)
        if count == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect_dataset(request_, tmp_path, jobs=1, done=interrupt)
    assert all(name.startswith(".unfinished/") for name in snapshot(tmp_path))
    made = []
    pose = poses.collect_pose
    monkeypatch.setattr(poses, "collect_pose", lambda *a, **k: made.append(a[1]) or pose(*a, **k))  # type: ignore[func-returns-value]
    assert collect_dataset(request_, tmp_path, jobs=1) == results
    assert made == [3, 4]
    assert snapshot(tmp_path) == snapshot(output)


def test_another_seed_does_not_go_on_with_what_is_there(request_: CollectionRequest, tmp_path: Path) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect_dataset(request_, tmp_path, jobs=1, done=interrupt)
    assert list((tmp_path / ".unfinished").glob("*.result.json"))
    other = replace(request_, seed=7)
    collect_dataset(other, tmp_path, jobs=1)
    collect_dataset(other, tmp_path / "fresh", jobs=1)
    fresh = snapshot(tmp_path / "fresh")
    assert {name: content for name, content in snapshot(tmp_path).items() if not name.startswith("fresh/")} == fresh


def test_a_full_disk_loses_nothing(
    request_: CollectionRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    writes = 0

    def full(path: Path | str, content: bytes | str) -> None:
        nonlocal writes
        writes += 1
        if writes > 5:
            raise InfrastructureError(f"{path}: cannot be written: No space left on device")
        write_atomically(path, content)

    monkeypatch.setattr("calibration.ci.execution.tasks.write_atomically", full)
    with pytest.raises(InfrastructureError, match="No space left on device"):
        collect_dataset(request_, tmp_path, jobs=1)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert not (tmp_path / "dataset.json").exists()
    monkeypatch.undo()
    assert collect_dataset(request_, tmp_path, jobs=1).verdict == "pass"


def test_without_detections_it_fails_with_a_reason(request_: CollectionRequest, tmp_path: Path) -> None:
    poses = json.loads(Path(str(request_.motion)).read_text())
    away = tmp_path / "away.json"
    away.write_text(json.dumps({"1": poses["2"]}))
    results = collect_dataset(replace(request_, motion=str(away)), tmp_path / "output")
    assert results.verdict == "fail"
    assert results.reasons[0] == "collections: found 0, expected at least 3"
    assert "translation error against the truth: found no value, expected at most 5 mm" in results.reasons
    files = set(snapshot(tmp_path / "output"))
    assert "dataset.json" not in files
    assert {"results.json", "summary.md", "contact_sheet.png"} <= files
    jsonschema.validate(report(results, Path()).document, json.loads(SCHEMA_FILE.read_text()))
    assert report(results, tmp_path).outputs["dataset"] is None


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (CollectionChecks(minimum_collections=5), "collections: found 4, expected at least 5"),
        (
            CollectionChecks(minimum_detection_rate=0.9),
            "detection rate of left_camera: found 0.8, expected at least",
        ),
        (CollectionChecks(minimum_coverage=1), "coverage of "),
        (CollectionChecks(limits=CollectionLimits(translation_mm=1e-6)), "translation error against the truth: found "),
        (CollectionChecks(limits=CollectionLimits(rotation_deg=1e-9)), "rotation error against the truth: found "),
    ],
)
def test_each_limit_turns_it_red(results: CollectionResults, limits: CollectionChecks, reason: str) -> None:
    judged = replace(results, limits=limits)
    assert judged.exit_code == ExitCode.FAIL
    assert any(each.startswith(reason) for each in judged.reasons)
    assert escape_markdown(reason.split(":")[0]) in report(judged, Path()).markdown()


def test_without_limits_it_still_has_to_calibrate(results: CollectionResults) -> None:
    free = CollectionChecks(minimum_collections=1)
    assert replace(results, limits=free).verdict == "pass"
    lost = replace(results, limits=free, proof=Proof(False, "no minimum"))
    assert lost.reasons == ["the dataset does not calibrate: no minimum"]


def test_a_joint_that_is_off_the_truth_turns_it_red(results: CollectionResults) -> None:
    assert results.proof is not None
    joints = (
        JointProof("slide", "origin_z", "m", 0.1, 1e-4, 0.006),
        JointProof("elbow", "origin_yaw", "rad", 0, 1, 1e-3),
    )
    off = replace(results, proof=replace(results.proof, joints=joints))
    assert off.reasons == ["joint translation error against the truth: found 6 mm, expected at most 5 mm"]
    assert "joints 6 mm and 0.057 deg from the truth" in report(off, Path()).line
    turned = replace(off, limits=CollectionChecks(limits=CollectionLimits(7, 0.05)))
    assert turned.reasons == ["joint rotation error against the truth: found 0.0573 deg, expected at most 0.05 deg"]
    assert replace(off, limits=CollectionChecks(limits=CollectionLimits(None, 0.3))).verdict == "pass"


def test_a_dataset_is_not_overwritten_unless_asked(
    results: CollectionResults, request_: CollectionRequest, output: Path
) -> None:
    before = snapshot(output)
    with pytest.raises(InputError, match="exists already; --overwrite replaces the dataset"):
        collect_dataset(request_, output)
    assert snapshot(output) == before


@pytest.mark.parametrize(
    "words",
    [
        ("collect-data-sim", "--system", str(DATASETS / "t2rgb"), "--output"),
        ("run", "--config", "calibration.yml", "--only", "collect", "--output"),
    ],
)
def test_without_opencv_the_error_names_the_package(words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "calibration.yml").write_text(f"simulation: {{a: {{system: {DATASETS / 't2rgb'}}}}}\n")
    code = "import sys; sys.modules['cv2'] = None; from calibration.__main__ import main; sys.exit(main())"
    command = [sys.executable, "-c", code, *words, str(tmp_path / "output")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == ExitCode.INFRASTRUCTURE
    assert "the package cv2 is not installed: pip install opencv-python-headless" in done.stderr
    assert len(done.stderr.splitlines()) == 1
