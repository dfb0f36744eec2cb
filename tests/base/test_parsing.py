"""Untrusted YAML and JSON: no value is lost, and parsing small files stays cheap."""

import json
from pathlib import Path

import pytest
import yaml

from calibration.base import InputError, parse_json, read_yaml
from calibration.base.yaml_loading import MAX_ALIASED
from calibration.engine.dataset.document import read_json


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def bomb(levels: int) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize("text", [bomb(9), "systems: &a\n  again: *a\n", "&a [*a]"])
def test_aliases_of_aliases_are_refused(tmp_path: Path, text: str) -> None:
    path = written(tmp_path / "calibration.yml", text)
    with pytest.raises(InputError, match=rf"calibration\.yml:1: .* aliases expand to more than {MAX_ALIASED} values"):
        read_yaml(path, "a configuration")


def test_aliases_that_a_person_writes_are_read(tmp_path: Path) -> None:
    path = written(tmp_path / "a.yml", "a: &a {x: 1}\nb: {<<: *a, y: *a}\n" + bomb(4))
    document = read_yaml(path, "a configuration")
    assert isinstance(document, dict)
    assert document["b"] == {"x": 1, "y": {"x": 1}}


def test_a_long_list_without_aliases_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.base.yaml_loading.MAX_ALIASED", 50)
    path = written(tmp_path / "a.yml", json.dumps([1] * 100))
    assert read_yaml(path, "a list") == [1] * 100
    path.write_text("a: &a [1]\nb: [" + ", ".join(["*a"] * 100) + "]")
    with pytest.raises(InputError):
        read_yaml(path, "a list")


@pytest.mark.parametrize("text", ['{"a": 1, "a": 1}', '{"b": [{"a": 1, "c": 2, "a": 3}]}'])
def test_repeated_keys_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match="the key 'a' occurs twice"):
        parse_json(text)
    with pytest.raises(InputError, match=r"dataset\.json: the key 'a' occurs twice"):
        read_json(written(tmp_path / "dataset.json", text))


def test_no_number_is_refused_unless_it_is_wanted() -> None:
    with pytest.raises(ValueError, match="found NaN, a finite number was expected"):
        parse_json('{"a": NaN}')
    assert parse_json('{"a": Infinity}', finite=False) == {"a": float("inf")}


def test_the_key_is_cut_to_a_short_line() -> None:
    key = "k" * 100_000
    with pytest.raises(ValueError, match="occurs twice") as caught:
        parse_json(f'{{"{key}": 1, "{key}": 2}}')
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "value",
    [
        *("!!timestamp x", "!!timestamp 1", "!!bool x", "!!int x", "!!int ''", "!!float x", "!!null [a]"),
        *("!!binary \u20ac", "2024-13-45", "9" * 5001, "!!opencv-matrix x", "!!omap x", "!!int 9:9:z"),
    ],
)
def test_a_value_that_does_not_fit_its_tag_is_refused_with_its_line(value: str, tmp_path: Path) -> None:
    (tmp_path / "calibration.yml").write_text(f"a: 1\nb: {value}\n")
    with pytest.raises(InputError, match=r"calibration\.yml:2: this is not valid YAML: "):
        read_yaml(tmp_path / "calibration.yml", "a file")


@pytest.mark.parametrize("piece", ["[", "{a: ", "- ", "? "])
def test_depth_is_judged_while_reading(piece: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scanner that had to see all levels would take minutes of as many: here it is never asked for most of them."""
    scanned = []
    fetch = yaml.SafeLoader.fetch_more_tokens
    monkeypatch.setattr(yaml.SafeLoader, "fetch_more_tokens", lambda loader: (scanned.append(1), fetch(loader)))
    (tmp_path / "calibration.yml").write_text(piece * 100_000)
    with pytest.raises(InputError, match="nested too deeply: more than 100 levels"):
        read_yaml(tmp_path / "calibration.yml", "a file")
    assert len(scanned) < 5_000


def test_a_document_of_many_levels_is_read(tmp_path: Path) -> None:
    (tmp_path / "calibration.yml").write_text("[" * 99 + "1" + "]" * 99)
    assert str(read_yaml(tmp_path / "calibration.yml", "a file")) == "[" * 99 + "1" + "]" * 99
