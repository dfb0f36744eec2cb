"""Single tags and markers, one or several in a plane: corners where the truth projects them."""

import cv2
import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import PlacedTag
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.simulation.rendering.texture import tag_modules
from tests.robot.labelling.pictures import HD_DISTORTED, VGA, facing
from tests.robot.labelling.test_unmarked_grids import rendered


def tags(dictionary: str, *placed: PlacedTag, inverted: bool = False) -> PatternConfiguration:
    size = placed[0].size
    return PatternConfiguration(
        "tag", "tags", "tag", "world", False, (len(placed), 1), size, None, (0.03, 0.03), dictionary,
        tags=placed, inverted=inverted,
    )  # fmt: skip


ONE = tags("DICT_APRILTAG_36h11", PlacedTag(7, 0.1))
SEVERAL = tags("DICT_4X4_50", PlacedTag(3, 0.1), PlacedTag(9, 0.1, 0.02, 0.2, -1.0), PlacedTag(5, 0.08, 0.2, 0.05, 0.4))


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("pattern", [ONE, SEVERAL, tags("DICT_5X5_100", PlacedTag(42, 0.1), inverted=True)])
@pytest.mark.parametrize("camera", [VGA, HD_DISTORTED], ids=["pinhole", "distorted"])
def test_corners_are_where_the_truth_projects_them(pattern: PatternConfiguration, camera: Camera) -> None:
    """OpenCV's own are 0.24 px (subpix) to 0.8 px off."""
    off = []
    for i in range(4):
        T = facing(pattern, 0.7, 0.3 + 0.12 * i, 1.1 * i, 1.5 * i)
        found = corner_detector(pattern).detect(rendered(pattern, T, camera, i))
        assert isinstance(found, CornerLabels), found
        assert found.ids.tolist() == list(range(4 * len(pattern.tags)))
        off.append(found.pixels - camera.project(apply(T, pattern.pattern().corners)))
    assert np.sqrt((np.concatenate(off) ** 2).sum(-1).mean()) < 0.06


@pytest.mark.parametrize("roll", [0.0, 0.4, 0.8])
def test_corners_of_a_tag_at_a_grazing_angle(roll: float) -> None:
    """A module is as narrow as the tag is seen: edges beyond it are those of the next one, pixels away."""
    T = facing(ONE, 0.35, 1.25, 0.8, roll)
    found = corner_detector(ONE).detect(rendered(ONE, T))
    assert isinstance(found, CornerLabels), found
    assert np.abs(found.pixels - VGA.project(apply(T, ONE.pattern().corners))).max() < 0.5


def test_a_hidden_tag_is_left_out() -> None:
    T = facing(SEVERAL, 0.8, 0.3)
    image = rendered(SEVERAL, T)
    x, y = VGA.project(apply(T, SEVERAL.pattern().corners))[4:8].mean(0).astype(int)
    image[y - 15 : y + 15, x - 15 : x + 15] = 120
    found = corner_detector(SEVERAL).detect(image)
    assert isinstance(found, CornerLabels), found
    assert found.ids.tolist() == [0, 1, 2, 3, 8, 9, 10, 11]


def test_other_tags_and_noise_are_no_detection() -> None:
    image = rendered(ONE, facing(ONE, 0.8, 0.3))
    assert isinstance(corner_detector(tags("DICT_APRILTAG_36h11", PlacedTag(8, 0.1))).detect(image), NotDetected)
    assert isinstance(corner_detector(SEVERAL).detect(image), NotDetected)
    random = np.random.default_rng(0)
    for shape in ((0, 0), (1, 1), (20, 20), (240, 320)):
        noise = random.integers(0, 256, shape, dtype=np.uint8)
        assert isinstance(corner_detector(ONE).detect(noise), NotDetected)


@pytest.mark.parametrize(
    ("dictionary", "tag", "named"), [("DICT_4X4_50", 50, "found tag 50"), ("FORTY", 1, "found 'FORTY'")]
)
def test_tags_that_no_dictionary_has_are_refused(dictionary: str, tag: int, named: str) -> None:
    with pytest.raises(InputError, match=named):
        corner_detector(tags(dictionary, PlacedTag(tag, 0.1)))


@pytest.mark.parametrize(("number", "code"), [(1, 0xD97F18B49), (2, 0xDD280910E), (3, 0xE479E9C98)])
def test_a_tag_is_upright_as_apriltag_draws_it(number: int, code: int) -> None:
    """OpenCV 4 draws AprilTag's tags upside down; codes are those of AprilTag's tag36h11, row by row."""
    bits = np.array([code >> i & 1 for i in range(35, -1, -1)]).reshape(6, 6)
    official = np.pad(np.pad(bits, 1), 2, constant_values=1)
    image = np.kron(255 * official, np.ones((24, 24))).astype(np.uint8)
    pattern = tags("DICT_APRILTAG_36h11", PlacedTag(number, 0.1))
    found = corner_detector(pattern).detect(image)
    assert isinstance(found, CornerLabels), found
    np.testing.assert_allclose(found.pixels, 47.5 + 192 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), atol=0.3)
    np.testing.assert_array_equal(tag_modules(pattern)[0], official[2:-2, 2:-2])


@pytest.mark.parametrize("margin", [4, 8, 12, 24])
def test_a_white_margin_that_was_cut_moves_no_corner(margin: int) -> None:
    """On something dark, as tags are that were cut out close: margins of a sixth to one module of 12 px."""
    drawn = np.kron(255 * (tag_modules(ONE)[0] > 0), np.ones((24, 24))).astype(np.uint8)
    page = np.pad(np.pad(drawn, margin, constant_values=255), 100 - margin, constant_values=20)
    image = cv2.resize(cv2.GaussianBlur(page, (0, 0), 1.2), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    found = corner_detector(ONE).detect(image)
    if margin == 4:
        assert isinstance(found, NotDetected)
        return
    assert isinstance(found, CornerLabels), found
    side = drawn.shape[0] / 2
    expected = 49.5 + side * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    np.testing.assert_allclose(np.roll(found.pixels, -found.ids[0], axis=0), expected, atol=0.1)
