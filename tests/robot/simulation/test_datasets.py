"""The datasets that ship: what is in them, and that our command makes them."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.truth import find_truth, truth_error
from calibration.engine.geometry import transforms
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import apply, inverse
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.simulation.motion import read_motion
from calibration.robot.simulation.motion_generation import generate_motion
from calibration.robot.simulation.system import System

from .conftest import DATASETS, FREE, SYSTEMS

SEED = 1
POSES = {"t2rgb": 26, "rlbot": 24, "riwbot": 24, "softbot": 14, "spjbot": 20}
"""Options of the commands in the README."""


def content(folder: Path) -> dict[str, bytes]:
    """The files of a folder; without the versions, which differ where other ones are installed."""
    found = {path.name: path.read_bytes() for path in folder.iterdir()}
    results = json.loads(found["results.json"])
    results["made_with"] = None
    return {**found, "results.json": json.dumps(results).encode()}


@pytest.fixture(scope="module")
def datasets() -> dict[str, Dataset]:
    return {name: read_dataset(DATASETS / name) for name in SYSTEMS}


def true_patterns(dataset: Dataset) -> np.ndarray:
    """``T_world_pattern`` of each collection."""
    truth = find_truth(dataset)
    assert truth is not None
    return np.array([truth.patterns[key]["world", "pattern_link"] for key in dataset.keys])


def as_it_is(dataset: Dataset) -> Dataset:
    """The dataset with the joints that the robot has in truth."""
    truth = find_truth(dataset)
    assert truth is not None
    values = {name: joint.values.copy() for name, joint in dataset.joints.items()}
    for name, joint in truth.joints.items():
        for parameter, value in joint.items():
            values[name][JOINT_PARAMETERS.index(parameter)] = value
    return dataset.with_joints(values)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("name", SYSTEMS)
def test_our_command_makes_them_byte_for_byte(name: str, tmp_path: Path) -> None:
    shipped = DATASETS / name
    collect_dataset(CollectionRequest(shipped, motion=f"generate:{POSES[name]}", seed=SEED), tmp_path)
    made, there = content(tmp_path), content(shipped)
    assert made.keys() == there.keys()
    assert not [file for file in made if made[file] != there[file]]


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_motions_are_generated_from_the_seed(systems: dict[str, System], name: str) -> None:
    shipped = read_motion(DATASETS / name / "motion.json")
    generated = generate_motion(systems[name], len(shipped), SEED)
    for a, b in ((shipped.positions, generated.positions), (shipped.orientations, generated.orientations)):
        np.testing.assert_array_equal(a, b)  # type: ignore[arg-type]
    for joint, positions in shipped.joints.items():
        np.testing.assert_array_equal(positions, generated.joints[joint])


@pytest.mark.parametrize("name", SYSTEMS)
def test_they_are_complete(datasets: dict[str, Dataset], name: str) -> None:
    dataset = datasets[name]
    assert len(dataset.collections) == POSES[name]
    for sensor in dataset.sensors.values():
        assert len(dataset.detections("pattern_1", sensor.name)) == len(dataset.collections)
    for collection in dataset.document["collections"].values():
        for message in collection["data"].values():
            assert (DATASETS / name / message["data_file"]).exists()


def test_they_are_small() -> None:
    sizes = {name: sum(path.stat().st_size for path in (DATASETS / name).iterdir()) for name in SYSTEMS}
    assert sum(sizes.values()) < 21_000_000
    assert max(sizes["softbot"], sizes["spjbot"]) < 4_000_000


@pytest.mark.parametrize("name", SYSTEMS)
def test_they_calibrate_to_the_truth(name: str) -> None:
    results = json.loads((DATASETS / name / "results.json").read_text())
    assert results["verdict"] == "pass"
    assert results["calibration"]["translation_mm"] < 1
    assert results["calibration"]["rotation_deg"] < 0.1


@pytest.mark.parametrize("name", SYSTEMS)
def test_corners_are_where_the_images_show_them(
    datasets: dict[str, Dataset], systems: dict[str, System], name: str
) -> None:
    """The detector finds the labels again in the files, which JPEG has changed a little."""
    dataset, system = datasets[name], systems[name]
    detector = corner_detector(system.configuration.patterns["pattern_1"])
    for camera in system.cameras:
        for number, labels in dataset.detections("pattern_1", camera)[::6]:
            assert isinstance(labels, CornerLabels)
            message = dataset.document["collections"][dataset.keys[number]]["data"][camera]
            image = cv2.imread(str(DATASETS / name / message["data_file"]))
            assert image is not None
            again = detector.detect(np.asarray(image, np.uint8))
            assert isinstance(again, CornerLabels)
            _, here, there = np.intersect1d(labels.ids, again.ids, return_indices=True)
            assert len(here) > 0.9 * len(labels.ids)
            distance = np.linalg.norm(labels.pixels[here] - again.pixels[there], axis=-1)
            assert np.sqrt((distance**2).mean()) < 0.15


@pytest.mark.parametrize("name", SYSTEMS)
def test_corners_reproject_on_the_truth(datasets: dict[str, Dataset], name: str) -> None:
    dataset = as_it_is(datasets[name])
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
        assert np.sqrt((error**2).sum(-1).mean()) < 0.1
        assert np.abs(error.mean(0)).max() < 0.01


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
        "softbot": {
            "front_left_camera": (0, -0.045, 0),
            "front_right_camera": (0, -0.045, 0),
            "lidar3d": (0, 0, 0.01),
        },
        "spjbot": {"rgb_hand": (0.06, 0.02, 0.04)},
    }[name]
    for sensor_name, xyz in expected.items():
        np.testing.assert_allclose(truth.transforms[truth.sensors[sensor_name]][:3, 3], xyz)
    if name == "riwbot":
        np.testing.assert_allclose(truth.transforms["flange", "pattern_link"][:3, 3], [0.06, -0.06, 0])


def test_the_joints_in_the_file_are_those_of_the_description(datasets: dict[str, Dataset]) -> None:
    """The truth has the errors of the simulation; each joint's transform matches its parameters in the file."""
    dataset = datasets["spjbot"]
    truth = find_truth(dataset)
    assert truth is not None
    assert truth.joints == {
        "j2_joint": {"origin_yaw": 0.02},
        "j3_joint": {"origin_z": 0.105},
        "j4_joint": {"origin_yaw": -0.015},
    }
    for joint in dataset.joints.values():
        np.testing.assert_allclose(joint.transform, dataset.transforms[joint.edge], atol=2e-9)
    assert [float(joint.values[5]) for joint in dataset.joints.values()] == [0, 0, 0]
    assert dataset.joints["j3_joint"].values[2] == 0.1
    assert dataset.joints["j3_joint"].model.prismatic
    assert dataset.joints["j2_joint"].positions.std() > 0.3


def test_where_a_base_stood_is_part_of_the_truth(datasets: dict[str, Dataset]) -> None:
    dataset = datasets["softbot"]
    truth = find_truth(dataset)
    assert truth is not None
    edge = ("odometry_y", "base_footprint")
    assert dataset.moving_transforms == {edge}
    assert edge not in truth.transforms
    found = np.array([truth.patterns[key][edge] for key in dataset.keys])
    np.testing.assert_allclose(found, dataset.transforms[edge], atol=1e-9)


@pytest.mark.parametrize("name", ["softbot", "spjbot"])
@pytest.mark.parametrize("noise", [(0.0, 0.0), (0.5, 0.5)])
def test_errors_are_within_what_the_calibration_states(
    datasets: dict[str, Dataset], name: str, noise: tuple[float, float]
) -> None:
    dataset = datasets[name]
    truth = find_truth(dataset)
    assert truth is not None
    found = calibrate(dataset, None, StartingNoise(*noise))
    assert found.converged
    free = [sensor for sensor in dataset.sensors.values() if sensor.edge in found.covariances]
    assert len(free) == len(dataset.sensors) - (dataset.anchored is not None)
    for sensor in free:
        translation, angle = transforms.distance(truth.transforms[sensor.edge], found.transforms[sensor.edge])
        assert 1e3 * translation < 3 * found.label_sigma_mm(sensor.edge)
        assert 1e3 * angle < 3 * found.label_sigma_mrad(sensor.edge)
    error = truth_error(found.dataset, truth)
    assert len(error.joints) == (3 if name == "spjbot" else 0)
    sigmas = {(j.name, p): s for j in found.joints.values() for p, s in zip(j.parameters, j.label_sigmas, strict=True)}
    for each in error.joints:
        assert each.error < 3 * sigmas[each.joint, each.parameter] < 2e-4


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
    most = 0.03 if dataset.joints else 0.01  # through the joints as they were designed
    assert 1e-5 < translation.max() < most
    assert 1e-5 < np.median(angle) < angle.max() < most


@pytest.mark.parametrize("name", FREE)
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
