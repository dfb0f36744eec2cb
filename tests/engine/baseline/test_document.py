"""The file of accepted calibrations: what is written can be read, and nothing else is taken for it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calibration.base import InfrastructureError, InputError
from calibration.engine.baseline.document import (
    MAX_BASELINE_BYTES,
    Baseline,
    baseline_text,
    parse_baseline,
    read_baseline,
    write_baseline,
)
from tests.engine.baseline.scenes import stereo, taken


@pytest.fixture(scope="module")
def text() -> str:
    return baseline_text(Baseline(1, {"b": taken(stereo()), "a": taken(stereo(2))}))


def test_systems_are_sorted_and_short_lists_are_on_one_line(text: str) -> None:
    assert list(json.loads(text)["systems"]) == ["a", "b"]
    assert any('"xyz-mm": [' in line and line.endswith("],") for line in text.splitlines())


def pose(document: dict[str, Any]) -> dict[str, Any]:
    return next(each for each in document["systems"]["a"]["poses"] if "sigma-mm" in each)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d.update(version=2), "version: found 2, this program knows 1: a newer one has written it; update"),
        (lambda d: d.pop("systems"), "missing key 'systems'"),
        (lambda d: pose(d).update({"xyz-mm": [1, 2]}), "systems.a.poses"),
        (lambda d: pose(d).update({"xyz-mm": ["1", 2, 3]}), "systems.a.poses"),
        (lambda d: pose(d).update({"own-mm": [-1, 1, 1]}), "systems.a.poses"),
        (lambda d: pose(d).update({"correlations": [0.1] * 14}), "found 14 numbers, expected 15"),
        (lambda d: pose(d).update({"correlations": [0.99, -0.99, 0.99] + [0.0] * 12}), "a variance would be negative"),
        (lambda d: pose(d).pop("correlations"), "expected own-mm, own-deg and correlations, or none of them"),
        (lambda d: pose(d).update({"xyz_mm": [1, 2, 3]}), "xyz_mm"),
        (lambda d: d["systems"]["a"].update(data="0123"), "64 hexadecimal digits"),
        (lambda d: d["systems"]["a"].update({"rejected-labels": -1}), "rejected-labels"),
    ],
)
def test_what_was_edited_into_nonsense_is_refused_with_its_place(
    text: str, change: Callable[[dict[str, Any]], object], expected: str
) -> None:
    document = json.loads(text)
    change(document)
    with pytest.raises(InputError) as error:
        parse_baseline(json.dumps(document).encode(), "file.json")
    assert str(error.value).startswith("file.json: ")
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "this is not a baseline"),
        (b"[]", "found an empty list"),
        (b"\xff\xfe", "this is not a baseline"),
        (b'{"version": 1, "systems": {"a": {"rms-px": NaN}}}', "found NaN, a finite number was expected"),
        (b'{"version": 1, "version": 1, "systems": {}}', "occurs twice"),
        (b"[" * 100_000, "this is not a baseline"),
        (b'<<<<<<< HEAD\n{"version": 1}\n=======\n', "merge conflict"),
        (b" " * (MAX_BASELINE_BYTES + 1), "a baseline has at most"),
    ],
    ids=range(8),
)
def test_what_is_no_baseline_is_refused_in_one_line(content: bytes, expected: str) -> None:
    with pytest.raises(InputError, match=expected) as error:
        parse_baseline(content, "file.json")
    assert "\n" not in str(error.value)


def test_a_link_is_neither_read_nor_replaced(tmp_path: Path, text: str) -> None:
    target, link = tmp_path / "target.json", tmp_path / "link.json"
    target.write_text(text)
    link.symlink_to(target)
    with pytest.raises(InputError, match="symbolic link"):
        read_baseline(link)
    with pytest.raises(InputError, match="no regular file"):
        write_baseline(link, parse_baseline(text.encode(), "file"))
    assert read_baseline(tmp_path / "none.json") is None


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "baseline.json"
    path.write_text(text)
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "no space")))
    with pytest.raises(InfrastructureError, match="no space"):
        write_baseline(path, Baseline(1, {}))
    assert path.read_text() == text
    assert list(tmp_path.iterdir()) == [path]
