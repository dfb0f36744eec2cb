"""What an image is made of; its JSON Schema is ``image.schema.json`` beside this module.

Where the fields of Rigel's plugins have their place:

=====================  ==================================================================================
``dockerfile`` plugin
=====================  ==================================================================================
compiler.name          workspace.tool
compiler.cmake_args    workspace.cmake-arguments
ros_image              base (``ros`` is the distro)
apt                    apt
docker_run             commands
env                    environment (a mapping; values are taken literally)
rosinstall             workspace.repositories
entrypoint             entrypoint (the environment is never printed)
command                command
username               user (``robot``; without sudo: containers may gain no privileges)
``application.dir``    workspace.sources
SSH provider's keys    ssh, or secrets with a ``host`` (never a build argument)
=====================  ==================================================================================

=====================  ==================================================================================
``build`` plugin
=====================  ==================================================================================
image                  name, tags
tags                   tags
force_tag_latest       tags (``latest`` is the only one by default)
buildargs              build-arguments
platforms              platforms
load, push             push; what is not pushed is on the engine
registry provider      registry
=====================  ==================================================================================
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from calibration.errors import InputError
from calibration.image.recipe.repositories import Repository, read_repositories
from calibration.image.recipe.user_text import check_line, check_text, package_name
from calibration.json_schema import bundled, check_document
from calibration.registries.credentials import RegistrySettings
from calibration.registries.reference import parse_reference
from calibration.variables import with_variables
from calibration.yaml_file import read_yaml

SCHEMA = Path(__file__).with_name("image.schema.json")
DEFAULT_NAME = "calibration-image"
"""Of an image that is not for a registry."""
DEFAULT_USER = "robot"
LABELS = "ci.calibration."
"""Our own labels begin so."""

_OF_A_DOCKERFILE = ("context", "build-arguments", "target")
_OF_A_RECIPE = (
    *("base", "ros", "apt", "pip", "environment", "files", "commands"),
    *("workspace", "entrypoint", "command", "user"),
)


@dataclass(frozen=True)
class CopiedFile:
    """A file or folder that is copied into the image."""

    source: Path
    target: str
    """Absolute; with ``/`` at the end a folder for the file."""
    owner: str | None = None


@dataclass(frozen=True)
class Workspace:
    """A ROS workspace that is built into the image."""

    tool: Literal["catkin_make", "colcon"]
    sources: tuple[Path, ...] = ()
    repositories: tuple[Repository, ...] = ()
    rosdep: bool = True
    rosdep_skip: tuple[str, ...] = ()
    cmake_arguments: Mapping[str, str] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    """Only these and what they need; all where there are none."""
    path: str = "/workspace"


@dataclass(frozen=True)
class Recipe:
    """What comes on top of a base; a Dockerfile is generated from it."""

    base: str
    ros: str | None = None
    apt: tuple[str, ...] = ()
    pip: tuple[str, ...] = ()
    requirements: tuple[Path, ...] = ()
    """Files of requirements for pip."""
    environment: Mapping[str, str] = field(default_factory=dict)
    files: tuple[CopiedFile, ...] = ()
    commands: tuple[str, ...] = ()
    workspace: Workspace | None = None
    entrypoint: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    user: str = DEFAULT_USER


@dataclass(frozen=True)
class OwnDockerfile:
    """A Dockerfile that the user wrote, as it is."""

    file: Path
    context: Path
    build_arguments: Mapping[str, str] = field(default_factory=dict)
    target: str | None = None


@dataclass(frozen=True)
class Secret:
    """What the build may read and the image must not hold; here only where it is."""

    id: str
    variable: str | None = None
    """The environment variable that holds it, or"""
    file: Path | None = None
    """the file that does."""
    host: str | None = None
    """The host whose git repositories it is the password of."""
    username: str = "x-access-token"


@dataclass(frozen=True)
class ImageSpecification:
    """An image, where it belongs and how it gets there."""

    source: Recipe | OwnDockerfile
    name: str = DEFAULT_NAME
    """Registry and repository, without a tag."""
    tags: tuple[str, ...] = ()
    """Beside the one made of the content key."""
    labels: Mapping[str, str] = field(default_factory=dict)
    secrets: tuple[Secret, ...] = ()
    ssh: bool = False
    platforms: tuple[str, ...] = ()
    """None for the engine's own."""
    registry: RegistrySettings | None = None
    push: bool = False
    promote: tuple[str, ...] = ()
    """What a green verdict brings; building does nothing with them."""


def read_image_specification(path: Path, environment: Mapping[str, str] | None = None) -> ImageSpecification:
    """Read a specification from a file of its own, or from the key ``image`` of a ``calibration.yml``.

    ``${NAME}`` in a text is replaced by the environment variable of that name. Paths are relative to
    the file.

    Raises:
        InputError: the file is missing, is no YAML, or does not follow the schema; names file and key.
    """
    document = read_yaml(path, "an image specification")
    where = str(path)
    if isinstance(document, dict) and "image" in document:
        document, where = document["image"], f"{path}: image"
    elif isinstance(document, dict) and "systems" in document:
        raise InputError(f"{path}: found no key 'image', which says what the image is made of")
    return parse_image_specification(with_variables(document, where, environment), path.parent, where)


def parse_image_specification(entry: object, folder: Path, where: str) -> ImageSpecification:
    """Make a specification of the mapping that stands in a file.

    Args:
        entry: the mapping, with variables replaced.
        folder: what paths are relative to.
        where: the file, and the key in it, for messages.

    Raises:
        InputError: it does not follow the schema, or keys exclude each other; names the key.
    """
    check_document(entry, bundled(SCHEMA), where, {})
    assert isinstance(entry, dict)  # noqa: S101 (the schema says so)
    _refuse_both_kinds(entry, where)
    name = entry.get("name", DEFAULT_NAME)
    reference = parse_reference(name)
    if reference.tag or reference.digest:
        raise InputError(f"{where}: name: found {name!r}, a name without a tag was expected: write it under tags")
    promote = tuple(entry.get("promote", ()))
    push = entry.get("push", False)
    if "name" not in entry and (push or promote):
        raise InputError(f"{where}: name is not given: a registry's image needs one, such as ghcr.io/team/robot")
    platforms = tuple(entry.get("platforms", ()))
    if len(platforms) > 1 and not push:
        raise InputError(f"{where}: platforms: an engine holds one of several platforms: add push: true, or name one")
    return ImageSpecification(
        source=_own(entry, folder, where) if "dockerfile" in entry else _recipe(entry, folder, where),
        name=reference.name,
        tags=tuple(entry.get("tags", () if promote else ("latest",))),
        labels=_labels(entry.get("labels", {}), where),
        secrets=_secrets(entry.get("secrets", ()), folder, where),
        ssh=entry.get("ssh", False),
        platforms=platforms,
        registry=_registry(entry["registry"], where) if "registry" in entry else None,
        push=push,
        promote=promote,
    )


def _own(entry: Mapping[str, Any], folder: Path, where: str) -> OwnDockerfile:
    return OwnDockerfile(
        file=folder / check_line(entry["dockerfile"], f"{where}: dockerfile"),
        context=folder / check_line(entry.get("context", "."), f"{where}: context"),
        build_arguments=_values(entry.get("build-arguments", {}), f"{where}: build-arguments"),
        target=entry.get("target"),
    )


def _recipe(entry: Mapping[str, Any], folder: Path, where: str) -> Recipe:
    ros = entry.get("ros")
    if "base" not in entry and ros is None:
        raise InputError(f"{where}: found none of base, ros and dockerfile: name the image to start from, in base")
    base = str(parse_reference(entry.get("base", f"ros:{ros}")))
    if base == "scratch":
        raise InputError(f"{where}: base: scratch has no programs to install with: name an image of Debian or Ubuntu")
    pip = [check_line(item, f"{where}: pip").strip() for item in entry.get("pip", ())]
    files = [item[2:].strip() for item in pip if item.startswith("-r")]
    packages = [item for item in pip if not item.startswith("-r")]
    for item in packages:
        if item.startswith("-"):
            raise InputError(f"{where}: pip: found the option {item!r}, expected a package or '-r FILE'")
    workspace = _workspace(entry["workspace"], folder, f"{where}: workspace") if "workspace" in entry else None
    if workspace and not entry.get("ssh", False):
        for repository in workspace.repositories:
            if repository.by_ssh:
                raise InputError(f"{where}: the repository {repository.url} is cloned by SSH: add ssh: true")
    return Recipe(
        base=base,
        ros=ros,
        apt=tuple(package_name(item, f"{where}: apt") for item in entry.get("apt", ())),
        pip=tuple(packages),
        requirements=tuple(folder / file for file in files),
        environment=_values(entry.get("environment", {}), f"{where}: environment"),
        files=tuple(_file(item, folder, f"{where}: files.{i}") for i, item in enumerate(entry.get("files", ()))),
        commands=tuple(_shell(item, f"{where}: commands.{i}") for i, item in enumerate(entry.get("commands", ()))),
        workspace=workspace,
        entrypoint=tuple(check_text(item, f"{where}: entrypoint") for item in entry.get("entrypoint", ())),
        command=_command(entry.get("command", ()), f"{where}: command"),
        user=entry.get("user", DEFAULT_USER),
    )


def _workspace(entry: Mapping[str, Any], folder: Path, where: str) -> Workspace:
    sources = [folder / check_line(item, f"{where}.sources") for item in entry.get("sources", ["."])]
    names = [source.resolve().name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{where}.sources: two folders are called {name!r}, and would be one in the workspace")
    return Workspace(
        tool=entry["tool"],
        sources=tuple(sources),
        repositories=tuple(
            repository
            for file in entry.get("repositories", ())
            for repository in read_repositories(folder / check_line(file, f"{where}.repositories"))
        ),
        rosdep=entry.get("rosdep", True),
        rosdep_skip=tuple(entry.get("rosdep-skip", ())),
        cmake_arguments=_values(entry.get("cmake-arguments", {}), f"{where}.cmake-arguments"),
        packages=tuple(entry.get("packages", ())),
        path=entry.get("path", Workspace.path),
    )


def _file(entry: Mapping[str, Any], folder: Path, where: str) -> CopiedFile:
    source = folder / check_line(entry["from"], f"{where}.from")
    return CopiedFile(source, check_line(entry["to"], f"{where}.to"), entry.get("owner"))


def _shell(text: str, where: str) -> str:
    if not text.strip():
        raise InputError(f"{where}: found a blank, a command was expected")
    return check_text(text, where)


def _command(entry: str | Iterable[str], where: str) -> tuple[str, ...]:
    if isinstance(entry, str):
        return ("/bin/bash", "-c", check_text(entry, where))
    return tuple(check_text(item, where) for item in entry)


def _secrets(entries: Iterable[Mapping[str, Any]], folder: Path, where: str) -> tuple[Secret, ...]:
    secrets: dict[str, Secret] = {}
    for entry in entries:
        name = entry["id"]
        if ("variable" in entry) == ("file" in entry):
            raise InputError(f"{where}: secrets: {name}: expected either variable or file, which say where it is")
        if name in secrets:
            raise InputError(f"{where}: secrets: the id {name!r} stands twice")
        file = folder / check_line(entry["file"], f"{where}: secrets") if "file" in entry else None
        username = entry.get("username", Secret.username)
        secrets[name] = Secret(name, entry.get("variable"), file, entry.get("host"), username)
    return tuple(secrets.values())


def _labels(entry: Mapping[str, str], where: str) -> dict[str, str]:
    for name in entry:
        if name.startswith(LABELS):
            raise InputError(f"{where}: labels: {name}: labels that begin with {LABELS} are set by build-image")
    return _values(entry, f"{where}: labels")


def _registry(entry: Mapping[str, Any], where: str) -> RegistrySettings:
    if ("username" in entry) != ("password-variable" in entry):
        raise InputError(f"{where}: registry: username and password-variable go together: found one of them")
    return RegistrySettings(**{key.replace("-", "_"): value for key, value in entry.items()})


def _values(entry: Mapping[str, Any], where: str) -> dict[str, str]:
    """Values as text: a number as it is written, a truth value as ``true`` or ``false``."""
    return {
        name: check_line(value if isinstance(value, str) else json.dumps(value), f"{where}.{name}")
        for name, value in entry.items()
    }


def _refuse_both_kinds(entry: Mapping[str, Any], where: str) -> None:
    own = "dockerfile" in entry
    for key in _OF_A_RECIPE if own else _OF_A_DOCKERFILE:
        if key in entry:
            reason = "a Dockerfile of your own says it itself" if own else "it is for a Dockerfile of your own"
            raise InputError(f"{where}: {key} {'excludes' if own else 'needs'} dockerfile: {reason}")
