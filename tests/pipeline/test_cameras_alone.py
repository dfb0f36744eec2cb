"""One camera is a system: init, run, accept, export; and a verdict of its own."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.__main__ import main
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant, PlumbBob
from calibration.robot.importing.files.camera_files import read_lens
from tests.one_camera import LENS, one_camera

BENT = replace(LENS, distortion=PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01))
FISHEYE = Camera(560.0, 557.0, 641.0, 477.0, 1280, 960, Equidistant(-0.02, 0.01, -0.003, 0.001))
CELL = Path("output", "camera", "translation-0_rotation-0_seed-1")


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def numbers(text: str) -> object:
    """Parse JSON, in which no NaN may stand."""

    def refused(word: str) -> float:
        raise AssertionError(f"found {word}")

    return json.loads(text, parse_constant=refused)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("model", [BENT, FISHEYE])
def test_the_four_commands_of_one_camera(repository: Path, model: Camera, capfd: pytest.CaptureFixture[str]) -> None:
    one_camera(repository / "data" / "camera", model)
    assert main(["init", "--dataset", "data/camera"]) == 0
    system = yaml.safe_load(Path("calibration.yml").read_text())["systems"]["camera"]
    assert system["lens"] == {"camera": model.distortion.ros_name}
    assert list(system["limits"]) == ["projection-px"]
    assert main(["run", "--jobs", "1"]) == 0
    cell = numbers((CELL / "results.json").read_text())["cells"][0]  # type: ignore[index]
    (found,) = cell["projection"]
    assert found["model"] == model.distortion.ros_name
    assert 0 < found["median_px"] <= found["most_px"] <= found["worst_px"] < 3
    assert cell["transforms"] == []
    values = {each["parameter"]: each for each in cell["intrinsics"]}
    for name, true in zip(model.parameters, model.intrinsics.tolist(), strict=True):
        assert abs(values[name]["value"] - true) < 4 * values[name]["sigma"]
    page = Path("output", "report.html").read_text()
    assert "Projection of camera, far away" in page
    assert " nan " not in page
    assert ">nan" not in page
    assert main(["accept"]) == 0
    assert main(["run", "--jobs", "1"]) == 0
    exported_are_cameras_only(model, capfd)


def exported_are_cameras_only(model: Camera, capfd: pytest.CaptureFixture[str]) -> None:
    """Hold what is exported of one camera to being its lens, and none of the files of transforms."""
    assert main(["export", "--dataset", str(CELL)]) == 0
    files = {each.name for each in Path("exports").iterdir()}
    of_kalibr = {"camchain.yaml"} if model is FISHEYE else set()  # whose radtan has no k3
    assert files == {"camera_info_camera.yaml", "opencv.yml"} | of_kalibr
    cameras = [read_lens(Path("exports", each)).camera for each in sorted(files)]
    for camera in cameras:
        assert camera.distortion.ros_name == model.distortion.ros_name
        assert np.abs(camera.intrinsics - cameras[0].intrinsics).max() < 1e-9
    capfd.readouterr()
    assert main(["export", "--dataset", str(CELL), "--formats", "tf-static"]) == 2
    assert "'tf-static' is of transforms, and none is calibrated" in capfd.readouterr().err


def test_one_camera_with_given_intrinsics_is_calibrated_as_that_lens(repository: Path) -> None:
    file = one_camera(repository / "data" / "camera", FISHEYE) / "dataset.json"
    document = json.loads(file.read_text())
    document["_metadata"]["estimated_intrinsics"] = []
    file.write_text(json.dumps(document))
    assert main(["init", "--dataset", "data/camera"]) == 0
    system = yaml.safe_load(Path("calibration.yml").read_text())["systems"]["camera"]
    assert system["intrinsics"] == ["camera"]
    assert "lens" not in system
    assert main(["run", "--jobs", "1"]) == 0


def test_another_lens_is_red_against_the_accepted_one(repository: Path, capfd: pytest.CaptureFixture[str]) -> None:
    one_camera(repository / "data" / "camera", BENT)
    main(["init", "--dataset", "data/camera"])
    main(["run", "--jobs", "1"])
    assert main(["accept"]) == 0
    shutil.rmtree(repository / "data" / "camera")
    one_camera(repository / "data" / "camera", BENT, seed=1)
    assert main(["run", "--jobs", "1"]) == 0
    shutil.rmtree(repository / "data" / "camera")
    one_camera(repository / "data" / "camera", replace(BENT, fx=612.0, fy=602.0), seed=2)
    capfd.readouterr()
    assert main(["run", "--jobs", "1"]) == 1
    assert "camera's fx has changed since" in capfd.readouterr().err


def test_too_few_views_are_undecided_in_words_of_their_own(repository: Path, capfd: pytest.CaptureFixture[str]) -> None:
    one_camera(repository / "data" / "camera", BENT, views=6)
    main(["init", "--dataset", "data/camera"])
    text = Path("calibration.yml").read_text()
    Path("calibration.yml").write_text(text.replace("projection-px: 6", "projection-px: 0.05"))
    capfd.readouterr()
    assert main(["run", "--jobs", "1"]) == 1
    assert "6 views are too few: take 20 to 40" in "".join(capfd.readouterr())
    cell = numbers((CELL / "results.json").read_text())["cells"][0]  # type: ignore[index]
    assert [each["severity"] for each in cell["findings"] if each["kind"] == "too-few"] == ["undecided"]


def test_the_recordings_of_others_give_systems(
    repository: Path, shared_data: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    door = shared_data / "door" / "real"
    if not door.is_dir():
        pytest.skip("needs ../shared/data/door beside the project")
    for name, code in (("velodyne-rig", 0), ("webcam", 1), ("aprilgrid", 1)):
        folder = repository / name
        shutil.copytree(door / "06-mono-dead-end" / name / "data", folder / "data")
        assert main(["init", "--dataset", f"{name}/data/robot", "--output", name]) == code, name
    said = capfd.readouterr().out
    assert "5 collections are too few" in said
    assert "labels do not fit the result (5.4 %" in said


@pytest.mark.thorough
def test_a_fisheye_rig_without_intrinsics_is_calibrated(repository: Path, shared_data: Path) -> None:
    door = shared_data / "door" / "real" / "05-fisheye-nan-traceback"
    if not door.is_dir():
        pytest.skip("needs ../shared/data/door beside the project")
    shutil.copytree(door / "data", repository / "data")
    output = ["--output", "output", "--dataset", "data/robot"]
    main(["calibrate-matrix", *output, "--intrinsics", "all", "--evaluate", "rgb-to-rgb:left:right"])
    cell = numbers((Path("output") / "robot" / CELL.name / "results.json").read_text())["cells"][0]  # type: ignore[index]
    assert {each["model"] for each in cell["projection"]} == {"equidistant"}
    place = next(each["trans"] for each in cell["transforms"] if each["child"].startswith("right"))
    assert np.linalg.norm(np.array(place) - [0.1104, 0.0005, -0.0045]) < 0.006  # OpenCV's fisheye
