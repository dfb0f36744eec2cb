"""Escaping of untrusted text in markup."""

from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.ci.pages.charts import SCALE_STEPS, Axis, ellipses, heat_map, histogram, ticks, trend
from calibration.ci.pages.figures import Cloud, Kind, Line, overlay, residual_plane, scene
from calibration.ci.pages.html import Html, element, figure, page, section, table

HOSTILE = st.one_of(
    st.text(),
    st.lists(
        st.sampled_from(
            [
                *("<script>alert(1)</script>", "</script>", "</title>", "</svg>", "<!--", "-->", "]]>", "<b", ">"),
                *('"', "'", "&lt;", "&", "onload=alert(1) ", "javascript:alert(1)", "a", " ", "\n", "\\u003c"),
            ]
        )
    ).map("".join),
)


class Elements(HTMLParser):
    """Collects the elements of a page with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def whole(name: str) -> str:
    """Return a page that contains a name in all places."""
    some = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.5]])
    parts = [
        table((name, name), ((name, name),)),
        figure(residual_plane(name, (640, 480), some[:, :2] * 100, some[:, :2]), name),
        histogram(name, some[:, 0], 0.3, "px"),
        heat_map(name, [name], [name, name], np.array([[1.0, np.nan]]), "px"),
        ellipses(name, np.eye(3), 1.0),
        overlay(name, b"a picture", (640, 480), some[:, :2], some[:, :2]),
        trend(name, [name, name], [0.0, 1.0], [0.1, 0.1], "mm"),
        scene(
            [Line(some, "camera", name)],
            name,
            {"camera": Kind("blue", name)},
            [Cloud(some, some[:, 0], name, 0)],
            [name],
        ),
    ]
    return page(name, [section(name, *parts, anchor=name)])


@given(HOSTILE)
def test_a_name_makes_no_element_and_no_attribute(name: str) -> None:
    expected, found = Elements(whole("name")).found, Elements(whole(f"x{name}")).found
    assert [(tag, sorted(attributes)) for tag, attributes in found] == [
        (tag, sorted(attributes)) for tag, attributes in expected
    ]


def test_texts_are_escaped_and_markup_is_kept() -> None:
    assert element("p", "a < b", Html("<b>c</b>"), class_="x&y", tabindex=None) == (
        '<p class="x&amp;y">a &lt; b<b>c</b></p>'
    )
    assert element("rect", x=1.23456, y=2) == '<rect x="1.23" y="2"/>'


def test_a_page_needs_nothing_from_elsewhere() -> None:
    text = whole("name")
    elements = Elements(text).found
    assert any(str(each.get("content")).startswith("default-src 'none';") for _, each in elements)
    for _, attributes in elements:
        assert not set(attributes) & {"src", "srcset", "onload", "onclick", "onerror"}
        assert (attributes.get("href") or "#").startswith(("#", "data:image/jpeg;base64,"))


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_ticks_are_round_and_inside(low: float, span: float) -> None:
    high = low + span
    found = ticks(low, high)
    assert all(low - 1e-6 * span <= tick <= high + 1e-6 * span for tick in found)
    assert len(found) <= 8
    assert np.all(np.diff(found) > 0)


def test_an_axis_puts_its_ends_at_its_ends() -> None:
    axis = Axis(-2.0, 2.0, 30.0, 430.0)
    assert [axis(-2), axis(0), axis(2)] == [30, 230, 430]
    assert Axis(1.0, 1.0, 5.0, 9.0)(1.0) == 5


def test_an_ellipse_shows_two_standard_deviations_beside_the_limit() -> None:
    drawn = Elements(ellipses("camera", np.diag([1.0, 4.0, 0.25]), 8.0)).found
    circle = float(next(each for tag, each in drawn if tag == "circle")["r"] or 0)
    first = next(each for tag, each in drawn if tag == "ellipse")
    assert [float(first[key] or 0) / circle for key in ("rx", "ry")] == pytest.approx([4 / 8, 2 / 8], abs=0.01)


def test_many_vectors_are_thinned_and_large_ones_stand_out() -> None:
    random = np.random.default_rng(1)
    pixels, values = random.uniform(0, 480, (20_000, 2)), random.normal(0, 0.1, (20_000, 2))
    values[0] = (5.0, 0.0)
    drawn = Elements(residual_plane("camera", (640, 480), pixels, values)).found
    far = next(each for tag, each in drawn if tag == "path" and each["class"] == "vector far")
    assert "M" in str(far["d"])
    usual = next(each for tag, each in drawn if tag == "path" and each["class"] == "vector")
    assert str(usual["d"]).count("M") <= 3000


def test_a_heat_map_of_thousands_shows_the_worst_of_neighbours() -> None:
    values = np.full((2, 2000), 0.1)
    values[1, 777] = 9.0
    drawn = heat_map("RMS", ["left", "right"], [f"{i:04}" for i in range(2000)], values, "px")
    assert drawn.count("<rect") <= 240 + SCALE_STEPS
    assert "collection 0765 to 0781: 9 px" in drawn
