"""A recording made by another convention is named first; a good one, or one wrong in another way, is not accused."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.base import CalibrationError
from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import POSE
from calibration.engine.dataset.model import Collection, Dataset, PoseLabels, Sensor
from calibration.engine.diagnosis.conventions.changed import (
    scaled_translations,
    with_exchanged_cameras,
    with_exchanged_labels,
    with_later_labels,
    with_mirrored,
    with_mirrored_numbering,
    with_scaled_patterns,
)
from calibration.engine.diagnosis.conventions.trying import conventions
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.ambiguous_views import with_turned
from calibration.engine.geometry import rotations
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import inverse, transform, translation
from tests.engine.estimation import systems
from tests.engine.estimation.scenes import PINHOLE, camera
from tests.thorough import thorough

EDGES = {"eye_to_hand": ("base", "flange"), "eye_in_hand": ("world", "flange")}
ROUGH = replace(Options(), description="rough")


def arm(name: str = "eye_to_hand") -> Dataset:
    return systems.__dict__[name](14, seed=2, pixel_noise=0.1).dataset()


def with_poses(dataset: Dataset, change: Callable[[Array], Array], name: str = "eye_to_hand") -> Dataset:
    edge = EDGES[name]
    return dataset.with_transforms({edge: change(dataset.transforms[edge])})


def rotated(change: Callable[[Array], Array]) -> Callable[[Array], Array]:
    return lambda T: transform(change(T[:, :3, :3]), T[:, :3, 3])


def pairs() -> Dataset:
    """What the camera of an arm sees, as measured poses with 0.5 mm and 1 mrad of noise."""
    scene = systems.eye_in_hand(14, seed=2)
    dataset = scene.dataset()
    seen = dataset.transform("cam", "board_link")
    rng = np.random.default_rng(0)
    noisy = transform(
        seen[:, :3, :3] @ rotations.exp(1e-3 * rng.normal(size=(14, 3))),
        seen[:, :3, 3] + 5e-4 * rng.normal(size=(14, 3)),
    )
    sensor = dataset.sensors["cam"]
    tracker = Sensor("cam", POSE, sensor.frame, *sensor.edge)
    labels = [Collection(key, {("board", "cam"): PoseLabels(T)}) for key, T in zip(dataset.keys, noisy, strict=True)]
    return replace(dataset, sensors={"cam": tracker}, collections=tuple(labels))


def measured(dataset: Dataset, change: Callable[[Array], Array]) -> Dataset:
    collections = [
        Collection(
            c.key,
            {
                key: PoseLabels(change(label.T[None])[0])
                for key, label in c.labels.items()
                if isinstance(label, PoseLabels)
            },
        )
        for c in dataset.collections
    ]
    return replace(dataset, collections=tuple(collections))


def first_reason(dataset: Dataset) -> str:
    """The first finding, by a calibration where there is one."""
    try:
        found = diagnose(calibrate(dataset, ROUGH), dataset, ROUGH, Limits(translation_mm=5.0))
    except CalibrationError:
        found = conventions(None, dataset, ROUGH)
    assert found
    assert (found[0].kind, found[0].severity) == ("convention", "red")
    assert [each for each in found[1:] if each.severity == "red"] == []  # consequences are no reasons
    return found[0].text


def wxyz(R: Array) -> Array:
    return rotations.from_quaternion(np.roll(rotations.to_quaternion(R), 1, axis=-1))


ARM_MISTAKES: dict[str, tuple[Callable[[Array], Array], str]] = {
    "inverse": (inverse, "the robot's poses inverted"),
    "wxyz": (rotated(wxyz), "as quaternions wxyz"),
    "wxyz and inverse": (lambda T: rotated(wxyz)(inverse(T)), "as quaternions"),
    "rpy as vector": (
        rotated(lambda R: rotations.exp(rotations.to_rpy(R))),
        "Euler angles about the fixed axes x, y, z",
    ),
    "vector as rpy": (rotated(lambda R: rotations.from_rpy(rotations.log(R))), "as rotation vectors"),
    "other order": (
        rotated(lambda R: rotations.from_rpy(rotations.to_rpy(R)[:, ::-1])),
        "Euler angles about the",
    ),
    "degrees": (rotated(lambda R: rotations.exp(np.degrees(rotations.log(R)))), "rotation vectors in degrees"),
    "transposed": (rotated(lambda R: np.swapaxes(R, 1, 2)), "rotations of the robot's poses transposed"),
    "mm": (lambda T: scaled_translations(T, 1000.0), "the robot's poses in mm"),
    "inches": (lambda T: scaled_translations(T, 1 / 0.0254), "the robot's poses in inches"),
    "left-handed": (lambda T: np.diag([-1.0, 1, 1, 1]) @ T @ np.diag([-1.0, 1, 1, 1]), "left-handed frame"),
}


# The same equations with the board on the arm: what is tried is shown to be the same by some of them.
@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    ("name", "mistake"),
    [("eye_to_hand", "wxyz and inverse"), ("eye_in_hand", "mm")]
    + [thorough("eye_to_hand", each) for each in ARM_MISTAKES if each != "wxyz and inverse"]
    + [thorough("eye_in_hand", each) for each in ("inverse", "wxyz")],
)
def test_poses_of_an_arm_by_another_convention(name: str, mistake: str) -> None:
    change, named = ARM_MISTAKES[mistake]
    said = first_reason(with_poses(arm(name), change, name))
    assert named in said
    assert "px (as they are: " in said


def test_poses_of_other_images_are_told_by_the_angles_by_which_they_turn() -> None:
    other = rotations.exp(np.random.default_rng(1).normal(size=(14, 3)))
    [found] = conventions(None, with_poses(arm(), rotated(lambda R: other), "eye_to_hand"), ROUGH)
    assert found.text.startswith("poses and images do not belong together: between collections ")
    assert len(found.collections) == 2


@pytest.mark.parametrize("by", [1, thorough(-2)])
def test_images_and_poses_of_neighbouring_collections(by: int) -> None:
    later = f"{abs(by)} collection{'s' * (abs(by) > 1)} {'earlier' if by > 0 else 'later'}"
    assert f"the views taken from {later}" in first_reason(with_later_labels(arm(), by, ("cam",)))


def test_a_mounting_the_other_way_round_is_told_from_inverse_poses() -> None:
    dataset = arm("eye_in_hand")
    (sensor,), (board,) = dataset.sensors.values(), dataset.patterns.values()
    edges = {**dataset.transforms, ("world", "mount"): np.tile(np.eye(4), (14, 1, 1))}
    edges["flange", "board_link"] = edges.pop(("world", "board_link"))
    del edges["flange", "mount"]
    exchanged = replace(
        dataset,
        sensors={"cam": replace(sensor, calibration_parent="world")},
        patterns={"board": replace(board, parent_link="flange")},
        transforms=edges,
    )
    said = first_reason(exchanged)
    assert said.startswith("with 'cam' and 'board' mounted the other way round")
    assert "write 'parent: flange' for 'cam' and 'parent: world' for 'board'" in said


@pytest.mark.parametrize(
    ("change", "named"),
    [
        thorough(inverse, "the pattern's poses inverted"),
        thorough(lambda T: scaled_translations(T, 1000.0), "the pattern's poses in mm"),
        thorough(lambda T: scaled_translations(T, 1.2), "the pattern's poses, which are too long by 20 %"),
        (rotated(wxyz), "the rotations of the pattern's poses as quaternions wxyz"),
    ],
    ids=["inverse", "mm", "20 % too long", "wxyz"],
)
def test_measured_poses_by_another_convention(change: Callable[[Array], Array], named: str) -> None:
    assert conventions(None, pairs(), ROUGH) == ()
    assert named in first_reason(measured(pairs(), change))


def test_the_size_of_a_board_before_an_arm_is_named_with_its_squares() -> None:
    assert "squares of 60.1 mm for 72" in first_reason(with_scaled_patterns(arm(), 1.2))


def test_a_board_of_twice_the_size_is_named_before_an_arm_that_errs_by_millimetres() -> None:
    random = np.random.default_rng(0)
    shaken = with_poses(arm(), lambda T: T @ translation(random.normal(size=(len(T), 3), scale=0.008)), "eye_to_hand")
    assert conventions(None, shaken, ROUGH) == ()
    [found] = conventions(None, with_scaled_patterns(shaken, 2.1), ROUGH)
    assert "mm for 126 mm, the labels fit better, though not well" in found.text


RIG_MISTAKES: dict[str, tuple[Callable[[Dataset], Dataset], str]] = {
    "shifted": (lambda d: with_later_labels(d, 1, ("left",)), "taken from 1 collection"),
    "mirrored": (
        lambda d: with_mirrored(with_mirrored_numbering(d, "right", "board", across=False), "right"),
        "the images of 'right' mirrored back",
    ),
    "camera_info": (lambda d: with_exchanged_cameras(d, "left", "right"), "the camera_info of 'left' and 'right'"),
    "labels": (lambda d: with_exchanged_labels(d, "left", "right"), "the labels of 'left' and 'right' exchanged"),
    "some labels": (
        lambda d: with_exchanged_labels(d, "left", "right", d.keys[1::2]),
        "the labels of 'left' and 'right' exchanged in collections 001, 003, 005, 007 and ",
    ),
    "few labels": (
        lambda d: with_exchanged_labels(d, "left", "right", ("002", "003", "009")),
        "the labels of 'left' and 'right' exchanged in collections 002, 003, 009, the labels fit",
    ),
}


def test_images_of_which_only_the_columns_are_binned() -> None:
    dataset = arm()
    camera_ = dataset.sensors["cam"].camera
    assert camera_ is not None
    wide = replace(camera_, fx=2 * camera_.fx, cx=2 * camera_.cx)
    assert "the camera_info of 'cam' for images 0.5 times as wide" in first_reason(dataset.with_cameras({"cam": wide}))


@pytest.mark.parametrize(
    "mistake", ["camera_info", *(thorough(each) for each in RIG_MISTAKES if each != "camera_info")]
)
def test_two_cameras_by_another_convention(mistake: str) -> None:
    change, named = RIG_MISTAKES[mistake]
    assert named in first_reason(change(systems.stereo(14, seed=1, pixel_noise=0.1).dataset()))


def test_all_views_of_one_of_two_cameras_are_turned_back() -> None:
    wrong = with_turned(systems.stereo(14, seed=1, pixel_noise=0.1).dataset(), "board", "right")
    found = diagnose(calibrate(wrong, ROUGH), wrong, ROUGH, Limits(translation_mm=5.0))
    assert [each.kind for each in found if each.severity != "note"] == ["turned-board"]
    assert "14 of 14 views of 'board'" in found[0].text


def test_coefficients_of_both_cameras_in_another_order() -> None:
    k1, k2, p1, p2, k3 = -0.3, 0.1, 0.0004, -0.0003, -0.015
    lens = replace(PINHOLE, distortion=PlumbBob(k1, k2, p1, p2, k3))
    read = replace(lens, distortion=PlumbBob(k1, k2, k3, p1, p2))
    cameras = [camera(name, model=lens) for name in ("left", "right")]
    dataset = systems.stereo(14, seed=1, pixel_noise=0.1, sensors=cameras).dataset()
    [found] = conventions(None, dataset.with_cameras({"left": read, "right": read}), ROUGH)
    assert "the distortion of 'left' and 'right' as k1, k2, k3, p1, p2" in found.text


def test_mirrored_points_of_a_lidar() -> None:
    wrong = with_mirrored(systems.camera_and_lidar(12, seed=3).dataset(3), "lidar")
    assert "the points of 'lidar' mirrored back" in first_reason(wrong)


@pytest.mark.parametrize(
    "name", ["stereo", "eye_to_hand", *map(thorough, ("eye_in_hand", "two_bodies", "camera_and_lidar", "tripod"))]
)
def test_a_good_recording_is_not_accused(name: str) -> None:
    dataset = systems.__dict__[name](12, seed=4).dataset(4)
    assert conventions(None, dataset, ROUGH) == ()
    assert conventions(calibrate(dataset), dataset, ROUGH) == ()


def test_wrong_views_are_no_convention() -> None:
    """A third of the views of another collection: nothing else fits ten times better."""
    dataset = arm()
    order = np.arange(14)
    order[:5] = np.roll(order[:5], 2)
    collections = tuple(
        replace(c, labels=dataset.collections[i].labels) for c, i in zip(dataset.collections, order, strict=True)
    )
    assert conventions(None, replace(dataset, collections=collections), ROUGH) == ()
