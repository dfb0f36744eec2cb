"""Malicious and malformed Rigelfiles."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration.addons.rigel.conversion import Conversion, convert, written
from calibration.addons.rigel.document import read_rigelfile
from calibration.base import InputError

FOLDER = Path(__file__).with_name("rigelfiles")
Converted = Callable[[str], Conversion]
LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("jobs: !!python/object/apply:os.system [touch HARM]", "could not determine a constructor"),
        ("jobs: !!python/object/new:os.system [touch HARM]", "could not determine a constructor"),
        ("jobs: !!python/name:os.system", "could not determine a constructor"),
        ("jobs: !!python/module:os", "could not determine a constructor"),
        ("jobs: {a: {plugin: x, with: {v: !!python/tuple {a: b}}}}", "this is not valid YAML"),
        ("jobs: !Custom x", "could not determine a constructor"),
        (f"jobs: {{}}\n{LAUGHS}", "more than 100000 values"),
        ("jobs: &a {x: *a}", "aliases expand to more than"),
        ("jobs: " + "[" * 60 + "]" * 60, "nested more than 40 deep"),
        ("jobs: " + "{a: " * 60 + "1" + "}" * 60, "nested more than 40 deep"),
        ("[" * 100_000, "nested too deeply"),
        ("jobs: {}\n#" + "x" * 10_000_000, "at most 1048576 was expected"),
        (
            "vars: {" + ", ".join(f"v{n}: '{{{{ vars.v{n + 1} }}}}{{{{ vars.v{n + 1} }}}}'" for n in range(30))
            + ", v30: x}\njobs: {a: {plugin: '{{ vars.v0 }}'}}",
            "its variables make",
        ),
        (
            "vars: {" + ", ".join(f"v{n}: ['{{{{ vars.v{n + 1} }}}}', '{{{{ vars.v{n + 1} }}}}']" for n in range(20))
            + ", v20: x}\njobs: {a: {plugin: x, with: {f: '{{ vars.v0 }}'}}}",
            "its variables make more than 100000 values",
        ),
    ],
)  # fmt: skip
def test_is_refused_in_one_line(
    converted: Converted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        converted(text)
    assert message in str(caught.value)
    assert str(caught.value).isprintable()
    assert not (tmp_path / "HARM").exists()


def test_the_environment_is_not_read(converted: Converted, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HARMLESS", "pl4nted")
    conversion = converted("jobs: {b: {plugin: x.BuildXPlugin, with: {image: '{{ vars.HARMLESS }}/x'}}}")
    assert conversion.image["name"] == "${HARMLESS}/x"


def test_a_secret_in_a_second_place_is_taken_out_too(converted: Converted) -> None:
    text = """
vars: {innocent: pl4nted-password}
providers: {p: {provider: x.ContainerRegistryProvider, with: {username: u, password: '{{ vars.innocent }}'}}}
jobs:
  b: {plugin: x.BuildXPlugin, with: {image: lab/robot, push: true}}
  c: {plugin: x.ComposePlugin, with: {components: [{name: c, command: [login, pl4nted-password], artifacts: [/t.csv]}]}}
  d: {plugin: x.Unknown, with: {password: {deeper: [pl4nted-other]}, url: 'https://me:pl4nted@host/x'}}
  e: {plugin: x.pl4nted-password}
"""
    conversion = converted(text)
    assert "pl4nted" not in written(conversion, "Rigelfile")
    assert "pl4nted" not in str(list(conversion.notes)).replace("x.pl4nted-password", "")
    assert "pl4nted" not in repr(conversion.image)


def test_comments_hold_nothing_but_comments(converted: Converted) -> None:
    evil = '"a\\nsystems: {x: 1}\\r\\x85- \\u2028y": {plugin: "x\\nb: 1", with: {}}'
    text = f"jobs:\n  {evil}\n  b: {{plugin: BuildXPlugin, with: {{image: c}}}}\n"
    document = yaml.safe_load(written(converted(text), "R\nsystems: 3"))
    assert set(document) == {"image"}


@pytest.mark.parametrize(
    "text",
    [
        "a\nb",
        "a \nb",
        "\na",
        "a\n",
        "\ta\nb",
        "\u2028",
        "\x85",
        "\x07\nb",
        "- a",
        "# a",
        "a: b",
        "'",
        '"',
        "~",
        "1",
        "@",
    ],
)
def test_any_text_comes_back_as_it_was(converted: Converted, text: str) -> None:
    fields = {"components": [{"name": "c", "command": ["bash", "-c", text], "artifacts": ["/t.csv"]}]}
    document = {"jobs": {"c": {"plugin": "ComposePlugin", "with": fields}}}
    result = yaml.safe_load(written(converted(yaml.safe_dump(document)), "Rigelfile"))
    assert result["systems"]["c"]["software"]["command"] == ["bash", "-c", text]


DOCUMENTS = {name: yaml.safe_load((FOLDER / f"{name}.rigel").read_text().replace("!!python/tuple", "")) for name in
             ("matrix", "older", "robomaker", "simulation-job")}  # fmt: skip
scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20)
scalars |= st.sampled_from(
    [
        "{{ vars.distro }}",
        "{{ data.trans_noise }}",
        "{{ x }}",
        "",
        "build",
        "${X}",
        "{",
        "a:b:c",
        "-----BEGIN PRIVATE KEY-----",
    ]
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


def places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all values of a document."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [path, *(place for key, value in items for place in places(value, (*path, key)))]


@st.composite
def mutated(draw: st.DrawFn) -> Any:
    """One of our Rigelfiles with a few values in the place of others."""
    document = {"root": copy.deepcopy(DOCUMENTS[draw(st.sampled_from(sorted(DOCUMENTS)))])}
    for _ in range(draw(st.integers(1, 3))):
        *path, last = draw(st.sampled_from([place for place in places(document) if place]))
        node: Any = document
        for key in path:
            node = node[key]
        if draw(st.booleans()) and isinstance(node, dict):
            node[draw(st.text(max_size=8))] = node.pop(last)
        else:
            node[last] = draw(values)
    return document.get("root")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(mutated())
def test_any_other_document_is_converted_or_refused_in_one_line(tmp_path: Path, document: Any) -> None:
    path = tmp_path / "Rigelfile"
    path.write_text(yaml.safe_dump(document, allow_unicode=True), errors="surrogatepass")
    try:
        text = written(convert(read_rigelfile(path)), "Rigelfile")
    except InputError as error:
        refusal: str | None = str(error)
    else:
        refusal = None
        loaded = yaml.safe_load(text)
        assert loaded is None or set(loaded) <= {"image", "noise", "systems", "simulation", "aws-batch", "requirements"}
    assert refusal is None or (refusal.startswith(str(path)) and refusal.isprintable())
