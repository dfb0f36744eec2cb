"""The datasets that ship: what is in them, and that our command makes them."""

from pathlib import Path

import numpy as np
import pytest

from calibration.dataset.model import CornerLabels, Dataset, PointLabels
from calibration.dataset.reading import read_dataset
from calibration.dataset.truth import find_truth
from calibration.geometry import transforms
from calibration.geometry.transforms import apply, inverse
from calibration.simulation.collection.capture import collect
from calibration.simulation.collection.dataset_folder import write_dataset_folder
from calibration.simulation.motion.generation import generate_motion
from calibration.simulation.motion.sequence import read_motion
from calibration.simulation.system import System

from .conftest import DATASETS, SYSTEMS

SEED = 1
NOISE_PX = 0.3


@pytest.fixture(scope="module")
def datasets() -> dict[str, Dataset]:
    return {name: read_dataset(DATASETS / name) for name in SYSTEMS}


def true_patterns(dataset: Dataset) -> np.ndarray:
    """``T_world_pattern`` of each collection."""
    truth = find_truth(dataset)
    assert truth is not None
    return np.array([truth.patterns[key]["world", "pattern_link"] for key in dataset.keys])


@pytest.mark.parametrize("name", SYSTEMS)
def test_our_command_makes_them_byte_for_byte(systems: dict[str, System], name: str, tmp_path: Path) -> None:
    system, shipped = systems[name], DATASETS / name
    motion = read_motion(shipped / "motion.json")
    write_dataset_folder(tmp_path, system, motion, list(collect(system, motion, SEED)), SEED)
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert made.keys() == {path.name for path in shipped.iterdir()}
    different = [file for file, content in made.items() if content != (shipped / file).read_bytes()]
    assert not different


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_motions_are_generated_from_the_seed(systems: dict[str, System], name: str) -> None:
    shipped = read_motion(DATASETS / name / "motion.json")
    generated = generate_motion(systems[name], len(shipped), SEED)
    for a, b in ((shipped.positions, generated.positions), (shipped.orientations, generated.orientations)):
        np.testing.assert_array_equal(a, b)  # type: ignore[arg-type]
    for joint, positions in shipped.joints.items():
        np.testing.assert_array_equal(positions, generated.joints[joint])


@pytest.mark.parametrize("name", SYSTEMS)
def test_they_are_small_and_complete(datasets: dict[str, Dataset], name: str) -> None:
    dataset = datasets[name]
    assert 20 <= len(dataset.collections) <= 30
    assert (DATASETS / name / "dataset.json").stat().st_size < 1_000_000
    assert sum(path.stat().st_size for path in (DATASETS / name).glob("*.pcd")) < 2_000_000
    for sensor in dataset.sensors:
        assert len(dataset.detections("pattern_1", sensor)) == len(dataset.collections)


@pytest.mark.parametrize("name", SYSTEMS)
def test_corners_reproject_on_the_truth_with_the_stated_noise(datasets: dict[str, Dataset], name: str) -> None:
    dataset = datasets[name]
    corners = dataset.patterns["pattern_1"].corners
    T_world_pattern = true_patterns(dataset)
    for sensor in (s for s in dataset.sensors.values() if s.camera):
        T_camera_pattern = inverse(dataset.transform(dataset.world, sensor.frame)) @ T_world_pattern
        errors = []
        for i, labels in dataset.detections("pattern_1", sensor.name):
            assert isinstance(labels, CornerLabels)
            assert len(labels.ids) > 0.25 * len(corners)
            assert sensor.camera is not None
            errors.append(labels.pixels - sensor.camera.project(apply(T_camera_pattern[i], corners[labels.ids])))
        error = np.concatenate(errors)
        rms = np.sqrt((error**2).sum(-1).mean())
        assert rms == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.05)
        assert np.abs(error.mean(0)).max() < 4 * NOISE_PX / np.sqrt(len(error))


def test_points_lie_on_the_true_plane_with_the_stated_noise(datasets: dict[str, Dataset]) -> None:
    dataset = datasets["rlbot"]
    T_lidar_pattern = inverse(dataset.transform(dataset.world, "lidar_right")) @ true_patterns(dataset)
    outline = dataset.patterns["pattern_1"].outline
    along, beyond = [], []
    for i, labels in dataset.detections("pattern_1", "lidar_right"):
        assert isinstance(labels, PointLabels)
        normal, origin = T_lidar_pattern[i, :3, 2], T_lidar_pattern[i, :3, 3]
        length = np.linalg.norm(labels.points, axis=-1)
        along.append(length * (1 - (origin @ normal) / (labels.points @ normal)))  # along the ray
        flat = apply(inverse(T_lidar_pattern[i]), labels.points)[:, :2]
        beyond.append(np.maximum(outline.min(0) - flat, flat - outline.max(0)).max(-1))
    error = np.concatenate(along)
    assert error.std() == pytest.approx(0.008, rel=0.02)
    assert abs(error.mean()) < 0.0005
    assert np.concatenate(beyond).max() < 0.05


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_transforms_in_the_file_are_the_truth(datasets: dict[str, Dataset], name: str) -> None:
    dataset = datasets[name]
    truth = find_truth(dataset)
    assert truth is not None
    for sensor in dataset.sensors.values():
        assert np.abs(dataset.transforms[sensor.edge] - truth.transforms[sensor.edge]).max() < 1e-12
    expected = {
        "t2rgb": {"left_camera": (0, -0.045, 0), "right_camera": (0, -0.045, 0)},
        "rlbot": {"rgb_left": (0.015, 0, 0.012), "lidar_right": (0.015, 0, 0.006)},
        "riwbot": {"rgb_world": (0, 0, 0.03)},
    }[name]
    for sensor_name, xyz in expected.items():
        np.testing.assert_allclose(truth.transforms[truth.sensors[sensor_name]][:3, 3], xyz)
    if name == "riwbot":
        np.testing.assert_allclose(truth.transforms["flange", "pattern_link"][:3, 3], [0.06, -0.06, 0])


def test_the_cameras_of_t2rgb_are_as_far_apart_as_the_papers(datasets: dict[str, Dataset]) -> None:
    dataset = datasets["t2rgb"]
    T = dataset.transform("camera_right_rgb_optical_frame", "camera_left_rgb_optical_frame")[0]
    assert np.linalg.norm(T[:3, 3]) == pytest.approx(0.385)


@pytest.mark.parametrize("name", SYSTEMS)
def test_initial_pattern_poses_are_estimates_near_the_truth(datasets: dict[str, Dataset], name: str) -> None:
    dataset = datasets[name]
    initial = dataset.document["patterns"]["pattern_1"]["transforms_initial"]
    pattern = dataset.patterns["pattern_1"]
    true = inverse(dataset.transform(dataset.world, pattern.parent_link)) @ true_patterns(dataset)
    estimated = np.array(
        [transforms.from_quaternion(initial[key]["trans"], initial[key]["quat"]) for key in dataset.keys]
    )
    translation, angle = transforms.distance(true, estimated)
    assert 1e-5 < translation.max() < 0.03
    assert 1e-4 < np.median(angle) < angle.max() < 0.03


@pytest.mark.parametrize("name", SYSTEMS)
def test_shape_of_the_document(datasets: dict[str, Dataset], shared_data: Path, name: str) -> None:
    """Every key of an independently made dataset of the same system, and nothing of this machine."""
    ours = datasets[name].document
    theirs = read_dataset(shared_data / "synthetic" / name).document

    def keys(value: object, depth: int = 0) -> object:
        return {k: keys(v, depth + 1) for k, v in value.items()} if isinstance(value, dict) and depth < 5 else None

    for document in (ours, theirs):
        assert document["_metadata"].keys() == theirs["_metadata"].keys()
        for collection in document["collections"].values():
            for data in collection["data"].values():
                data.pop("data_file", None)
    for part in ("sensors", "transforms", "calibration_config"):
        assert keys(ours[part]) == keys(theirs[part]), part
    assert keys(ours["collections"]["000"]) == keys(theirs["collections"]["000"])
    assert ours["patterns"]["pattern_1"].keys() == theirs["patterns"]["pattern_1"].keys()
    assert ours["_metadata"]["user"] == "calibration-ci"
    assert (
        ours["sensors"][next(iter(ours["sensors"]))]["chain"] == theirs["sensors"][next(iter(ours["sensors"]))]["chain"]
    )
