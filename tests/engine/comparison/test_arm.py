"""The methods of an arm on datasets: exact arms, known figures, several patterns, what they cannot do."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import calibration.engine.comparison.arm as arm_module
from calibration.base import InputError, UndeterminedError
from calibration.engine.comparison import COMPARISON_METHODS
from calibration.engine.comparison.arm import why_not_arm
from calibration.engine.dataset.modalities import DEPTH
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.geometry.transforms import distance, from_xyz_rpy, retract
from tests.engine.evaluation.scene import arm, lidar, rgb, two_cameras, with_labels
from tests.engine.evaluation.scene import corner_labels as corners_on_the_image

NAMES = ("shah", "li", "tsai", "park", "horaud", "andreff", "daniilidis")
EACH = pytest.mark.parametrize("name", NAMES)
MOUNT = ("eye_mount", "eye_link")


@pytest.fixture(params=["OpenCV", "built in"])
def whose(request, monkeypatch):
    """Whose implementation runs."""
    if request.param == "built in":
        monkeypatch.setattr(arm_module, "opencv_with", lambda _: None)
    elif not arm_module.opencv_with(arm_module.HAND_EYE_FUNCTION):
        pytest.skip("OpenCV 5 has no calibrateHandEye")
    return request.param


def disturbed(dataset: Dataset, *edges: tuple[str, str]) -> Dataset:
    """The dataset with other transforms at these edges: what a calibration starts from."""
    twist = np.broadcast_to([0.3, -0.2, 0.4, 0.5, -0.5, 0.3], (len(dataset.keys), 6))
    return dataset.with_transforms({edge: retract(dataset.transforms[edge], twist) for edge in edges})


def changed(before: Dataset, after: Dataset) -> list[tuple[str, str]]:
    return sorted(edge for edge in after.transforms if after.transforms[edge] is not before.transforms.get(edge))


@EACH
@pytest.mark.parametrize("eye_in_hand", [False, True])
def test_an_exact_arm_gives_the_exact_camera_and_pattern(name, eye_in_hand, whose):
    dataset = arm(seed=1, eye_in_hand=eye_in_hand)
    board = ("world" if eye_in_hand else "flange", "board_link")
    start = disturbed(dataset, MOUNT, board)
    found = COMPARISON_METHODS[name].run(start)
    for edge in dataset.transforms:
        np.testing.assert_allclose(found.transforms[edge], dataset.transforms[edge], atol=1e-6)
    assert changed(start, found) == sorted([MOUNT, board])


@EACH
def test_a_pattern_whose_transform_is_not_in_the_file_gets_one(name):
    dataset = arm(seed=3)
    without = {edge: T for edge, T in dataset.transforms.items() if edge != ("flange", "board_link")}
    found = COMPARISON_METHODS[name].run(replace(dataset, transforms=without))
    np.testing.assert_allclose(
        found.transforms["flange", "board_link"], dataset.transforms["flange", "board_link"], atol=1e-6
    )


@pytest.mark.parametrize(
    ("name", "millimetres", "degrees"),
    [
        ("shah", 0.472, 0.0311),  # as ATOM's own solvers
        ("li", 0.378, 0.0277),
        ("park", 0.371, 0.0329),  # as ATOM, where OpenCV solves them
        ("andreff", 0.621, 0.0286),
        ("horaud", 0.373, 0.0311),
        ("daniilidis", 0.423, 0.0325),
    ],
)
def test_the_synthetic_arm_gives_the_known_figures(shared_data, name, millimetres, degrees, whose):
    dataset = read_dataset(shared_data / "synthetic" / "riwbot")
    found = error(dataset, COMPARISON_METHODS[name].run(dataset))
    assert found == (pytest.approx(millimetres, abs=6e-4), pytest.approx(degrees, abs=6e-5))


def test_opencv_leaves_out_motions_for_tsai(shared_data, whose):
    dataset = read_dataset(shared_data / "synthetic" / "riwbot")
    millimetres, degrees = error(dataset, COMPARISON_METHODS["tsai"].run(dataset))
    if whose == "built in":
        assert (millimetres, degrees) == (pytest.approx(0.373, abs=6e-4), pytest.approx(0.0311, abs=6e-5))
    assert 0.3 < millimetres < 0.8
    assert 0.03 < degrees < 0.04


def error(dataset: Dataset, found: Dataset) -> tuple[float, float]:
    edge = dataset.sensors["rgb_world"].edge
    translation, angle = distance(dataset.transforms[edge][0], found.transforms[edge][0])
    return 1000 * float(translation), float(np.degrees(angle))


@EACH
@pytest.mark.parametrize("eye_in_hand", [False, True])
def test_ours_and_opencvs_are_one_method(name, eye_in_hand, monkeypatch):
    if not arm_module.opencv_with(arm_module.HAND_EYE_FUNCTION):
        pytest.skip("OpenCV 5 has no calibrateHandEye")
    dataset = arm(seed=10, n=12, noise=0.5, eye_in_hand=eye_in_hand)
    theirs = COMPARISON_METHODS[name].run(dataset)
    assert COMPARISON_METHODS[name].describe(dataset).startswith("OpenCV 4.")
    monkeypatch.setattr(arm_module, "opencv_with", lambda _: None)
    ours = COMPARISON_METHODS[name].run(dataset)
    assert COMPARISON_METHODS[name].describe(dataset) == "built in"
    tolerance = 2e-3 if name == "tsai" else 1e-8  # Tsai's motions are not the same
    for edge in (MOUNT, ("world" if eye_in_hand else "flange", "board_link")):
        np.testing.assert_allclose(theirs.transforms[edge], ours.transforms[edge], atol=tolerance)
        assert not np.allclose(ours.transforms[edge], dataset.transforms[edge], atol=1e-5, rtol=0)  # of noisy labels


@EACH
def test_the_start_does_not_matter(name, whose):
    dataset = arm(seed=4, noise=0.3)
    a, b = (COMPARISON_METHODS[name].run(d).transforms[MOUNT] for d in (dataset, disturbed(dataset, MOUNT)))
    np.testing.assert_array_equal(a, b)


# What does not determine it


def still_arm() -> Dataset:
    """The arm moves and does not turn."""
    dataset = arm(seed=6)
    flange = dataset.transforms["world", "flange"].copy()
    flange[:] = flange[0]
    flange[:, 0, 3] += np.linspace(0, 0.02, len(flange))
    return seen_again(dataset.with_transforms({("world", "flange"): flange}))


def seen_again(dataset: Dataset) -> Dataset:
    """The dataset with what its camera sees of its first pattern where the arm is now."""
    sensor, board = dataset.sensors["eye"], dataset.patterns["board"]
    assert sensor.camera is not None
    T = dataset.transform(sensor.frame, board.link)
    pixels = [sensor.camera.project(board.corners @ t[:3, :3].T + t[:3, 3]) for t in T]
    return with_labels(dataset, "eye", [CornerLabels(np.arange(30), p) for p in pixels])


@EACH
def test_an_arm_that_turns_too_little_is_refused(name):
    with pytest.raises(UndeterminedError, match="between 'eye_mount' and 'flange' the arm turns about one axis only"):
        COMPARISON_METHODS[name].run(arm(seed=5, noise=0.1, axis=np.array([0.0, 0.0, 1.0])))
    with pytest.raises(UndeterminedError, match="the arm does not turn; rotations about two axes are needed"):
        COMPARISON_METHODS[name].run(still_arm())


def test_opencvs_tsai_says_when_it_leaves_out_every_motion(capfd):
    if not arm_module.opencv_with(arm_module.HAND_EYE_FUNCTION):
        pytest.skip("OpenCV 5 has no calibrateHandEye")
    dataset = arm(seed=11)
    flange = dataset.transforms["world", "flange"]
    twist = np.zeros((len(flange), 6))
    twist[:, 3:] = 0.02 * np.random.default_rng(11).normal(size=(len(flange), 3))
    little = seen_again(
        dataset.with_transforms({("world", "flange"): retract(flange[:1].repeat(len(flange), 0), twist)})
    )
    assert distance(COMPARISON_METHODS["park"].run(little).transforms[MOUNT], dataset.transforms[MOUNT])[1].max() < 1e-3
    with pytest.raises(UndeterminedError, match="OpenCV's calibrateHandEye: Tsai needs larger rotations"):
        COMPARISON_METHODS["tsai"].run(little)
    assert capfd.readouterr().err == ""


@EACH
def test_what_opencv_refuses_is_told_in_one_line(name, monkeypatch):
    cv2 = arm_module.opencv_with(arm_module.HAND_EYE_FUNCTION)
    if not cv2:
        pytest.skip("OpenCV 5 has no calibrateHandEye")

    def refuse(*_args, **_kwargs):
        raise cv2.error("Assertion failed\n > in function 'x'")

    for function in (arm_module.HAND_EYE_FUNCTION, arm_module.ROBOT_WORLD_FUNCTION):
        monkeypatch.setattr(cv2, function, refuse)
    with pytest.raises(UndeterminedError, match=r"^OpenCV's calibrate\w+: Assertion failed > in function 'x'$"):
        COMPARISON_METHODS[name].run(arm(n=4))


def test_an_answer_that_is_no_number_is_an_error(monkeypatch):
    cv2 = arm_module.opencv_with(arm_module.HAND_EYE_FUNCTION)
    if not cv2:
        pytest.skip("OpenCV 5 has no calibrateHandEye")
    monkeypatch.setattr(
        cv2, arm_module.HAND_EYE_FUNCTION, lambda *_args, **_kwargs: (np.full((3, 3), np.nan), np.zeros((3, 1)))
    )
    with pytest.raises(UndeterminedError, match="OpenCV's calibrateHandEye: its answer is not finite"):
        COMPARISON_METHODS["park"].run(arm(n=4))


@pytest.mark.parametrize("missing", ["the package", "the function"])
def test_without_opencvs_function_ours_runs(missing, monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None if missing == "the package" else object())
    assert COMPARISON_METHODS["park"].describe(arm(n=4)) == "built in"
    dataset = arm(seed=16)
    np.testing.assert_allclose(
        COMPARISON_METHODS["li"].run(dataset).transforms[MOUNT], dataset.transforms[MOUNT], atol=1e-6
    )


def test_two_views_are_too_few():
    dataset = arm(seed=7, n=5)
    few = with_labels(
        dataset, "eye", [c.labels["board", "eye"] if i < 2 else None for i, c in enumerate(dataset.collections)]
    )
    with pytest.raises(UndeterminedError, match="'eye' has 2 views of 'board'; at least 3 are needed"):
        COMPARISON_METHODS["shah"].run(few)


def test_why_it_does_not_apply():
    dataset = arm(seed=8)
    board = dataset.patterns["board"]
    assert why_not_arm(dataset) is None
    for other, reason in (
        (replace(dataset, sensors={"scan": lidar("scan")}), "it needs cameras only, and 'scan' is lidar3d"),
        (
            replace(dataset, sensors={"eye": replace(dataset.sensors["eye"], modality=DEPTH)}),
            "it needs cameras only, and 'eye' is depth",
        ),
        (
            replace(dataset, additional_transforms=(("a", "b"),)),
            "it cannot calibrate additional transforms, such as 'a-b'",
        ),
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
        assert why_not_arm(other) == reason
        with pytest.raises(InputError, match=f"^scene/dataset.json: the method does not apply: {reason}"):
            COMPARISON_METHODS["shah"].run(other)


# Several cameras, several patterns


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
    found = COMPARISON_METHODS["shah"].run(with_labels(both, "other", list(labels.values())))
    for edge in (MOUNT, ("other_mount", "other_link")):
        np.testing.assert_allclose(found.transforms[edge], dataset.transforms[MOUNT], atol=1e-6)


def with_a_second_pattern(dataset: Dataset, parent: str, T_parent_card, views: int) -> Dataset:
    """The dataset with a pattern "card", labelled in the first collections."""
    card = replace(dataset.patterns["board"], name="card", link="card_link", parent_link=parent)
    placed = replace(dataset, patterns={**dataset.patterns, "card": card}).with_transforms(
        {(parent, "card_link"): np.broadcast_to(T_parent_card, (len(dataset.keys), 4, 4))}
    )
    camera = placed.sensors["eye"].camera
    assert camera is not None
    T = placed.transform("eye_optical", "card_link")
    nothing = np.zeros((len(card.corners), 2))
    collections = [
        replace(c, labels={**c.labels, ("card", "eye"): corners_on_the_image(camera, card, T[i], nothing)})
        if i < views
        else c
        for i, c in enumerate(placed.collections)
    ]
    return replace(placed, collections=tuple(collections))


BESIDE = from_xyz_rpy([0.1, 0.05, 0.03], [0.1, 0.2, 0.3])
BOARD, CARD = ("flange", "board_link"), ("flange", "card_link")


@pytest.mark.thorough(but_first=8)
@EACH
@pytest.mark.parametrize("eye_in_hand", [False, True])
def test_of_several_patterns_the_one_seen_most_often_counts_and_the_others_are_placed(name, eye_in_hand, whose):
    dataset = arm(seed=12, n=9, eye_in_hand=eye_in_hand)
    parent = "world" if eye_in_hand else "flange"
    board, card = (parent, "board_link"), (parent, "card_link")
    T_parent_card = dataset.transforms[board][0] @ BESIDE
    several = with_a_second_pattern(dataset, parent, T_parent_card, views=5)
    start = disturbed(several, MOUNT, board, card)
    found = COMPARISON_METHODS[name].run(start)
    for edge in several.transforms:
        np.testing.assert_allclose(found.transforms[edge], several.transforms[edge], atol=1e-6)
    assert changed(start, found) == sorted([MOUNT, board, card])
    assert COMPARISON_METHODS[name].describe(several).endswith("; 'eye' by 'board' (9 views)")
    assert COMPARISON_METHODS[name].describe(several).startswith(whose)


def test_of_several_patterns_one_that_determines_nothing_is_not_chosen():
    """The card hangs on a link that only slides; the board is seen less often, before an arm that turns."""
    dataset = arm(seed=13, n=9)
    slide = np.eye(4) + np.zeros((9, 4, 4))
    slide[:, 0, 3] = np.linspace(0, 0.05, 9)
    T_world_card = dataset.transform("world", "board_link")[0] @ BESIDE
    sliding = dataset.with_transforms({("world", "slide"): slide})
    several = with_a_second_pattern(sliding, "slide", T_world_card, views=9)
    rare = [c.labels["board", "eye"] if i < 6 else None for i, c in enumerate(several.collections)]
    several = with_labels(several, "eye", rare)
    found = COMPARISON_METHODS["shah"].run(disturbed(several, MOUNT, BOARD, ("slide", "card_link")))
    for edge in several.transforms:
        np.testing.assert_allclose(found.transforms[edge], several.transforms[edge], atol=1e-6)
    assert COMPARISON_METHODS["shah"].describe(several).endswith("; 'eye' by 'board' (6 views)")


def test_a_pattern_that_moves_is_left_alone_beside_one_that_does_not():
    dataset = arm(seed=14, n=9)
    several = with_a_second_pattern(dataset, "flange", dataset.transforms[BOARD][0] @ BESIDE, views=9)
    free = replace(several, patterns={**several.patterns, "card": replace(several.patterns["card"], fixed=False)})
    start = disturbed(free, MOUNT, BOARD, CARD)
    found = COMPARISON_METHODS["li"].run(start)
    assert changed(start, found) == sorted([MOUNT, BOARD])
    np.testing.assert_allclose(found.transforms[MOUNT], dataset.transforms[MOUNT], atol=1e-6)


def test_a_pattern_that_no_camera_sees_is_left_alone():
    dataset = arm(seed=15, n=6)
    several = with_a_second_pattern(dataset, "flange", dataset.transforms[BOARD][0] @ BESIDE, views=0)
    assert changed(several, COMPARISON_METHODS["li"].run(several)) == sorted([MOUNT, BOARD])
