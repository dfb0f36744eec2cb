"""Intrinsics in the files of other tools, and what they lack."""

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml

import calibration.engine.estimation.covariance.lens_errors as nominal_lens_module
from calibration.base import InputError
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensors import read_uncertainty, uncertainty_document
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.problem.intrinsics import write_intrinsics
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import (
    MODELS,
    SYNONYMS,
    Distortion,
    DoubleSphere,
    Equidistant,
    Eucm,
    Omni,
    PlumbBob,
)
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.exports import FILES, calibrated, kalibr_camchain
from calibration.robot.importing.files.camera_files import read_lens
from tests.engine.estimation.systems import covering
from tests.robot.importing.conftest import DATASETS, camera_info


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


K_AND_D = {"cameraMatrix": [[500, 0, 320], [0, 501, 240], [0, 0, 1]], "distCoeffs": [[-0.1, 0.2, 0, 0, 0.01]]}
STATED = [0.5, 0.6, 0.4, 0.3, 0.002, 0.01, 0.0, 0.0, 0.02]


@pytest.mark.parametrize(
    "deviations",
    [
        {"stdDeviationsIntrinsics": [[each] for each in [*STATED, *[0.0] * 9]]},
        {"std_deviations_intrinsics": STATED},
        {"standard_deviations": STATED},
        {"cameraMatrix_std_dev": STATED[:4], "dist_coeffs_std_dev": STATED[4:]},
    ],
)
def test_standard_deviations_of_opencv_are_read(tmp_path: Path, deviations: dict[str, object]) -> None:
    """Those of what was held while it calibrated, and of a model that has no such coefficient, are 0."""
    (tmp_path / "file.yaml").write_text(yaml.safe_dump({**K_AND_D, "cameraResolution": [640, 480], **deviations}))
    lens = read_lens(tmp_path / "file.yaml")
    assert (lens.has_size, lens.camera.width, lens.camera.height) == (True, 640, 480)
    assert lens.uncertainty is not None
    assert lens.uncertainty.parameters == ("fx", "fy", "cx", "cy", "k1", "k2", "k3")
    assert lens.uncertainty.sigmas.tolist() == [each for each in STATED if each]
    assert lens.uncertainty.covariance is None


@pytest.mark.parametrize("deviations", [{"stdDeviationsIntrinsics": STATED}, {"cameraMatrix_std_dev": [0, 0, 0, 0]}])
def test_no_deviation_is_none(tmp_path: Path, deviations: dict[str, object]) -> None:
    (tmp_path / "file.yaml").write_text(yaml.safe_dump({**K_AND_D, **deviations}))
    lens = read_lens(tmp_path / "file.yaml")
    assert not lens.has_size
    assert (lens.uncertainty is None) == ("cameraMatrix_std_dev" in deviations)


@pytest.mark.parametrize(
    "document",
    [
        {"width": 640, "height": 480, "fx": 500, "fy": 501, "ppx": 320, "ppy": 240, "coeffs": [-0.1, 0.2, 0, 0, 0]},
        {
            "image_size_wh": {"width": 640, "height": 480},
            "intrinsics_K": {"fx": 500, "fy": 501, "cx": 320, "cy": 240},
            "distortion": {"model": "opencv_standard", "coefficients": [-0.1, 0.2, 0, 0, 0]},
        },
    ],
)
def test_intrinsics_by_their_names(tmp_path: Path, document: object) -> None:
    (tmp_path / "file.json").write_text(json.dumps(document))
    lens = read_lens(tmp_path / "file.json")
    assert lens.has_size
    assert (lens.camera.width, lens.camera.height) == (640, 480)
    assert lens.camera.intrinsics.tolist() == [500, 501, 320, 240, -0.1, 0.2, 0, 0, 0]


MATRIX, COEFFICIENTS = np.array([[500, 0, 320], [0, 501, 240], [0, 0, 1]]), np.array([-0.1, 0.2, 1e-3, -1e-3, 0.05])


@pytest.mark.parametrize("ending", ["txt", "csv", "npy"])
def test_a_matrix_and_its_coefficients_in_two_files(tmp_path: Path, ending: str) -> None:
    for name, values in (("mtx", MATRIX), ("dist", COEFFICIENTS[None])):
        if ending == "npy":
            np.save(tmp_path / f"{name}.npy", values)
        else:
            np.savetxt(tmp_path / f"{name}.{ending}", values, delimiter="," if ending == "csv" else " ")
    lens = read_lens(tmp_path / f"mtx.{ending}", distortion=tmp_path / f"dist.{ending}")
    assert lens.camera.intrinsics.tolist() == [500, 501, 320, 240, *COEFFICIENTS]
    assert not lens.has_size


@pytest.mark.parametrize(
    ("matrix", "coefficients", "said"),
    [
        ("1 2 3", "", "mtx.txt: K: found a list of 3, expected a list of 9"),
        ("500 0 320\n0 501 240\n0 0 1", "some: text", "dist.txt: found no coefficients, expected numbers alone"),
        ("500 0 320\n0 501 240\n0 0 1", "0 nan 0 0 0", "dist.txt.*found nan"),
        ("camera_matrix: [1]\nD: [0]", "0 0 0 0 0", "mtx.txt: found no matrix alone"),
    ],
)
def test_a_matrix_in_text_that_is_none(tmp_path: Path, matrix: str, coefficients: str, said: str) -> None:
    (tmp_path / "mtx.txt").write_text(matrix)
    (tmp_path / "dist.txt").write_text(coefficients)
    with pytest.raises(InputError, match=said):
        read_lens(tmp_path / "mtx.txt", distortion=tmp_path / "dist.txt" if coefficients else None)


@pytest.mark.parametrize(
    ("deviations", "said"),
    [
        ([-1.0], "stdDeviationsIntrinsics/0: found -1.0, expected a number from 0 to"),
        ([float("nan")], "stdDeviationsIntrinsics/0: found nan"),
        (["much"], "stdDeviationsIntrinsics/0: found 'much'"),
        (3, "stdDeviationsIntrinsics: found 3, expected a list"),
    ],
)
def test_a_deviation_that_is_none_is_named(tmp_path: Path, deviations: object, said: str) -> None:
    (tmp_path / "file.yaml").write_text(yaml.safe_dump({**K_AND_D, "stdDeviationsIntrinsics": deviations}))
    with pytest.raises(InputError, match=said):
        read_lens(tmp_path / "file.yaml")


def test_deviations_of_opencv_are_those_of_the_nominal_calibration_for_its_views() -> None:
    """The noise of corners in the nominal views: what OpenCV says of them, and what a bent board does to it."""
    camera = Camera(550.0, 560.0, 322.0, 238.0, 640, 480, PlumbBob(-0.1, 0.05, 0.001, -0.001, 0.01))
    board, T = nominal_lens_module.board(), nominal_lens_module.views(camera)
    x, half = board.corners[:, 0] - board.centre[0], np.ptp(board.outline[:, 0]) / 2
    heights = nominal_lens_module.SIGMA_OF_BOW * (1 - (x / half) ** 2)
    bent = board.corners - board.centre + np.stack([0 * x, 0 * x, heights], -1)
    nominal = nominal_lens_module.nominal_lens(camera)
    rng = np.random.default_rng(1)
    found = []
    for places, noise in ((board.corners - board.centre, nominal_lens_module.SIGMA_OF_CORNERS), (bent, 0.0)):
        pixels = camera.project(apply(T, places))
        inside = camera.contains(pixels)
        noisy = pixels + noise * rng.normal(size=pixels.shape)
        labels = [each[own].astype(np.float32) for each, own in zip(noisy, inside, strict=True)]
        flat = [(board.corners - board.centre)[own].astype(np.float32) for own in inside]
        _, K, D, _, _, deviations, _, _ = cv2.calibrateCameraExtended(flat, labels, (640, 480), None, None)
        values = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D.ravel()[:5]])
        found.append((values - camera.intrinsics, deviations.ravel()[:9]))
    (_, deviations), (by_bow, _) = found
    np.testing.assert_allclose(np.linalg.norm(nominal.by_noise, axis=1), deviations, rtol=0.1)
    np.testing.assert_allclose(by_bow[:4], nominal.by_flatness[:4, 0], rtol=0.05)


def test_an_intrinsic_calibration_hands_its_covariance_on(tmp_path: Path) -> None:
    """From intrinsics.json into a dataset, and from there into the error bars."""
    found = calibrate(covering(20, pixel_noise=0.3).dataset(), Options(intrinsics=("all",)))
    cameras = {name: sensor.camera for name, sensor in found.dataset.sensors.items() if sensor.camera}
    write_intrinsics(tmp_path / "intrinsics.json", found.intrinsics, cameras)
    lens = read_lens(tmp_path / "intrinsics.json", "c1")
    assert lens.has_size
    assert lens.camera == cameras["c1"]
    assert lens.uncertainty is not None
    again = read_uncertainty(Node(tmp_path, (), uncertainty_document(lens.uncertainty)), lens.camera.parameters)
    assert again.covariance is not None
    np.testing.assert_allclose(again.covariance, found.intrinsics["c1"].covariance, rtol=1e-9)
    with pytest.raises(InputError, match="has several cameras: add 'camera' with one of c0, c1"):
        read_lens(tmp_path / "intrinsics.json")


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
        ("%YAML:1.0\n---\nK: &a [*a]\n", "its aliases expand to more than"),
        ("%YAML:1.0\n---\nK: " + "[" * 400_000, "nested too deeply"),
        ("cam0: {camera_model: fov}", "camera_model: found 'fov', expected one of omni, pinhole, ds, eucm"),
        ("cam0: {camera_model: ds, intrinsics: [1, 2], resolution: [9, 9]}", "intrinsics"),
        ("cam0: {camera_model: ds, distortion_model: radtan}", "found 'radtan', expected a distortion of ds: none"),
        (
            "cam0: {camera_model: ds, intrinsics: [0, 2, 9, 9, 4, 4], resolution: [9, 9]}",
            "expected alpha of double_sphere from 0 to 1",
        ),
        ("intrinsics: {fx: 1}", "missing key 'fy'"),
    ],
)
def test_what_is_no_camera_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "file.yaml").write_text(text)
    with pytest.raises(InputError, match=r"file\.yaml") as error:
        read_lens(tmp_path / "file.yaml")
    assert message in str(error.value)


K4 = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
D4 = [0.1, 0.01, -0.002, 0.001]
SIZED = {"image_width": 640, "image_height": 480, "camera_matrix": K4}
INI = """# oST version 5.0 parameters
[image]
width
640
height
480
[narrow_stereo]
camera matrix
500 0 320
0 501 240
0 0 1
distortion
0.1 0.01 -0.002 0.001 0
"""
ASLAM = {
    "type": "pinhole",
    "label": "cam0",
    "image_width": 640,
    "image_height": 480,
    "intrinsics": {"rows": 4, "cols": 1, "data": [500, 501, 320, 240]},
    "distortion": {"type": "radial-tangential", "parameters": {"rows": 4, "cols": 1, "data": D4}},
}
VISP = (
    "<root><!-- c --><camera><name>Camera</name><image_width>640</image_width><image_height>480</image_height><model>"
    "<type>perspectiveProjWithDistortion</type><px>500</px><py>501</py><u0>320</u0><v0>240</v0><kud>0.1</kud>"
    "<kdu>-0.1</kdu></model></camera></root>"
)
PLEX = {
    "components": [
        {
            "camera": {
                "name": "left",
                "intrinsics": {
                    "projection": {"pinhole": {"f": 500.0, "cx": 320.5, "cy": 240.5}},
                    "distortion": {"opencv_fisheye": dict(zip(("k1", "k2", "k3", "k4"), D4, strict=True))},
                    "width": 640,
                    "height": 480,
                },
            }
        }
    ]
}


def camodocal(kind: str, names: str, coefficients: dict[str, dict[str, float]]) -> str:
    sections = {"projection_parameters": dict(zip(names.split(), [500.0, 501.0, 320.0, 240.0], strict=True))}
    camera = {"model_type": kind, "camera_name": "camera", "image_width": 640, "image_height": 480}
    return "%YAML:1.0\n---\n" + yaml.safe_dump({**camera, **coefficients, **sections})


def basalt(kind: str, coefficients: dict[str, float]) -> str:
    """Two cameras, the second 0.1 m to the right of the first, both turned in the frame of the IMU."""
    lens = {"fx": 500.0, "fy": 501.0, "cx": 320.0, "cy": 240.0, **coefficients}
    turned = dict(zip(("qx", "qy", "qz", "qw"), [0.0, 0.0, 0.5**0.5, 0.5**0.5], strict=True))
    poses = [{"px": 1.0, "py": y, "pz": 0.0, **turned} for y in (2.0, 2.1)]
    camera = {"camera_type": kind, "intrinsics": lens}
    document = {"T_imu_cam": poses, "intrinsics": [camera] * 2, "resolution": [[640, 480]] * 2}
    return json.dumps({"value0": document})


D_CAMODOCAL = dict(zip(("k1", "k2", "p1", "p2"), D4, strict=True))


@pytest.mark.parametrize(
    ("text", "model", "coefficients"),
    [
        (camodocal("PINHOLE", "fx fy cx cy", {"distortion_parameters": D_CAMODOCAL}), "plumb_bob", [*D4, 0.0]),
        (
            camodocal(
                "MEI", "gamma1 gamma2 u0 v0", {"mirror_parameters": {"xi": 1.5}, "distortion_parameters": D_CAMODOCAL}
            ),
            "omni",
            [1.5, *D4],
        ),
        (
            (
                "%YAML:1.0\n---\nmodel_type: KANNALA_BRANDT\nimage_width: 640\nimage_height: 480\n"
                "projection_parameters: {k2: 0.1, k3: 0.2, k4: 0.3, k5: 0.4, mu: 500, mv: 501, u0: 320, v0: 240}"
            ),
            "equidistant",
            [0.1, 0.2, 0.3, 0.4],
        ),
        (basalt("ds", {"xi": -0.2, "alpha": 0.59}), "double_sphere", [-0.2, 0.59]),
        (basalt("eucm", {"alpha": 0.6, "beta": 1.1}), "eucm", [0.6, 1.1]),
        (basalt("kb4", {"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}), "equidistant", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_a_camera_of_visual_odometry(tmp_path: Path, text: str, model: str, coefficients: list[float]) -> None:
    """As camodocal and basalt write them."""
    file = tmp_path / ("cam.json" if text.startswith("{") else "cam.yaml")
    file.write_text(text)
    lens = read_lens(file, name="cam1" if "value0" in text else None)
    assert isinstance(lens.camera.distortion, MODELS[model])
    assert lens.camera.intrinsics.tolist() == [500.0, 501.0, 320.0, 240.0, *coefficients]
    assert (lens.camera.width, lens.camera.height) == (640, 480)
    if "value0" in text:
        assert lens.T_chain_camera is not None
        np.testing.assert_allclose(lens.T_chain_camera[:3, 3], [0.1, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            camodocal("SCARAMUZZA", "fx fy cx cy", {}),
            "cam.yaml: model_type: found 'SCARAMUZZA', expected one of PINHOLE",
        ),
        (camodocal("MEI", "gamma1 gamma2 u0 v0", {}), "has no xi, k1, k2, p1, p2 in mirror_parameters"),
        (basalt("fov", {"w": 0.9}), "camera_type: found 'fov', expected one of pinhole"),
        (basalt("ds", {"xi": -0.2}), "intrinsics: .*'alpha'"),
        (basalt("pinhole", {}).replace("0.7071067811865476", "0.1"), "quaternion of length 1"),
    ],
)
def test_a_wrong_camera_of_visual_odometry_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "cam.yaml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_lens(tmp_path / "cam.yaml", name="cam1" if "value0" in text else None)


def anipose(fisheye: str) -> str:
    camera = f'[cam_0]\nname = "A"\nsize = [640, 480]\nmatrix = {K4}\ndistortions = {D4}\nfisheye = {fisheye}\n'
    return f"{camera}[metadata]\nadjusted = false\n"


@pytest.mark.parametrize(
    ("name", "text", "model"),
    [
        ("ost.txt", INI, "plumb_bob"),
        ("cam.ini", INI, "plumb_bob"),
        ("cam.yaml", yaml.safe_dump(ASLAM), "plumb_bob"),
        ("rig.yaml", yaml.safe_dump({"label": "rig", "cameras": [{"camera": ASLAM, "T_B_C": {}}]}), "plumb_bob"),
        ("cam.toml", anipose("true"), "equidistant"),
        ("cam.json", json.dumps(PLEX), "equidistant"),
        ("cam.yaml", yaml.safe_dump({**SIZED, "camera_model": "fisheye", "D": D4}), "equidistant"),
        ("cam.yaml", yaml.safe_dump({**SIZED, "distortion_model": "fisheye", "D": D4}), "equidistant"),
        ("cam.yml", yaml.safe_dump({**SIZED, "fisheye_model": 1, "D": D4}), "equidistant"),
        ("cam.yaml", yaml.safe_dump({**SIZED, "distortion_model": "plumb_bob", "D": [*D4, *[0.0] * 9]}), "plumb_bob"),
    ],
)
def test_a_camera_of_another_tool(tmp_path: Path, name: str, text: str, model: str) -> None:
    (tmp_path / name).write_text(text)
    lens = read_lens(tmp_path / name)
    assert lens.has_size
    assert (lens.camera.width, lens.camera.height) == (640, 480)
    assert isinstance(lens.camera.distortion, MODELS[model])
    fy = 500.0 if "components" in text else 501.0
    assert lens.camera.intrinsics[:8].tolist() == [500.0, fy, 320.0, 240.0, *D4]


@pytest.mark.parametrize(("word", "D"), [("ds", [-0.2, 0.59]), ("mei", [1.5, -0.1, 0.0, 0.0, 0.0])])
def test_a_wide_lens_by_the_names_of_others(tmp_path: Path, word: str, D: list[float]) -> None:
    (tmp_path / "cam.yaml").write_text(yaml.safe_dump({**SIZED, "distortion_model": word, "D": D}))
    (tmp_path / "unnamed.yaml").write_text(yaml.safe_dump({**SIZED, "D": D}))
    for lens in (read_lens(tmp_path / "cam.yaml"), read_lens(tmp_path / "unnamed.yaml", model=word)):
        assert isinstance(lens.camera.distortion, MODELS[SYNONYMS[word]])
        assert lens.camera.distortion.coefficients.tolist() == D


def test_a_camera_of_visp_and_of_numpy(tmp_path: Path) -> None:
    (tmp_path / "cam.xml").write_text(VISP)
    assert read_lens(tmp_path / "cam.xml").camera.intrinsics.tolist() == [500, 501, 320, 240, 0.1, 0, 0, 0, 0]
    np.savez(tmp_path / "cam.npz", mtx=np.array(K4), dist=np.array([[*D4, 0.5]]))
    found = read_lens(tmp_path / "cam.npz")
    assert not found.has_size
    assert found.camera.intrinsics.tolist() == [500, 501, 320, 240, *D4, 0.5]


@pytest.mark.parametrize("kind", ["yml", "xml", "json"])
def test_four_coefficients_without_a_model_are_asked_for(tmp_path: Path, kind: str) -> None:
    """As cv2.fisheye's result stands in OpenCV's own storage."""
    storage = cv2.FileStorage(str(tmp_path / f"cam.{kind}"), cv2.FILE_STORAGE_WRITE)
    storage.write("K", np.array(K4))
    storage.write("D", np.array(D4)[:, None])
    storage.release()
    with pytest.raises(InputError, match=r"D: found 4 coefficients and no lens model.*'model: equidistant'"):
        read_lens(tmp_path / f"cam.{kind}")
    for model in ("equidistant", "fisheye", "plumb_bob"):
        found = read_lens(tmp_path / f"cam.{kind}", model=model).camera
        assert isinstance(found.distortion, MODELS["equidistant" if model == "fisheye" else model])
        assert found.intrinsics[:8].tolist() == [500, 501, 320, 240, *D4]


@pytest.mark.parametrize(
    ("change", "model", "said"),
    [
        ({"image_width": 300}, None, r"principal point \(320, 240\) px outside of an image of 300 x 480"),
        ({"D": [0.1] * 8}, "plumb_bob", r"D: found 8 coefficients, expected the 5 of plumb_bob.*'model: rational_poly"),
        ({"D": [0.1] * 12}, None, r"D: found 12 coefficients, expected the 8 of rational_polynomial"),
        ({}, "fov", "found the lens model 'fov' in import.yml, expected one of plumb_bob"),
    ],
)
def test_what_does_not_go_together_is_named(
    tmp_path: Path, change: dict[str, object], model: str | None, said: str
) -> None:
    (tmp_path / "cam.yaml").write_text(yaml.safe_dump({**SIZED, **change}))
    with pytest.raises(InputError, match=said) as caught:
        read_lens(tmp_path / "cam.yaml", model=model)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("camera_model", "distortion_model", "intrinsics", "coefficients", "lens"),
    [
        ("ds", "none", [-0.2, 0.59, 310.0, 311.5, 640.25, 479.5], [], DoubleSphere(-0.2, 0.59)),
        ("eucm", "none", [0.6, 1.1, 310.0, 311.5, 640.25, 479.5], [], Eucm(0.6, 1.1)),
        ("omni", "radtan", [1.5, 310.0, 311.5, 640.25, 479.5], [0.1, 0.2, 0.3, 0.4], Omni(1.5, 0.1, 0.2, 0.3, 0.4)),
        (
            "pinhole",
            "equidistant",
            [310.0, 311.5, 640.25, 479.5],
            [0.1, 0.2, 0.3, 0.4],
            Equidistant(0.1, 0.2, 0.3, 0.4),
        ),
        ("pinhole", "radtan", [310.0, 311.5, 640.25, 479.5], [0.1, 0.2, 0.3, 0.4], PlumbBob(0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_a_camchain_is_written_back_as_it_was(
    tmp_path: Path,
    camera_model: str,
    distortion_model: str,
    intrinsics: list[float],
    coefficients: list[float],
    lens: Distortion,
) -> None:
    camera = {
        "camera_model": camera_model,
        "intrinsics": intrinsics,
        "distortion_model": distortion_model,
        "distortion_coeffs": coefficients,
        "resolution": [1280, 960],
        "rostopic": "/left/image_raw",
    }
    (tmp_path / "chain.yaml").write_text(yaml.safe_dump({"cam0": camera}))
    found = read_lens(tmp_path / "chain.yaml").camera
    assert found.distortion == lens
    again = yaml.safe_load(kalibr_camchain(SimpleNamespace(cameras={"left": found}, poses={})))  # type: ignore[arg-type]
    assert again == {"cam0": camera}
