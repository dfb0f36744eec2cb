"""Folders of images become datasets that calibrate as those that were simulated with them."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.evaluation.truth import choose_truth
from calibration.engine.geometry.rotations import to_quaternion
from calibration.engine.geometry.transforms import distance
from calibration.robot.importing import importing
from calibration.robot.importing.importing import import_data
from tests.robot.importing.conftest import BOARD, CAMERAS, DATASETS, change

LEFT, RIGHT = CAMERAS


def with_truth(dataset: Dataset) -> Dataset:
    """A simulated dataset with the true transforms of its sensors."""
    truth = choose_truth(dataset, None)
    assert truth is not None
    return dataset.with_transforms({edge: truth.transforms[edge] for edge in truth.sensors.values()})


def true_relative() -> np.ndarray:
    """``T_right_left`` of t2rgb as it was simulated."""
    dataset = read_dataset(DATASETS / "t2rgb")
    found = with_truth(dataset)
    return found.transform("camera_right_rgb_optical_frame", "camera_left_rgb_optical_frame")[0]


def test_the_labels_are_those_of_the_simulation(stereo: Path, tmp_path: Path) -> None:
    results = import_data(stereo / "import.yml", tmp_path / "out", jobs=1)
    imported, known = read_dataset(tmp_path / "out"), read_dataset(DATASETS / "t2rgb")
    assert (results.moments, results.collections, results.together) == (6, 6, 6)
    for collection, other in zip(imported.collections, known.collections[:6], strict=True):
        for camera in CAMERAS:
            ours, theirs = collection.labels["board", camera], other.labels["pattern_1", camera]
            assert isinstance(ours, CornerLabels)
            assert isinstance(theirs, CornerLabels)
            common, mine, other_place = np.intersect1d(ours.ids, theirs.ids, return_indices=True)
            assert len(common) >= 0.95 * len(theirs.ids)
            errors = np.linalg.norm(ours.pixels[mine] - theirs.pixels[other_place], axis=-1)
            assert np.median(errors) < 0.1  # those of the simulation are of the image before it became a JPEG
    assert imported.sensors[LEFT].camera == known.sensors[LEFT].camera
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.suffix == ".jpg") == sorted(
        f"{camera}_{number:03d}.jpg" for camera in CAMERAS for number in range(6)
    )


def test_it_calibrates_to_the_truth(stereo: Path, tmp_path: Path) -> None:
    import_data(stereo / "import.yml", tmp_path / "out", jobs=1)
    calibration = calibrate(read_dataset(tmp_path / "out"), Options(description="rough"))
    found = calibration.dataset.transform(f"{RIGHT}_optical_frame", f"{LEFT}_optical_frame")[0]
    mm, deg = (float(v) for v in distance(true_relative(), found))
    assert mm < 1e-3
    assert np.degrees(deg) < 0.05


def test_unknown_intrinsics_are_calibrated_from_an_initial_guess(tmp_path: Path) -> None:
    folder = tmp_path / "all"
    folder.mkdir()
    for path in (DATASETS / "t2rgb").glob("*_camera_*.jpg"):
        shutil.copy(path, folder)
    sensors = {camera: {"images": f"{camera}_*.jpg"} for camera in CAMERAS}
    sensors[RIGHT]["model"] = "fisheye"
    (folder / "import.yml").write_text(json.dumps({"sensors": sensors, "patterns": {"board": BOARD}}))
    results = import_data(folder / "import.yml", tmp_path / "out", jobs=1)
    assert {each.intrinsics for each in results.sensors.values()} == {"estimated"}
    dataset = read_dataset(tmp_path / "out")
    for camera in CAMERAS:
        start = dataset.sensors[camera].camera
        assert start is not None
        assert start.fx == pytest.approx(554.26, rel=0.01)
    calibration = calibrate(dataset, Options(description="rough", intrinsics=("all",)))
    chosen = [calibration.dataset.sensors[camera].camera for camera in (LEFT, RIGHT)]
    assert [each and each.distortion.ros_name for each in chosen] == ["plumb_bob", "equidistant"]
    focal, sigma = calibration.intrinsics[LEFT].values[0], calibration.intrinsics[LEFT].sigmas[0]
    assert focal == pytest.approx(554.256, abs=4 * sigma)
    assert 0 < sigma < 3


def test_an_unknown_lens_model_is_bad_input(stereo: Path, tmp_path: Path) -> None:
    change(stereo, "sensors", LEFT, "intrinsics", to=None)
    change(stereo, "sensors", LEFT, "model", to="pinhole-ish")
    with pytest.raises(
        InputError, match=r"found the lens model 'pinhole-ish' in import\.yml, expected one of plumb_bob"
    ):
        import_data(stereo / "import.yml", tmp_path / "out", jobs=1)


def test_a_killed_import_goes_on_where_it_was(stereo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(done: int, total: int, _: object) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_data(stereo / "import.yml", tmp_path / "out", jobs=1, done=stop)
    assert [path.name for path in (tmp_path / "out").iterdir()] == [".unfinished"]
    finished = len(list((tmp_path / "out" / ".unfinished").glob("*.result.json")))
    assert finished >= 3
    seen = []
    looked = importing.view_of_file
    monkeypatch.setattr(
        importing, "view_of_file", lambda path, detectors: (seen.append(path), looked(path, detectors))[1]
    )
    counts: list[int] = []
    import_data(stereo / "import.yml", tmp_path / "out", jobs=1, done=lambda done, *_: counts.append(done))
    assert counts == [1, 2, 3, 4, 5, 6]
    assert not (tmp_path / "out" / ".unfinished").exists()
    assert len(read_dataset(tmp_path / "out").collections) == 6


def test_an_image_that_changed_is_looked_at_again(stereo: Path, tmp_path: Path) -> None:
    def stop(done: int, *_: object) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_data(stereo / "import.yml", tmp_path / "out", jobs=1, done=stop)
    shutil.copy(stereo / LEFT / "5.jpg", stereo / LEFT / "0.jpg")
    with pytest.raises(InputError, match=r"5\.jpg: found the same pixels as in .*0\.jpg"):
        import_data(stereo / "import.yml", tmp_path / "out", jobs=1)


def test_a_dataset_stays_unless_it_is_to_be_replaced(stereo: Path, tmp_path: Path) -> None:
    import_data(stereo / "import.yml", tmp_path / "out", jobs=1)
    with pytest.raises(InputError, match="exists already"):
        import_data(stereo / "import.yml", tmp_path / "out", jobs=1)
    before = (tmp_path / "out" / "dataset.json").read_bytes()
    import_data(stereo / "import.yml", tmp_path / "out", overwrite=True, jobs=1)
    assert (tmp_path / "out" / "dataset.json").read_bytes() == before


def test_images_without_a_pattern_are_named_and_left_out(stereo: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(stereo / LEFT / "2.jpg"), np.full((480, 640, 3), 90, np.uint8))
    for camera in CAMERAS:
        cv2.imwrite(str(stereo / camera / "3.jpg"), np.full((480, 640, 3), 90, np.uint8))
    results = import_data(stereo / "import.yml", tmp_path / "out", jobs=1)
    assert (results.moments, results.collections, results.together) == (6, 5, 4)
    assert [Path(view.file).name for view in results.sensors[LEFT].rejected] == ["2.jpg", "3.jpg"]
    assert "markers" in results.sensors[LEFT].rejected[0].reason


def test_a_camera_that_watches_an_arm(tmp_path: Path) -> None:
    """riwbot's own images with its arm's poses, as a CSV: the camera comes out where it was simulated."""
    riwbot = read_dataset(DATASETS / "riwbot")
    T = riwbot.transform("base_link", "flange")
    folder = tmp_path / "arm"
    folder.mkdir()
    lines = ["image,x,y,z,qx,qy,qz,qw"]
    for key, pose in zip(riwbot.keys, T, strict=True):
        shutil.copy(DATASETS / "riwbot" / f"rgb_world_{key}.jpg", folder)
        numbers = [*pose[:3, 3].tolist(), *to_quaternion(pose[:3, :3]).tolist()]
        lines.append(",".join([f"rgb_world_{key}.jpg", *map(repr, numbers)]))
    (folder / "poses.csv").write_text("\n".join(lines))
    camera = riwbot.sensors["rgb_world"].camera
    assert camera is not None
    intrinsics = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
    (folder / "camera.yaml").write_text(json.dumps({"intrinsics": intrinsics}))
    board = {**BOARD, "columns": 7, "rows": 7, "square": 0.02, "marker": 0.015, "dictionary": "DICT_4X4_100"}
    description = {
        "sensors": {"rgb_world": {"parent": "base_link", "intrinsics": "camera.yaml"}},
        "patterns": {"board": {**board, "parent": "tool0"}},
        "samples": {"file": "poses.csv"},
    }
    (folder / "import.yml").write_text(json.dumps(description))
    import_data(folder / "import.yml", tmp_path / "out", jobs=1)
    found = calibrate(read_dataset(tmp_path / "out"), Options(description="rough")).dataset
    true = with_truth(riwbot).transform("base_link", riwbot.sensors["rgb_world"].frame)[0]
    m, rad = (float(v) for v in distance(true, found.transform("base_link", "rgb_world_optical_frame")[0]))
    assert m < 1e-3
    assert np.degrees(rad) < 0.05


def test_images_and_files_of_poses_belong_together_by_their_numbers(tmp_path: Path) -> None:
    """A pose and an image that have no counterpart are left out and counted."""
    riwbot = read_dataset(DATASETS / "riwbot")
    folder = tmp_path / "recorded"
    for name in ("images", "poses"):
        (folder / name).mkdir(parents=True)
    poses = riwbot.transform("base_link", "flange")
    for i, key in enumerate(riwbot.keys[:7]):
        if i != 2:
            np.savetxt(folder / "poses" / f"pose_{i}.txt", poses[i])
        if i != 4:
            (folder / "images" / f"img{i:03}.jpg").symlink_to((DATASETS / "riwbot" / f"rgb_world_{key}.jpg").resolve())
    board = {**BOARD, "columns": 7, "rows": 7, "square": 0.02, "marker": 0.015, "dictionary": "DICT_4X4_100"}
    description = {
        "sensors": {"camera": {"images": "images", "parent": "base_link"}},
        "patterns": {"board": {**board, "parent": "tool0"}},
        "samples": {"file": "poses"},
    }
    (folder / "import.yml").write_text(json.dumps(description))
    results = import_data(folder / "import.yml", tmp_path / "out", jobs=1)
    assert (results.moments, results.collections) == (5, 5)
    assert [(each.place, each.count) for each in results.left_out] == [("poses", 1), ("images", 1)]
    found = read_dataset(tmp_path / "out").transforms["base_link", "tool0"]
    np.testing.assert_allclose(found, poses[[0, 1, 3, 5, 6]], atol=1e-9)


def test_a_table_without_a_head_names_images_of_the_folder(tmp_path: Path) -> None:
    riwbot = read_dataset(DATASETS / "riwbot")
    poses = riwbot.transform("base_link", "flange")[:5]
    (tmp_path / "images").mkdir()
    lines = []
    for key, pose in zip(riwbot.keys, poses, strict=False):
        (tmp_path / "images" / f"{key}.jpg").symlink_to((DATASETS / "riwbot" / f"rgb_world_{key}.jpg").resolve())
        numbers = [*pose[:3, 3].tolist(), *to_quaternion(pose[:3, :3]).tolist()]
        lines.insert(0, ", ".join([f"{key}.jpg", *map(repr, numbers)]))
    (tmp_path / "poses.txt").write_text("\n".join(lines))
    board = {**BOARD, "columns": 7, "rows": 7, "square": 0.02, "marker": 0.015, "dictionary": "DICT_4X4_100"}
    description = {
        "sensors": {"camera": {"images": "images", "parent": "base_link"}},
        "patterns": {"board": {**board, "parent": "tool0"}},
        "samples": {"file": "poses.txt"},
    }
    (tmp_path / "import.yml").write_text(json.dumps(description))
    assert import_data(tmp_path / "import.yml", tmp_path / "out", jobs=1).collections == 5
    found = read_dataset(tmp_path / "out")
    np.testing.assert_allclose(found.transforms["base_link", "tool0"], poses[::-1], atol=1e-9)
    (tmp_path / "poses.txt").write_text("\n".join(["missing.jpg, 0, 0, 0, 0, 0, 0, 1", *lines]))
    with pytest.raises(InputError, match=r"missing\.jpg"):
        import_data(tmp_path / "import.yml", tmp_path / "again", jobs=1)


def test_the_photographs_of_a_real_arm(shared_data: Path, tmp_path: Path) -> None:
    """16 of 16 images are labelled, and the optimum is the known one: 2.64 px without the lens's distortion."""
    data = shared_data / "real-arm"
    description = {
        "sensors": {"camera": {"parent": "base_link", "intrinsics": str(data / "camera_intr_calibrated.yaml")}},
        "patterns": {"board": {"target": str(data / "target.yaml"), "parent": "tool0"}},
        "samples": {"file": str(data / "cal_data.yaml")},
    }
    (tmp_path / "import.yml").write_text(json.dumps(description))
    results = import_data(tmp_path / "import.yml", tmp_path / "out", jobs=1)
    assert (results.collections, results.sensors["camera"].corners) == (16, 16 * 24)
    options = replace(Options(description="rough"), loss="linear")
    assert calibrate(read_dataset(tmp_path / "out"), options).rms_px == pytest.approx(2.644, abs=0.05)


def test_patterns_of_files_and_pairs_by_number_or_table(stereo: Path, tmp_path: Path) -> None:
    for number in range(6):
        (stereo / RIGHT / f"{number}.jpg").rename(stereo / RIGHT / f"frame_b{number:04d}.jpg")
    change(stereo, "sensors", RIGHT, "images", to=f"{RIGHT}/*.jpg")
    assert import_data(stereo / "import.yml", tmp_path / "by_number", jobs=1).together == 6
    (stereo / "pairs.csv").write_text(
        f"{RIGHT},{LEFT}\n" + "".join(f"frame_b{n:04d}.jpg,{n}.jpg\n" for n in range(1, 5)) + ",5.jpg\n"
    )
    change(stereo, "pairs", to="pairs.csv")
    results = import_data(stereo / "import.yml", tmp_path / "by_table", jobs=1)
    assert (results.moments, results.together) == (5, 4)
