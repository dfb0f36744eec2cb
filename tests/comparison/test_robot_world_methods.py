"""Shah and Li on datasets: exact arms, known figures, motions and datasets that they cannot do."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.comparison.robot_world_methods import li, shah, why_not_robot_world
from calibration.dataset.model import CornerLabels, Dataset
from calibration.dataset.reading import read_dataset
from calibration.errors import InputError, UndeterminedError
from calibration.geometry.transforms import distance, retract
from tests.evaluation.scene import arm, lidar, rgb, two_cameras, with_labels

METHODS = pytest.mark.parametrize("method", [shah, li])
MOUNT = ("eye_mount", "eye_link")


def disturbed(dataset: Dataset, *edges: tuple[str, str]) -> Dataset:
    """The dataset with other transforms at these edges: what a calibration starts from."""
    twist = np.broadcast_to([0.3, -0.2, 0.4, 0.5, -0.5, 0.3], (len(dataset.keys), 6))
    return dataset.with_transforms({edge: retract(dataset.transforms[edge], twist) for edge in edges})


@METHODS
@pytest.mark.parametrize("eye_in_hand", [False, True])
def test_an_exact_arm_gives_the_exact_camera_and_pattern(method, eye_in_hand):
    dataset = arm(seed=1, eye_in_hand=eye_in_hand)
    board = ("world" if eye_in_hand else "flange", "board_link")
    found = method(disturbed(dataset, MOUNT, board))
    for edge in (MOUNT, board):
        np.testing.assert_allclose(found.transforms[edge], dataset.transforms[edge], atol=1e-6)


@METHODS
def test_nothing_but_camera_and_pattern_changes(method):
    dataset = arm(seed=2)
    found = method(dataset)
    changed = [edge for edge in dataset.transforms if found.transforms[edge] is not dataset.transforms[edge]]
    assert sorted(changed) == [MOUNT, ("flange", "board_link")]


@METHODS
def test_a_pattern_whose_transform_is_not_in_the_file_gets_one(method):
    dataset = arm(seed=3)
    without = {edge: T for edge, T in dataset.transforms.items() if edge != ("flange", "board_link")}
    found = method(replace(dataset, transforms=without))
    np.testing.assert_allclose(
        found.transforms["flange", "board_link"], dataset.transforms["flange", "board_link"], atol=1e-6
    )


@pytest.mark.parametrize(("method", "millimetres", "degrees"), [(shah, 0.47, 0.031), (li, 0.38, 0.028)])
def test_the_synthetic_arm_gives_the_figures_of_atoms_methods(shared_data, method, millimetres, degrees):
    dataset = read_dataset(shared_data / "synthetic" / "riwbot")
    edge = dataset.sensors["rgb_world"].edge
    translation, angle = distance(dataset.transforms[edge][0], method(dataset).transforms[edge][0])
    assert 1000 * translation == pytest.approx(millimetres, abs=0.005)
    assert np.degrees(angle) == pytest.approx(degrees, abs=0.0005)


@METHODS
def test_the_start_does_not_matter(method):
    dataset = arm(seed=4, noise=0.3)
    a, b = (method(d).transforms[MOUNT] for d in (dataset, disturbed(dataset, MOUNT)))
    np.testing.assert_array_equal(a, b)


@METHODS
def test_an_arm_that_turns_about_one_axis_is_refused(method):
    dataset = arm(seed=5, noise=0.1, axis=np.array([0.0, 0.0, 1.0]))
    with pytest.raises(UndeterminedError, match="between 'eye_mount' and 'flange' the arm turns about one axis only"):
        method(dataset)


def still_arm() -> Dataset:
    """The arm moves and does not turn."""
    dataset = arm(seed=6)
    flange = dataset.transforms["world", "flange"].copy()
    board = dataset.patterns["board"]
    flange[:] = flange[0]
    flange[:, 0, 3] += np.linspace(0, 0.02, len(flange))
    still = dataset.with_transforms({("world", "flange"): flange})
    sensor = still.sensors["eye"]
    assert sensor.camera is not None
    T = still.transform(sensor.frame, "board_link")
    pixels = [sensor.camera.project(board.corners @ t[:3, :3].T + t[:3, 3]) for t in T]
    return with_labels(still, "eye", [CornerLabels(np.arange(30), p) for p in pixels])


@METHODS
def test_an_arm_that_does_not_turn_is_refused(method):
    with pytest.raises(UndeterminedError, match="the arm does not turn; rotations about two axes are needed"):
        method(still_arm())


@METHODS
def test_two_views_are_too_few(method):
    dataset = arm(seed=7, n=5)
    few = with_labels(
        dataset, "eye", [c.labels["board", "eye"] if i < 2 else None for i, c in enumerate(dataset.collections)]
    )
    with pytest.raises(UndeterminedError, match="'eye' has 2 views of 'board'; at least 3 are needed"):
        method(few)


def test_why_it_does_not_apply():
    dataset = arm(seed=8)
    board = dataset.patterns["board"]
    assert why_not_robot_world(dataset) is None
    for other, reason in (
        (replace(dataset, sensors={"scan": lidar("scan")}), "it needs cameras only, and 'scan' is lidar3d"),
        (
            replace(dataset, sensors={"eye": replace(dataset.sensors["eye"], modality="depth")}),
            "it needs cameras only, and 'eye' is depth",
        ),
        (
            replace(dataset, additional_transforms=(("a", "b"),)),
            "it cannot calibrate additional transforms, such as 'a-b'",
        ),
        (replace(dataset, patterns={"board": board, "card": board}), "it needs one pattern, and there are 2"),
        (two_cameras(n=2)[0], "it needs a pattern fixed to the world or to an arm, and 'board' moves freely"),
        (
            replace(dataset, patterns={"board": replace(board, parent_link="eye_link")}),
            "it needs an arm between camera and pattern, and 'board' is carried by 'eye'",
        ),
        (
            replace(dataset, patterns={"board": replace(board, parent_link="world")}),
            "it needs an arm, and nothing moves between 'eye_mount' and 'world'",
        ),
    ):
        assert why_not_robot_world(other) == reason
        with pytest.raises(InputError, match=f"^scene/dataset.json: the method does not apply: {reason}"):
            shah(other)


def test_every_camera_is_solved():
    dataset = arm(seed=9)
    twin = rgb("eye", dataset.sensors["eye"].camera)
    labels = {i: c.labels["board", "eye"] for i, c in enumerate(dataset.collections)}
    second = replace(
        twin, name="other", calibration_parent="other_mount", calibration_child="other_link", frame="other_optical"
    )
    both = replace(dataset, sensors={**dataset.sensors, "other": second}).with_transforms(
        {
            ("world", "other_mount"): dataset.transforms["world", "eye_mount"],
            ("other_mount", "other_link"): np.eye(4),
            ("other_link", "other_optical"): dataset.transforms["eye_link", "eye_optical"],
        }
    )
    found = shah(with_labels(both, "other", list(labels.values())))
    for edge in (MOUNT, ("other_mount", "other_link")):
        np.testing.assert_allclose(found.transforms[edge], dataset.transforms[MOUNT], atol=1e-6)
