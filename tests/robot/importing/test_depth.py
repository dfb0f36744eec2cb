"""Depth images in a bag: the pixels on the pattern are found where a camera sees it."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import Dataset, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import DEPTH_UNIT_M, NO_RETURN, read_depth_image
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.evaluation.truth import choose_truth
from calibration.engine.geometry.transforms import distance, translation
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest
from calibration.robot.importing.bags.messages import depth_of
from calibration.robot.importing.importing import import_data
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind, compressed_depth
from tests.robot.importing.conftest import BOARD, CAMERAS, DATASETS
from tests.robot.importing.test_bags import describe, file_of
from tests.thorough import thorough

DEPTH, CAMERA = CAMERAS
SENSORS: dict[str, Any] = {
    "camera": {"topic": "/camera/image_raw"},
    "range": {"topic": "/range/depth/image_raw"},
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """t2rgb, whose left camera measures depths instead, at ten poses."""
    system, output = tmp_path_factory.mktemp("system"), tmp_path_factory.mktemp("collected")
    for name in ("robot.urdf", "simulation.yml"):
        (system / name).write_bytes((DATASETS / "t2rgb" / name).read_bytes())
    config = (DATASETS / "t2rgb" / "config.yml").read_text()
    (system / "config.yml").write_text(config.replace("modality: rgb", "modality: depth", 1))
    collect_dataset(CollectionRequest(system, motion="generate:10"), output)
    return output


def true(recorded: Path) -> Dataset:
    dataset = read_dataset(recorded)
    truth = choose_truth(dataset, None)
    assert truth is not None
    return dataset.with_transforms({edge: truth.transforms[edge] for edge in truth.sensors.values()})


def record(
    recorded: Path,
    folder: Path,
    kind: Kind,
    encoding: str,
    topic: str = "/range/depth",
    width: int | None = None,
    transport: str = "",
    poses: int = 3,
) -> Path:
    """A bag of the first poses of what was collected; the depth camera is described 3 cm beside where it is."""
    path, dataset = file_of(folder, kind), true(recorded)
    boards = {pattern.link for pattern in dataset.patterns.values()}
    edges = {edge: T[0] for edge, T in dataset.transforms.items() if edge[1] not in boards}
    edges[dataset.sensors[DEPTH].edge] = edges[dataset.sensors[DEPTH].edge] @ translation([0.03, 0.0, 0.0])
    collections = dataset.document["collections"]
    with BagFile(path, kind) as bag:
        bag.transforms("/tf_static", BEGIN, edges)
        for n, key in enumerate(dataset.keys[:poses]):
            stamp = BEGIN + n * SECOND
            for name, beside in ((CAMERA, "/camera"), (DEPTH, topic)):
                sensor = dataset.sensors[name]
                assert sensor.camera is not None
                file = recorded / collections[key]["data"][name]["data_file"]
                size = sensor.camera.width, sensor.camera.height
                told = (width or size[0], size[1]) if name == DEPTH else size
                bag.camera_info(f"{beside}/camera_info", stamp, sensor.frame, told, sensor.camera.fx)
                if name == CAMERA:
                    bag.image(f"{beside}/image_raw", stamp, np.asarray(cv2.imread(str(file))), sensor.frame)
                else:
                    counts = read_depth_image(file, sensor.camera).depth
                    metres = np.where(counts == NO_RETURN, np.nan, counts * DEPTH_UNIT_M)
                    raw = f"{beside}/image_raw"
                    bag.depth(f"{raw}/{transport}" if transport else raw, stamp, metres, sensor.frame, encoding)
    return path


def imported(path: Path, sensors: dict[str, Any] = SENSORS) -> Dataset:
    board = {**BOARD, "border": 0.035}
    import_data(describe(path, sensors=sensors, patterns={"board": board}), path.parent / "out", jobs=1)
    return read_dataset(path.parent / "out")


@pytest.mark.parametrize(("kind", "encoding"), [thorough("bag", "16UC1"), ("mcap", "32FC1")])
def test_they_calibrate_to_the_truth(recorded: Path, tmp_path: Path, kind: Kind, encoding: str) -> None:
    dataset, known = imported(record(recorded, tmp_path, kind, encoding, poses=10)), true(recorded)
    assert dataset.sensors["range"].modality.name == "depth"
    for collection, other in zip(dataset.collections, known.collections, strict=True):
        ours = collection.labels.get(("board", "range"))
        theirs = other.labels.get((next(iter(known.patterns)), DEPTH))
        if isinstance(ours, PointLabels) and isinstance(theirs, PointLabels):
            assert abs(len(ours.points) - len(theirs.points)) <= 0.1 * len(theirs.points)
    found = calibrate(dataset, Options()).dataset
    frames = known.sensors[CAMERA].frame, known.sensors[DEPTH].frame
    m, rad = (float(v) for v in distance(known.transform(*frames)[0], found.transform(*frames)[0]))
    assert m < 0.005
    assert np.degrees(rad) < 0.3


@pytest.fixture(scope="module")
def raw(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The same recording without compression."""
    return imported(record(recorded, tmp_path_factory.mktemp("raw"), "mcap", "32FC1"))


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    ("encoding", "transport", "off"),
    [
        ("16UC1; compressedDepth png", "compressedDepth", 0.0006),
        ("16UC1; compressedDepth", "compressedDepth", 0.0006),
        ("32FC1; compressedDepth png", "compressedDepth", 0.0045),  # a step at 6.5 m
        ("16UC1; png compressed", "compressed", 0.0006),
    ],
)
def test_compressed_topics(
    recorded: Path, raw: Dataset, tmp_path: Path, encoding: str, transport: str, off: float
) -> None:
    path = record(recorded, tmp_path, "mcap", encoding, transport=transport)
    topic = f"/range/depth/image_raw/{transport}"
    ours = imported(path, {**SENSORS, "range": {"topic": topic}})
    assert ours.sensors["range"].modality.name == "depth"
    counted = 0
    for one, other in zip(ours.collections, raw.collections, strict=True):
        images = [
            read_depth_image(dataset.path.parent / f"range_{collection.key}.png", dataset.sensors["range"].camera)
            for dataset, collection in ((ours, one), (raw, other))
        ]
        seen = [image.depth != NO_RETURN for image in images]
        assert (seen[0] == seen[1]).mean() > 0.999
        both = seen[0] & seen[1]
        counted += int(both.sum())
        assert np.abs(images[0].depth[both].astype(float) - images[1].depth[both]).max() * DEPTH_UNIT_M <= off
    assert counted > 100_000


@pytest.mark.parametrize(
    ("encoding", "data", "said"),
    [
        ("16UC1; compressedDepth rvl", b"", "compressed as '16UC1; compressedDepth rvl', expected '16UC1; compressed"),
        ("jpeg", b"", "compressed as 'jpeg', expected"),
        ("32FC1; png compressed", b"", "compressed as '32FC1; png compressed', expected"),
        ("16UC1; compressedDepth png", b"123", "found 3 bytes, expected a compressed depth image"),
        ("16UC1; compressedDepth png", b"\0" * 40, "expected a PNG file"),
        ("16UC1; compressedDepth png", "cut", "is it truncated?"),
        ("16UC1; png compressed", "colours", "found a PNG file of 8 bits, colour, expected 16 bits, grey"),
    ],
)
def test_unknown_compression_is_reported(encoding: str, data: bytes | str, said: str) -> None:
    if data == "cut":
        data = compressed_depth(np.ones((48, 64)), encoding).tobytes()[:-20]
    elif data == "colours":
        data = bytes(cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1])
    message = SimpleNamespace(format=encoding, data=np.frombuffer(data, np.uint8))  # type: ignore[arg-type]
    with pytest.raises(InputError) as error:
        depth_of(message, "bag: /depth")
    assert str(error.value).startswith("bag: /depth: ")
    assert said in str(error.value)


def test_a_depth_topic_without_depth_in_its_name_is_recognised(recorded: Path, tmp_path: Path) -> None:
    path = record(recorded, tmp_path, "db3", "32FC1", topic="/tof")
    sensors = {**SENSORS, "range": {**SENSORS["range"], "topic": "/tof/image_raw"}}
    with pytest.raises(InputError, match=r"/tof/image_raw at .*: found the encoding '32FC1', expected one of bgr8"):
        imported(path, sensors)
    sensors["range"]["modality"] = "depth"
    assert imported(path, sensors).sensors["range"].modality.name == "depth"


def test_invalid_input_is_reported(recorded: Path, tmp_path: Path) -> None:
    path = record(recorded, tmp_path, "db3", "32FC1", width=320)
    with pytest.raises(InputError, match=r"found a depth image of 640 x 480 pixels, expected 320 x 480 as camera_info"):
        imported(path)
    other = {**SENSORS, "range": {**SENSORS["range"], "camera-info": "/nowhere"}}
    with pytest.raises(InputError, match="found no camera_info '/nowhere' for 'range'"):
        imported(path, other)
    colours = {**SENSORS, "camera": {**SENSORS["camera"], "modality": "depth"}}
    with pytest.raises(InputError, match="found no camera among the sensors"):
        imported(path, colours)
