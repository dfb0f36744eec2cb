"""Intrinsics in the files of other tools, and what they lack."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.dataset.reading import read_dataset
from calibration.errors import InputError
from calibration.exports.calibrated import calibrated
from calibration.exports.formats import FILES
from calibration.geometry.distortion import MODELS
from calibration.geometry.transforms import inverse
from calibration.importing.camera_files import read_lens
from tests.importing.conftest import DATASETS, camera_info


@pytest.mark.parametrize("kind", ["camera-info", "kalibr", "opencv"])
def test_what_export_writes_is_read(tmp_path: Path, kind: str) -> None:
    dataset = read_dataset(DATASETS / "t2rgb")
    ((_, text),) = list(FILES[kind](calibrated(dataset)).items())[:1]
    (tmp_path / "file.yaml").write_text(text)
    names = {"kalibr": "cam0", "opencv": next(iter(dataset.sensors))}
    lens = read_lens(tmp_path / "file.yaml", names.get(kind))
    assert lens.has_size
    camera = next(iter(dataset.sensors.values())).camera
    assert camera is not None
    assert lens.camera.intrinsics[:4].tolist() == pytest.approx(camera.intrinsics[:4].tolist())
    assert (lens.camera.width, lens.camera.height) == (camera.width, camera.height)


def test_opencv_samples_files_are_read(tmp_path: Path) -> None:
    (tmp_path / "file.yml").write_text(
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n"
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [500., 0., 320., 0., 501., 240., 0., 0., 1.]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
        "   data: [ -0.1, 0.2, 0., 0., 0. ]\n"
    )
    camera = read_lens(tmp_path / "file.yml").camera
    assert camera.intrinsics.tolist() == [500, 501, 320, 240, -0.1, 0.2, 0, 0, 0]


def test_a_fisheye_of_kalibr(tmp_path: Path) -> None:
    cam = {
        "camera_model": "pinhole",
        "intrinsics": [300, 301, 320, 240],
        "distortion_model": "equidistant",
        "distortion_coeffs": [0.1, 0.01, 0, 0],
        "resolution": [640, 480],
    }
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump({"cam0": cam, "cam1": cam}))
    lens = read_lens(tmp_path / "chain.yaml", "cam1")
    assert isinstance(lens.camera.distortion, MODELS["equidistant"])
    with pytest.raises(InputError, match="has several cameras: add 'camera' with one of cam0, cam1"):
        read_lens(tmp_path / "chain.yaml")
    with pytest.raises(InputError, match="expected 'cam2'"):
        read_lens(tmp_path / "chain.yaml", "cam2")


def test_baselines_of_a_camchain_are_poses_in_its_first_camera(tmp_path: Path) -> None:
    dataset = read_dataset(DATASETS / "t2rgb")
    of = calibrated(dataset)
    (text,) = FILES["kalibr"](of).values()
    chain = yaml.safe_load(text)
    chain["cam2"], chain["cam10"] = chain["cam1"], chain["cam0"]
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(chain))
    first, second = (of.poses[name] for name in list(of.cameras)[:2])
    expected = inverse(first) @ second
    poses = {name: read_lens(tmp_path / "chain.yaml", name).T_chain_camera for name in chain}
    np.testing.assert_allclose(poses["cam0"], np.eye(4))
    np.testing.assert_allclose(poses["cam1"], expected, atol=1e-9)
    np.testing.assert_allclose(poses["cam2"], expected @ expected, atol=1e-9)
    assert poses["cam10"] is None


@pytest.mark.parametrize(
    "baseline", [[], 1, [[1, 0, 0, 0]], [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], [[0] * 4] * 4]
)
def test_a_baseline_that_is_none_is_named(tmp_path: Path, baseline: object) -> None:
    (text,) = FILES["kalibr"](calibrated(read_dataset(DATASETS / "t2rgb"))).values()
    chain = yaml.safe_load(text)
    chain["cam1"]["T_cn_cnm1"] = baseline
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump(chain))
    with pytest.raises(InputError, match=r"chain\.yaml: cam1/T_cn_cnm1: ") as error:
        read_lens(tmp_path / "chain.yaml", "cam1")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found null, expected an object"),
        ("a: 1", "found no camera in it, expected ROS's camera_info"),
        (yaml.safe_dump({**camera_info(), "image_width": 0}), "width: found 0"),
        (yaml.safe_dump(camera_info(focal=-1)), "fx, fy > 0"),
        (yaml.safe_dump({**camera_info(), "distortion_model": "fov"}), "a known distortion model"),
        ("%YAML:1.0\n---\nK: [", "this is not valid YAML"),
        ("%YAML:1.0\n---\nK: &a [1]\nb: *a\n", "found an alias"),
        ("cam0: {camera_model: omni}", "camera_model: found 'omni', expected pinhole"),
        ("intrinsics: {fx: 1}", "missing key 'fy'"),
    ],
)
def test_what_is_no_camera_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "file.yaml").write_text(text)
    with pytest.raises(InputError, match=r"file\.yaml") as error:
        read_lens(tmp_path / "file.yaml")
    assert message in str(error.value)
