"""Depth images: conversion of pixels to points, and one-line errors."""

import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InfrastructureError, InputError
from calibration.engine.dataset.model import PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import NO_RETURN, read_depth_image
from calibration.engine.dataset.writing import write_dataset
from calibration.engine.geometry.cameras import Camera
from tests.engine.dataset import documents
from tests.engine.dataset.documents import MISSING, Document, changed

cv2 = pytest.importorskip("cv2")

COLUMNS, ROWS = 5, 4
DEPTH = np.arange(10_000, 10_000 + 700 * COLUMNS * ROWS, 700, np.uint16).reshape(ROWS, COLUMNS)
INFO = {
    "width": COLUMNS,
    "height": ROWS,
    "distortion_model": "plumb_bob",
    "D": [0.05, -0.02, 0.001, -0.002, 0.0],
    "K": [6.0, 0.0, 2.1, 0.0, 6.5, 1.4, 0.0, 0.0, 1.0],
}
DATA = "collections/000/data/lidar"
LABEL = "collections/000/labels/board/lidar"


def document() -> Document:
    """The tiny dataset with a depth camera in the place of its LiDAR, whose name it keeps."""
    return changed(
        documents.document(),
        {
            "calibration_config/sensors/lidar/modality": "depth",
            "sensors/lidar/modality": "depth",
            "sensors/lidar/camera_info": INFO,
            f"{DATA}/data_file": "depth_000.png",
        },
    )


def write(folder: Path, content: Document | None = None, image: np.ndarray | bytes = DEPTH) -> Path:
    path = documents.write(folder, document() if content is None else content)
    data = image if isinstance(image, bytes) else encoded(image)
    (folder / "depth_000.png").write_bytes(data)
    return path


def encoded(image: np.ndarray, ending: str = ".png") -> bytes:
    return bytes(cv2.imencode(ending, image)[1])


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_dataset(path)
    assert str(caught.value).isprintable()
    return str(caught.value).removeprefix(f"{path}: ")


def test_labelled_pixels_become_points_on_their_rays(tmp_path):
    dataset = read_dataset(write(tmp_path))
    camera = dataset.sensors["lidar"].camera
    assert (camera.width, camera.height, camera.fx, camera.distortion.k1) == (COLUMNS, ROWS, 6.0, 0.05)
    labels = dataset.collections[0].labels["board", "lidar"]
    assert isinstance(labels, PointLabels)
    np.testing.assert_allclose(labels.points[:, 2], DEPTH.ravel()[[1, 3, 4, 7]] * 1e-4)
    np.testing.assert_allclose(camera.project(labels.points), [[1, 0], [3, 0], [4, 0], [2, 1]], atol=1e-9)
    assert labels.limits.tolist() == [1, 0, 3]


def test_a_pixel_is_where_opencv_has_it(tmp_path):
    points = read_dataset(write(tmp_path)).collections[0].labels["board", "lidar"].points
    K, D = np.array(INFO["K"]).reshape(3, 3), np.array(INFO["D"])
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, D)[0].reshape(-1, 2)
    np.testing.assert_allclose(pixels, [[1, 0], [3, 0], [4, 0], [2, 1]], atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({f"{LABEL}/idxs/2": 20}, f"{LABEL}/idxs/2: found 20, expected the index of one of the image's 20 pixels"),
        ({f"{LABEL}/idxs/2": -1}, f"{LABEL}/idxs/2: found -1, expected the index of a point"),
        ({f"{LABEL}/idxs/2": 1.5}, f"{LABEL}/idxs/2: found 1.5, expected a whole number"),
        ({f"{LABEL}/idxs_limit_points/0": 5}, f"{LABEL}/idxs_limit_points/0: found 5, expected one of 'idxs'"),
        ({f"{LABEL}/idxs_limit_points": MISSING}, f"{LABEL}: missing key 'idxs_limit_points'"),
        ({f"{DATA}/data_file": MISSING}, f"{DATA}: missing key 'data_file'"),
        ({f"{DATA}/data_file": "../x.png"}, f"{DATA}/data_file: found '../x.png', expected a file in the dataset's"),
        ({"sensors/lidar/camera_info": MISSING}, "sensors/lidar: missing key 'camera_info'"),
        ({"sensors/lidar/camera_info/K/0": 0}, "sensors/lidar/camera_info/K: found [0, 0.0, 2.1"),
    ],
)
def test_a_change_that_makes_it_wrong(tmp_path, changes, message):
    assert refused(write(tmp_path, changed(document(), changes))).startswith(message)


def test_a_file_that_is_not_there(tmp_path):
    path = write(tmp_path)
    (tmp_path / "depth_000.png").unlink()
    dataset = read_dataset(path)
    assert dataset.missing_files == {"lidar": ("depth_000.png",)}
    assert list(dataset.sensors) == ["cam"]


@pytest.mark.parametrize("value", [0, NO_RETURN])
def test_a_labelled_pixel_without_depth(tmp_path, value):
    image = DEPTH.copy()
    image.ravel()[4] = value
    expected = f"{LABEL}/idxs/2: pixel 4 of the image has no depth (or no ray); a labelled pixel must"
    assert refused(write(tmp_path, image=image)) == expected
    unlabelled = DEPTH.copy()
    unlabelled.ravel()[5] = value
    read_dataset(write(tmp_path, image=unlabelled))


HUGE = (1 << 17).to_bytes(4, "big")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "found '' at its begin, expected a PNG file"),
        (encoded((DEPTH >> 8).astype(np.uint8), ".jpg"), "at its begin, expected a PNG file"),
        (encoded((DEPTH >> 8).astype(np.uint8)), "found a PNG file of 8 bits, grey, expected 16 bits, grey"),
        (encoded(np.stack([DEPTH] * 3, -1)), "found a PNG file of 16 bits, colour, expected 16 bits, grey"),
        (encoded(DEPTH.T.copy()), "found an image of 4 x 5 pixels, expected 5 x 4 as in camera_info"),
        (encoded(DEPTH)[:16] + HUGE * 2 + encoded(DEPTH)[24:], "found an image of 131072 x 131072 pixels, expected 5"),
    ],
)
def test_a_file_that_is_no_such_image(tmp_path, data, message):
    found = refused(write(tmp_path, image=data))
    assert found.startswith(f"{DATA}/data_file: {tmp_path}")
    assert message in found


def test_a_truncated_image(tmp_path):
    data = encoded(DEPTH)
    for length in range(len(data)):
        assert refused(write(tmp_path, image=data[:length])).startswith(f"{DATA}/data_file: "), length
    found = refused(write(tmp_path, image=data[:-12]))  # without the last chunk, which is empty
    assert found.endswith(f"the PNG file is damaged from byte {len(data) - 12} on; is it truncated?")


def test_damaged_data(tmp_path):
    data = encoded(DEPTH)
    for bit in range(0, 8 * len(data), 3):
        wrong = bytearray(data)
        wrong[bit // 8] ^= 1 << bit % 8
        (tmp_path / "x.png").write_bytes(wrong)
        with pytest.raises(InputError, match=r"x\.png: .*, expected|x\.png: the PNG file is damaged from byte"):
            read_depth_image(tmp_path / "x.png", Camera(6.0, 6.5, 2.1, 1.4, COLUMNS, ROWS))


def chunk(name: bytes, content: bytes) -> bytes:
    return len(content).to_bytes(4, "big") + name + content + zlib.crc32(name + content).to_bytes(4, "big")


def test_a_whole_file_that_is_no_image(tmp_path):
    """Its checksums are valid, but its compressed data are empty or of something else."""
    start, end = encoded(DEPTH)[:33], chunk(b"IEND", b"")
    for content in (b"", chunk(b"IDAT", b"nothing"), chunk(b"IDAT", zlib.compress(b"short"))):
        found = refused(write(tmp_path, image=start + content + end))
        assert found.endswith("depth_000.png: the PNG file cannot be decoded; write it again")


def test_what_is_too_large_is_not_decoded(tmp_path, monkeypatch):
    """An image may be a thousand times as large as its file."""
    monkeypatch.setattr(cv2, "imdecode", None)
    (tmp_path / "x.png").write_bytes(encoded(DEPTH)[:16] + HUGE * 2 + encoded(DEPTH)[24:])
    with pytest.raises(InputError, match=r"found an image of 131072 x 131072 pixels, expected 67108864 pixels at most"):
        read_depth_image(tmp_path / "x.png", Camera(6.0, 6.5, 2.1, 1.4, 1 << 17, 1 << 17))


def test_without_opencv_the_error_names_the_package(tmp_path, monkeypatch):
    path = write(tmp_path)
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(InfrastructureError, match=r"needs OpenCV: pip install opencv-python-headless"):
        read_dataset(path)
    read_dataset(write(tmp_path, changed(document(), {f"{LABEL}/detected": False})))  # nothing is decoded


def test_depth_images_are_copied_even_if_images_are_not(tmp_path):
    dataset = read_dataset(write(tmp_path / "in"))
    path = write_dataset(dataset, tmp_path / "out", images=False)
    assert (path.parent / "depth_000.png").samefile(tmp_path / "in" / "depth_000.png")
    again = read_dataset(path).collections[0].labels["board", "lidar"]
    np.testing.assert_array_equal(again.points, dataset.collections[0].labels["board", "lidar"].points)


def test_the_initial_pose_of_a_pattern_is_by_a_camera_not_by_a_depth_camera(tmp_path):
    content = changed(document(), {"collections/000/labels/board/cam": {"detected": False, "idxs": []}})
    content["collections"]["000"]["transforms"].update(documents.edge("world", "board_link", [1.0, 0.0, 0.0]))
    path = write_dataset(read_dataset(write(tmp_path / "in", content)), tmp_path / "out")
    initial = read_dataset(path).document["patterns"]["board"]["transforms_initial"]
    assert initial["000"]["detected"] is False
