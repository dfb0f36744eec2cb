"""Intrinsics of every model: read from a CameraInfo, and written as they have become."""

import json
from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import dataset_document, write_dataset
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant, PlumbBob, Rational
from tests.engine.dataset import documents
from tests.engine.dataset.documents import changed

INFO = "sensors/cam/camera_info"
LENSES = [
    PlumbBob(0.1, -0.2, 0.001, 0.002, 0.03),
    Rational(0.1, -0.2, 0.001, 0.002, 0.03, 0.4, 0.5, -0.06),
    Equidistant(0.1, -0.2, 0.03, 0.004),
]


def dataset_of(tmp_path, model, D):
    content = changed(documents.document(), {f"{INFO}/distortion_model": model, f"{INFO}/D": D})
    return read_dataset(documents.write(tmp_path / "input", content))


@pytest.mark.parametrize("lens", LENSES)
def test_every_model_is_read(tmp_path, lens):
    camera = dataset_of(tmp_path, lens.ros_name, lens.coefficients.tolist()).sensors["cam"].camera
    assert camera == Camera(300.0, 301.0, 160.5, 120.5, 320, 240, lens)


def test_missing_coefficients_are_zero(tmp_path):
    camera = dataset_of(tmp_path, "rational_polynomial", [0.1, 0.2, 0.0, 0.0]).sensors["cam"].camera
    assert camera.distortion == Rational(0.1, 0.2)


@pytest.mark.parametrize(
    ("model", "count", "said"),
    [
        ("rational_polynomial", 9, "8 coefficients of rational_polynomial: k1, k2, p1, p2, k3, k4, k5, k6"),
        ("equidistant", 5, "4 coefficients of equidistant: k1, k2, k3, k4"),
    ],
)
def test_too_many_coefficients(tmp_path, model, count, said):
    with pytest.raises(InputError, match=f"{INFO}/D: found a list of {count}, expected {said}"):
        dataset_of(tmp_path, model, [0.1] * count)


def test_an_unknown_model(tmp_path):
    with pytest.raises(InputError, match="expected a known distortion model: plumb_bob, equidistant, eucm, double"):
        dataset_of(tmp_path, "fov", [0.1])


@pytest.mark.parametrize("lens", LENSES)
def test_new_intrinsics_are_written_and_read_back(tmp_path, lens):
    dataset = dataset_of(tmp_path, lens.ros_name, lens.coefficients.tolist())
    camera = dataset.sensors["cam"].camera
    assert camera is not None
    now = camera.with_intrinsics(camera.intrinsics * (1 + 0.01 * np.pi))
    path = write_dataset(dataset.with_cameras({"cam": now}), tmp_path / "output")
    assert read_dataset(path).sensors["cam"].camera == now
    info = json.loads(path.read_text())["sensors"]["cam"]["camera_info"]
    assert info["K"] == [now.fx, 0.0, now.cx, 0.0, now.fy, now.cy, 0.0, 0.0, 1.0]
    assert info["P"] == [now.fx, 0.0, now.cx, 0.0, 0.0, now.fy, now.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    assert (info["width"], info["height"], info["distortion_model"]) == (320, 240, lens.ros_name)


def test_intrinsics_that_stay_are_written_as_they_were_read(tmp_path):
    dataset = dataset_of(tmp_path, "plumb_bob", [0.1, 0.2])
    same = dataset.with_cameras({"cam": dataset.sensors["cam"].camera})
    assert dataset_document(same)["sensors"]["cam"] is dataset.document["sensors"]["cam"]
    seen = tuple(
        replace(c, labels={key: each for key, each in c.labels.items() if key[1] == "lidar"})
        for c in dataset.collections
    )
    fewer = replace(dataset, sensors={"lidar": dataset.sensors["lidar"]}, collections=seen)
    assert dataset_document(fewer)["sensors"]["cam"] is dataset.document["sensors"]["cam"]
    assert same.sensors["lidar"] is dataset.sensors["lidar"]
