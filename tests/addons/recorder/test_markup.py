import re

import numpy as np
import pytest
from defusedxml.ElementTree import fromstring
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.recorder import markup
from calibration.addons.recorder.preview import Preview, SensorPreview

PICTURE = np.full((30, 40, 3), 90, np.uint8)
texts = st.text(st.characters(exclude_categories=("Cs", "Cc", "Cn")))


def words(html: str) -> str:
    """What a reader sees; the markup is well formed."""
    return "".join(fromstring(f"<p>{html}</p>".replace("&nbsp;", " ")).itertext())


@given(texts)
def test_what_comes_from_elsewhere_is_text_and_never_markup(text: str) -> None:
    view = SensorPreview(text, detected=True)
    for html in (
        markup.verdict(Preview({}, (text,))),
        markup.finding(text, view),
        markup.message(text),
        markup.rating({text: (0.001, 0.002)}, ""),
        markup.rating({}, text or "none"),
    ):
        assert text in words(html)


def test_the_verdict_says_kept_or_lost_and_why() -> None:
    assert "Kept" in words(markup.verdict(Preview({}, ())))
    lost = words(markup.verdict(Preview({}, ("left: nothing", "right: hidden"))))
    assert all(part in lost for part in ("Lost", "left: nothing", "right: hidden"))
    assert "Kept" not in words(markup.verdict(None))
    assert 'aria-busy="true"' in markup.verdict(Preview({}, ()), is_old=True)
    assert 'aria-busy="false"' in markup.verdict(Preview({}, ()))


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        ([True], "1 pose, all kept"),
        ([True, True], "2 poses, all kept"),
        ([True, None], "2 poses"),
        ([True, False, None], "3 poses, 1 would be lost"),
    ],
)
def test_the_sequence_says_how_many_would_be_lost(verdicts: list[bool | None], expected: str) -> None:
    html = markup.sequence(verdicts, [None] * len(verdicts), 0)
    assert re.search(r'id="count"><b>([^<]*)</b>', html)[1] == expected  # type: ignore[index]


def test_every_pose_has_its_picture_its_number_and_its_verdict_in_words() -> None:
    html = markup.sequence([True, False, None], [PICTURE, PICTURE, None], 1)
    assert re.findall(r'aria-label="([^"]*)"', html) == ["pose 1, kept", "pose 2, lost", "pose 3, not looked at yet"]
    assert html.count("data:image/jpeg;base64,") == 2
    assert html.count("outline:3px") == 1


@given(st.integers(1, 100), st.data())
def test_of_many_poses_those_around_the_selected_one_are_shown(count: int, data: st.DataObject) -> None:
    selected = data.draw(st.one_of(st.none(), st.integers(0, count - 1)))
    html = markup.sequence([True] * count, [None] * count, selected)
    shown = [int(number) for number in re.findall(r'aria-label="pose (\d+)', html)]
    assert len(shown) == min(count, 16)
    assert shown == list(range(shown[0], shown[-1] + 1))
    assert selected is None or selected + 1 in shown


def test_no_pose_and_no_rating_say_so() -> None:
    assert "No pose is saved yet" in words(markup.sequence((), (), None))
    assert "Save poses" in words(markup.rating({}, ""))


def test_the_rating_is_in_millimetres_and_degrees() -> None:
    text = words(markup.rating({"eye": (0.00123, np.radians(0.056)), "far": (np.inf, 1.0), "base": (0.0, 0.0)}, ""))
    assert "1.2 mm, 0.056°" in text
    assert "not determined" in text
    assert "held fixed" in text
