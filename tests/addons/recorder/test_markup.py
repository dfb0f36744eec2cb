import re

import numpy as np
import pytest
from defusedxml.ElementTree import fromstring
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.recorder.panels import finding_html, message_html, rating_html, sequence_html, verdict_html
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
        verdict_html(Preview({}, (text,))),
        finding_html(text, view),
        message_html(text),
        rating_html({text: (0.001, 0.002)}, ""),
        rating_html({}, text or "none"),
    ):
        assert text in words(html)


def test_the_verdict_says_kept_or_lost_and_why() -> None:
    assert "Kept" in words(verdict_html(Preview({}, ())))
    lost = words(verdict_html(Preview({}, ("left: nothing", "right: hidden"))))
    assert all(part in lost for part in ("Lost", "left: nothing", "right: hidden"))
    assert "Kept" not in words(verdict_html(None))
    assert 'aria-busy="true"' in verdict_html(Preview({}, ()), is_old=True)
    assert 'aria-busy="false"' in verdict_html(Preview({}, ()))


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
    html = sequence_html(verdicts, [None] * len(verdicts), 0)
    assert re.search(r'id="count"><b>([^<]*)</b>', html)[1] == expected  # type: ignore[index]


def test_every_pose_has_its_picture_its_number_and_its_verdict_in_words() -> None:
    html = sequence_html([True, False, None], [PICTURE, PICTURE, None], 1)
    assert re.findall(r'aria-label="([^"]*)"', html) == ["pose 1, kept", "pose 2, lost", "pose 3, not looked at yet"]
    assert html.count("data:image/jpeg;base64,") == 2
    assert html.count("outline:3px") == 1


@given(st.integers(1, 100), st.data())
def test_of_many_poses_those_around_the_selected_one_are_shown(count: int, data: st.DataObject) -> None:
    selected = data.draw(st.one_of(st.none(), st.integers(0, count - 1)))
    html = sequence_html([True] * count, [None] * count, selected)
    shown = [int(number) for number in re.findall(r'aria-label="pose (\d+)', html)]
    assert len(shown) == min(count, 16)
    assert shown == list(range(shown[0], shown[-1] + 1))
    assert selected is None or selected + 1 in shown


def test_no_pose_and_no_rating_say_so() -> None:
    assert "No pose is saved yet" in words(sequence_html((), (), None))
    assert "Save poses" in words(rating_html({}, ""))


def test_the_rating_is_in_millimetres_and_degrees() -> None:
    text = words(rating_html({"eye": (0.00123, np.radians(0.056)), "far": (np.inf, 1.0), "base": (0.0, 0.0)}, ""))
    assert "1.2 mm, 0.056°" in text
    assert "not determined" in text
    assert "held fixed" in text
