import base64
import json
from urllib.parse import quote

import pytest

from calibration.base.text import derived_forms, redact
from calibration.ci.workflow import Runner, add_mask
from tests.ci.workflow.conftest import complained, printed

HIDDEN = 'p/a+s&s"w\\ö'


@pytest.mark.parametrize(
    "form",
    [
        HIDDEN,
        json.dumps(HIDDEN)[1:-1],
        quote(HIDDEN, safe=""),
        quote(HIDDEN),
        base64.b64encode(HIDDEN.encode()).decode(),
        base64.b64encode(HIDDEN.encode()).decode().rstrip("="),
        base64.urlsafe_b64encode(HIDDEN.encode()).decode(),
    ],
)
def test_a_secret_is_hidden_in_every_form(github: Runner, form: str) -> None:
    assert redact(f"token={form};", [HIDDEN]) == "token=***;"
    add_mask(github, HIDDEN)
    masked = [line.removeprefix("::add-mask::").replace("%25", "%") for line in printed(github).splitlines()]
    assert form in masked


def test_each_line_of_a_key_is_masked_but_not_its_braces(github: Runner) -> None:
    add_mask(github, "{\n  first-line\n  second-line\n}\n")
    lines = printed(github).splitlines()
    assert "::add-mask::first-line" in lines
    assert "::add-mask::second-line" in lines
    assert "::add-mask::{" not in lines


def test_a_short_secret_is_masked_as_a_whole() -> None:
    assert "abc" in derived_forms("abc")


def test_an_empty_secret_hides_nothing(github: Runner) -> None:
    add_mask(github, "")
    add_mask(github, " \n")
    assert printed(github) == ""
    assert redact("text", ["", " "]) == "text"


def test_the_longest_form_is_replaced_first() -> None:
    assert redact("abcdef", ["abcd", "abcdef"]) == "***"


def test_off_github_the_secret_is_not_printed(laptop: Runner) -> None:
    add_mask(laptop, HIDDEN)
    assert printed(laptop) + complained(laptop) == ""
