import math
from typing import Any

import pytest

from calibration.base import InputError, with_variables


def test_only_braces_are_replaced_and_only_once() -> None:
    document: dict[str, Any] = {"a": ["${A}/$A/${B}", 1, 1.5, None, True], "b": {"c": "x"}}
    assert with_variables(document, "f", {"A": "${B}", "B": "2"}) == {
        "a": ["${B}/$A/2", 1, 1.5, None, True],
        "b": {"c": "x"},
    }


def test_errors_name_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOT_SET", raising=False)
    with pytest.raises(InputError, match=r"f\.yml\.a\.1: the environment variable NOT_SET is not set"):
        with_variables({"a": ["", "${NOT_SET}"]}, "f.yml")
    with pytest.raises(InputError, match=r"f\.yml\.a: found nan, a finite number"):
        with_variables({"a": math.nan}, "f.yml")
