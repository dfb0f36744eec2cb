from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.ci.image.specification import (
    CopiedFile,
    OwnDockerfile,
    Recipe,
    Secret,
    parse_image_specification,
    read_image_specification,
)
from calibration.ci.registries.reference import RegistrySettings

HERE = Path("somewhere")


def parse(**entry: Any) -> Any:
    return parse_image_specification({key.replace("_", "-"): value for key, value in entry.items()}, HERE, "f.yml")


def recipe(**entry: Any) -> Recipe:
    source = parse(**{"base": "debian", **entry}).source
    assert isinstance(source, Recipe)
    return source


def test_everything_of_a_recipe(tmp_path: Path) -> None:
    (tmp_path / "a.repos").write_text("repositories: {r: {type: git, url: 'https://h/r.git', version: '1'}}")
    (tmp_path / "image.yml").write_text(
        """
name: ghcr.io/team/robot
tags: [edge]
base: debian:bookworm
ros: noetic
apt: [curl, "libc6:amd64=2.36-9+deb12u4"]
pip: [numpy>=1, -r req.txt]
environment: {A: 1, B: true, C: x}
files: [{from: f, to: /opt/, owner: "1:2"}]
commands: ["make  "]
workspace:
  tool: colcon
  sources: [src]
  repositories: [a.repos]
  rosdep: false
  rosdep-skip: [gazebo]
  cmake-arguments: {X: 1.5}
  packages: [p]
  path: /ws
entrypoint: [export A=2]
command: run --fast
user: me
labels: {team: a}
secrets: [{id: a, variable: A_TOKEN, host: github.com, username: u}, {id: b, file: key}]
ssh: true
platforms: [linux/amd64, linux/arm64]
registry: {username: u, password-variable: P, create-repository: true}
push: true
promote: [stable]
"""
    )
    found = read_image_specification(tmp_path / "image.yml", {})
    assert (found.name, found.tags, found.push, found.promote) == ("ghcr.io/team/robot", ("edge",), True, ("stable",))
    assert found.registry == RegistrySettings("u", "P", create_repository=True)
    assert found.secrets == (
        Secret("a", variable="A_TOKEN", host="github.com", username="u"),
        Secret("b", file=tmp_path / "key"),
    )
    assert (found.ssh, found.platforms, found.labels) == (True, ("linux/amd64", "linux/arm64"), {"team": "a"})
    source = found.source
    assert isinstance(source, Recipe)
    assert source.apt == ("curl", "libc6:amd64=2.36-9+deb12u4")
    assert (source.pip, source.requirements) == (("numpy>=1",), (tmp_path / "req.txt",))
    assert source.environment == {"A": "1", "B": "true", "C": "x"}
    assert source.files == (CopiedFile(tmp_path / "f", "/opt/", "1:2"),)
    assert source.command == ("/bin/bash", "-c", "run --fast")
    workspace = source.workspace
    assert workspace is not None
    assert (workspace.tool, workspace.sources, workspace.path) == ("colcon", (tmp_path / "src",), "/ws")
    assert [repository.url for repository in workspace.repositories] == ["https://h/r.git"]
    assert (workspace.rosdep, workspace.rosdep_skip, workspace.cmake_arguments) == (False, ("gazebo",), {"X": "1.5"})


def test_a_dockerfile_of_ones_own() -> None:
    found = parse(dockerfile="docker/Dockerfile", context="..", build_arguments={"A": 1}, target="run")
    assert found.source == OwnDockerfile(HERE / "docker/Dockerfile", HERE / "..", {"A": "1"}, "run")
    assert (found.name, found.tags) == ("calibration-image", ("latest",))


def test_a_ros_distribution_alone_is_its_image() -> None:
    assert parse(ros="humble").source.base == "ros:humble"


def test_tags_are_left_to_the_verdict_where_there_is_promote() -> None:
    assert parse(base="debian", name="a/b", push=True, promote=["stable"]).tags == ()


def test_the_key_image_of_a_pipeline_with_variables(tmp_path: Path) -> None:
    file = tmp_path / "calibration.yml"
    file.write_text("systems: {}\nimage: {base: debian, name: '${REGISTRY}/robot'}")
    assert read_image_specification(file, {"REGISTRY": "127.0.0.1:5000"}).name == "127.0.0.1:5000/robot"
    with pytest.raises(InputError, match=r"calibration.yml: image.name: the environment variable REGISTRY is not set"):
        read_image_specification(file, {})
    file.write_text("systems: {}")
    with pytest.raises(InputError, match="found no key 'image'"):
        read_image_specification(file)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({}, "f.yml: found none of base, ros and dockerfile"),
        ({"bass": "debian"}, "f.yml: unknown key 'bass': did you mean 'base'"),
        ({"base": "debian", "dockerfile": "D"}, "f.yml: base excludes dockerfile"),
        ({"base": "debian", "target": "x"}, "f.yml: target needs dockerfile"),
        ({"base": "scratch"}, "f.yml: base: scratch has no programs"),
        ({"base": "Debian:"}, "image 'Debian:'"),
        ({"base": "debian\nRUN evil"}, "no repository"),
        ({"base": "debian", "name": "a:1"}, "f.yml: name: found 'a:1', a name without a tag"),
        ({"base": "debian", "push": True}, "f.yml: name is not given"),
        ({"base": "debian", "platforms": ["linux/amd64", "linux/arm64"]}, "f.yml: platforms: an engine holds one"),
        ({"base": "debian", "attest": True}, "f.yml: attest: what BuildKit says of an image is kept in its registry"),
        ({"base": "debian", "apt": ["curl; rm -rf /"]}, "f.yml: apt.0: found 'curl; rm -rf /'"),
        ({"base": "debian", "apt": ["--force-yes"]}, "f.yml: apt.0: found '--force-yes'"),
        ({"base": "debian", "apt": ["curl\n"]}, "f.yml: apt.0: found"),
        ({"base": "debian", "pip": ["--index-url=http://evil"]}, "f.yml: pip.0: found the option"),
        ({"base": "debian", "pip": ["a\nRUN evil"]}, "f.yml: pip.0: found more than one line"),
        ({"base": "debian", "environment": {"A": "a\nRUN evil"}}, "f.yml: environment.A: found more than one line"),
        ({"base": "debian", "environment": {"A B": "1"}}, "f.yml: environment"),
        ({"base": "debian", "environment": {"A": "\x1b[31m"}}, "control character U\\+001B"),
        ({"base": "debian", "labels": {"a": "b\nc"}}, "f.yml: labels.a: found more than one line"),
        ({"base": "debian", "labels": {"ci.calibration.key": "x"}}, "are set by build-image"),
        ({"base": "debian", "commands": ["  "]}, "f.yml: commands.0: found a blank"),
        ({"base": "debian", "commands": ["a\0b"]}, "control character"),
        ({"base": "debian", "commands": ["\ud800"]}, "control character U\\+D800"),
        ({"base": "debian", "files": [{"from": "a", "to": "relative"}]}, "f.yml: files.0.to"),
        ({"base": "debian", "user": "root; evil"}, "f.yml: user"),
        ({"base": "debian", "workspace": {"tool": "make"}}, "f.yml: workspace.tool"),
        (
            {"base": "debian", "workspace": {"tool": "colcon", "sources": ["a", "b/a"]}},
            "two folders have the same name 'a'",
        ),
        ({"base": "debian", "secrets": [{"id": "a"}]}, "secrets.0: a: expected either variable or file"),
        ({"base": "debian", "secrets": [{"id": "a", "variable": "B", "file": "c"}]}, "either variable or file"),
        (
            {"base": "debian", "secrets": [{"id": "a", "variable": "B"}, {"id": "a", "variable": "C"}]},
            "the id 'a' occurs twice",
        ),
        ({"base": "debian", "registry": {"username": "a"}}, "username and password-variable go together"),
        ({"base": "debian", "registry": {"username": "a", "password": "hunter2"}}, "unknown key 'password'"),
        (["base"], "f.yml: found a list of 1, expected keys: base"),
    ],
)
def test_errors_name_the_key(entry: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        parse_image_specification(entry, HERE, "f.yml")
    assert str(error.value).isprintable()


def test_repositories_by_ssh_need_an_agent(tmp_path: Path) -> None:
    (tmp_path / "a.repos").write_text("repositories: {r: {type: git, url: 'git@github.com:team/r.git'}}")
    entry = {"base": "debian", "workspace": {"tool": "colcon", "repositories": ["a.repos"]}}
    with pytest.raises(InputError, match="is cloned by SSH: add ssh: true"):
        parse_image_specification(entry, tmp_path, "f.yml")
    assert parse_image_specification({**entry, "ssh": True}, tmp_path, "f.yml").ssh


def test_nothing_secret_in_a_repr() -> None:
    text = repr(parse(base="debian", secrets=[{"id": "a", "variable": "TOKEN"}]))
    assert "TOKEN" in text  # the name of the variable, not its value


VALID: dict[str, Any] = {
    "name": "a/b",
    "base": "debian",
    "ros": "noetic",
    "apt": ["a"],
    "pip": ["a"],
    "environment": {"A": "1"},
    "files": [{"from": "a", "to": "/b"}],
    "commands": ["a"],
    "workspace": {"tool": "colcon", "cmake-arguments": {"A": 1}},
    "entrypoint": ["a"],
    "command": ["a"],
    "user": "robot",
    "labels": {"a": "b"},
    "secrets": [{"id": "a", "variable": "A"}],
    "registry": {"username": "a", "password-variable": "B"},
    "promote": ["a"],
}
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@given(key=st.sampled_from(sorted(VALID)), value=ANYTHING)
def test_no_value_of_a_key_causes_a_traceback(key: str, value: Any) -> None:
    try:
        parse_image_specification({**VALID, key: value}, HERE, "f.yml")
    except InputError as error:
        assert str(error).isprintable()  # noqa: PT017


def test_a_hostile_file_is_only_data(tmp_path: Path) -> None:
    file = tmp_path / "image.yml"
    file.write_text(yaml.safe_dump(VALID) + "user: !!python/object/apply:os.system ['false']")
    with pytest.raises(InputError, match="not valid YAML"):
        read_image_specification(file)
