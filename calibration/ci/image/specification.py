"""Specification of an image.

Correspondence to the fields of Rigel's plugins:

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

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Literal, cast

from calibration.base import InputError, read_yaml, with_variables
from calibration.base.records import (
    UNIQUE,
    Converted,
    Misfit,
    Place,
    field,
    flat_fields,
    length,
    matching,
    read,
    record,
)
from calibration.ci.image.repositories import Repository, check_line, check_text, package_name, read_repositories
from calibration.ci.registries.reference import Reference, RegistrySettings, VariableName, parse_reference

DEFAULT_NAME = "calibration-image"
"""Name of images that are not for a registry."""
OWN_LABEL_PREFIX = "ci.calibration."
"""Prefix of our own labels."""


def _checked_text(check: Callable[[str, str], str], least: int = 0) -> Converted:
    """Convert a text by a check of `user_text`."""
    return Converted(Annotated[str, length(least)] if least else str, lambda text, place: check(text, str(place)))


def _pip_item(text: str, place: Place) -> str | Path:
    item = check_line(text, str(place)).strip()
    if item.startswith("-r"):
        return place.folder / item[2:].strip()
    if item.startswith("-"):
        raise place.fault(f"found the option {item!r}, expected a package or '-r FILE'")
    return item


def _check_command(text: str, place: Place) -> str:
    if not text.strip():
        raise place.fault("found a blank, a command was expected")
    return check_text(text, str(place))


def _entrypoint_words(entry: str | tuple[str, ...], place: Place) -> tuple[str, ...]:
    words = ("/bin/bash", "-c", entry) if isinstance(entry, str) else entry
    return tuple(check_text(word, str(place)) for word in words)


def _parse_image(text: str, place: Place) -> Reference:
    try:
        return parse_reference(text)
    except InputError as error:
        raise place.fault(str(error)) from None


def _parse_name(text: str, place: Place) -> str:
    reference = _parse_image(text, place)
    if reference.tag or reference.digest:
        raise place.fault(f"found {text!r}, a name without a tag was expected: write it under tags")
    return reference.name


def _parse_base(text: str, place: Place) -> str:
    if (base := str(_parse_image(text, place))) == "scratch":
        raise place.fault("scratch has no programs to install with: name an image of Debian or Ubuntu")
    return base


def _label_text(value: object, place: Place) -> str:
    """Convert a value to text: numbers as written, booleans as ``true`` or ``false``."""
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else str(value)
    return check_line(text, str(place))


Line = Annotated[str, _checked_text(check_line)]
File = Annotated[Path, Converted(Annotated[Line, length(1)], lambda text, place: place.folder / text)]
"""A path, relative to the file that names it."""
Value = Annotated[str, Converted(str | bool | int | float, _label_text)]
Tag = Annotated[str, matching("[A-Za-z0-9_][A-Za-z0-9_.-]{0,127}", "a tag: letters, digits and _ . -")]
Stage = Annotated[str, matching("[A-Za-z0-9][A-Za-z0-9_.-]*", "a name: letters, digits and _ . -")]
Distro = Annotated[str, matching("[a-z][a-z0-9]*", "the name of a distribution such as noetic")]
Owner = Annotated[str, matching("[A-Za-z0-9_][A-Za-z0-9_.-]*(:[A-Za-z0-9_][A-Za-z0-9_.-]*)?", "a user, or user:group")]
User = Annotated[str, matching("[a-z_][a-z0-9_-]{0,31}", "the name of a user")]
RosdepKey = Annotated[str, matching("[A-Za-z0-9_][A-Za-z0-9_.+-]*", "a key of rosdep")]
RosPackage = Annotated[str, matching("[A-Za-z0-9_][A-Za-z0-9_-]*", "the name of a ROS package")]
Absolute = Annotated[Line, matching("/.*", "an absolute path")]
PathInImage = Annotated[str, matching("(/[A-Za-z0-9_.-]+)+", "an absolute path of letters, digits and _ . -")]
Platform = Annotated[str, matching("[a-z0-9]+/[a-z0-9_]+(/[a-z0-9]+)?", "a platform such as linux/arm64")]
Host = Annotated[
    str, matching("[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?(:[0-9]{1,5})?", "the name of a host such as github.com")
]
Label = Annotated[
    str,
    matching(
        rf"(?!{re.escape(OWN_LABEL_PREFIX)})[A-Za-z0-9]([A-Za-z0-9._/-]*[A-Za-z0-9])?",
        f"letters, digits and . _ / -, not {OWN_LABEL_PREFIX} at its start: these are set by build-image",
    ),
]


@record
class CopiedFile:
    """A file or folder that is copied into the image."""

    source: File = field("A file, or a folder whose contents are copied, relative to this file.", key="from")
    target: Absolute = field("Absolute; with / at the end a folder for the file.", key="to")
    owner: Owner | None = field("User, or user:group (root).", default=None)


@record
class Workspace:
    """A ROS workspace that is built into the image."""

    tool: Literal["catkin_make", "colcon"] = field("Build tool.")
    sources: Annotated[tuple[File, ...], length(1), UNIQUE] = field(
        "Folders with packages, each copied to src/<its name>; .dockerignore in them applies, .git is excluded (the "
        "folder of this file).",
        implied=["."],
    )
    repositories: Annotated[
        tuple[Repository, ...],
        Converted(
            Annotated[tuple[File, ...], UNIQUE],
            lambda files, _: tuple(repository for file in files for repository in read_repositories(file)),
        ),
    ] = field(
        ".repos or .rosinstall files of git repositories to clone into src. Pin commits: new commits on a branch cause "
        "no new build.",
        default=(),
    )
    rosdep: bool = field("Whether rosdep installs the dependencies in the package.xml files.", default=True)
    rosdep_skip: tuple[RosdepKey, ...] = field("Keys that rosdep skips.", default=())
    cmake_arguments: Mapping[VariableName, Value] = field(
        "Options -D of CMake: {CMAKE_BUILD_TYPE: Release}.", default_factory=dict
    )
    packages: Annotated[tuple[RosPackage, ...], length(1)] = field(
        "Build only these packages and what they need.", default=()
    )
    path: PathInImage = field("Path in the image.", default="/workspace")

    def __post_init__(self) -> None:
        """Refuse two folders with the same name."""
        names = [source.resolve().name for source in self.sources]
        if twice := [name for name in names if names.count(name) > 1]:
            raise Misfit(f"two folders have the same name {twice[0]!r} in the workspace", "sources")


@record
class Recipe:
    """Additions to a base image, from which a Dockerfile is generated."""

    base: Annotated[str, Converted(Annotated[str, length(1)], _parse_base)] = field(
        "Base image, of Debian or Ubuntu; by default ros:<distro> if ros is given.", default=""
    )
    ros: Distro | None = field("A ROS distribution in /opt/ros that is sourced: noetic, humble, ...", default=None)
    apt: tuple[Annotated[str, _checked_text(package_name, 1)], ...] = field(
        "Debian packages, optionally with =version.", default=()
    )
    pip_items: tuple[Annotated[str | Path, Converted(Annotated[str, length(1)], _pip_item)], ...] = field(
        "Python packages as pip takes them; '-r FILE' for a file of requirements.", key="pip", default=()
    )
    environment: Mapping[VariableName, Value] = field(
        "Variables of the image, taken literally ($ too). They can be read in the image: never a secret.",
        default_factory=dict,
    )
    files: tuple[CopiedFile, ...] = field("Files and folders to copy, before the commands.", default=())
    commands: tuple[Annotated[str, Converted(str, _check_command)], ...] = field(
        "Shell (bash) commands, a step each, run by root before the workspace is built.", default=()
    )
    underlays: tuple[Workspace, ...] = field(
        "Workspaces that are built before, each in layers of its own, and sourced by those after it.", default=()
    )
    workspace: Workspace | None = field("A ROS workspace that is built into the image.", default=None)
    entrypoint: tuple[Annotated[str, _checked_text(check_text)], ...] = field(
        "Lines of shell for the start of a container, after ROS and the workspace are sourced.", default=()
    )
    command: Annotated[
        tuple[str, ...],
        Converted(Annotated[str, length(1)] | Annotated[tuple[str, ...], length(1)], _entrypoint_words),
    ] = field("Default command of a container: arguments, or a line for the shell.", default=())
    user: User = field("User that runs containers; created if the base does not have it.", default="robot")

    def __post_init__(self) -> None:
        """Set the default base: the image of the ROS distribution; refuse two workspaces in one folder."""
        if not self.base:
            if self.ros is None:
                raise Misfit("found none of base, ros and dockerfile: name the image to start from, in base")
            object.__setattr__(self, "base", str(parse_reference(f"ros:{self.ros}")))
        paths = [workspace.path for workspace in self.workspaces.values()]
        if twice := [path for path in paths if paths.count(path) > 1]:
            raise Misfit(f"two workspaces have the same path {twice[0]}: give each underlay a path", "underlays")

    @property
    def workspaces(self) -> Mapping[str, Workspace]:
        """All workspaces in the order in which they are built, by the prefix of their files in the build context."""
        underlays = {f"underlay-{number}/": underlay for number, underlay in enumerate(self.underlays)}
        return underlays if self.workspace is None else {**underlays, "": self.workspace}

    @property
    def repositories(self) -> tuple[Repository, ...]:
        """Repositories of all workspaces."""
        return tuple(each for workspace in self.workspaces.values() for each in workspace.repositories)

    @property
    def pip(self) -> tuple[str, ...]:
        """Packages for pip, by name."""
        return tuple(item for item in self.pip_items if isinstance(item, str))

    @property
    def requirements(self) -> tuple[Path, ...]:
        """Requirements files for pip."""
        return tuple(item for item in self.pip_items if isinstance(item, Path))


@record
class OwnDockerfile:
    """A Dockerfile of the user."""

    file: File = field(
        "Your own Dockerfile, relative to this file, instead of base and the keys of a recipe.",
        key="dockerfile",
    )
    context: File = field(
        "Build context of your Dockerfile; its .dockerignore applies (this file's folder).", implied="."
    )
    build_arguments: Mapping[VariableName, Value] = field(
        "Values for ARG in your Dockerfile. They can be read in the image: never a secret.", default_factory=dict
    )
    target: Stage | None = field("The stage of your Dockerfile to build (the last).", default=None)


@record
class Secret:
    """A secret for the build that must not reach the image; contains only its source."""

    id: Stage = field("Name: the build reads it in /run/secrets/<id>.")
    variable: VariableName | None = field("Environment variable that contains it.", default=None)
    file: File | None = field("File that contains it.", default=None)
    host: Host | None = field("Host of git repositories for which it is the password: github.com.", default=None)
    username: Annotated[str, matching("[A-Za-z0-9_.@+-]+", "the name of a user")] = field(
        "User name on this host.", default="x-access-token"
    )

    def __post_init__(self) -> None:
        """Require exactly one source of the secret."""
        if (self.variable is None) == (self.file is None):
            raise Misfit(f"{self.id}: expected either variable or file")


@record
class ImageSpecification:
    """An image, its registry, and how it is built."""

    source: Recipe | OwnDockerfile
    name: Annotated[str, Converted(Annotated[str, length(1)], _parse_name)] = field(
        "Name of the image with its registry, without a tag: ghcr.io/team/robot. Required to push.",
        default=DEFAULT_NAME,
    )
    tags: Annotated[tuple[Tag, ...], UNIQUE] = field(
        "Tags beside the content key (latest; none if promote is given).",
        default=None,
    )
    labels: Mapping[Label, Line] = field("Labels of the image.", default_factory=dict)
    secrets: tuple[Secret, ...] = field(
        "Secrets that the build may read in /run/secrets/<id> and that never reach a layer (BuildKit). A generated "
        "Dockerfile gives them to pip, to the commands and to git.",
        default=(),
    )
    ssh: bool = field(
        "Whether the build may use your SSH agent (SSH_AUTH_SOCK) for private repositories (BuildKit).", default=False
    )
    platforms: Annotated[tuple[Platform, ...], UNIQUE] = field(
        "linux/amd64, linux/arm64, ... (the engine's own). Several need buildx, and push.", default=()
    )
    registry: RegistrySettings | None = field("Login to the registry; by default that of `docker login`.", default=None)
    push: bool = field("Whether the image goes to its registry.", default=False)
    attest: bool = field(
        "Whether BuildKit attests the image that is pushed: what is in it (SBOM), and how it was built (provenance), "
        "beside it in the registry. Needs docker's plugin buildx.",
        default=False,
    )
    promote: Annotated[tuple[Tag, ...], UNIQUE] = field("Tags that the image gets after the verdict pass.", default=())

    def __post_init__(self) -> None:
        """Set the default tag latest, unless the image is promoted; refuse inconsistent combinations."""
        if cast("object", self.tags) is None:
            object.__setattr__(self, "tags", () if self.promote else ("latest",))
        ids = [secret.id for secret in self.secrets]
        if twice := [each for each in ids if ids.count(each) > 1]:
            raise Misfit(f"the id {twice[0]!r} occurs twice", "secrets")
        if isinstance(self.source, Recipe) and not self.ssh:
            for repository in self.source.repositories:
                if repository.by_ssh:
                    raise Misfit(f"the repository {repository.url} is cloned by SSH: add ssh: true")


@record
class RecipeImage(ImageSpecification):
    """An image that is generated from a recipe."""

    source: Recipe = field(flat=True)


@record
class DockerfileImage(ImageSpecification):
    """An image that is built from the user's Dockerfile."""

    source: OwnDockerfile = field(flat=True)


ImageDocument = RecipeImage | DockerfileImage
"""Document of a specification."""


def read_image_specification(path: Path, environment: Mapping[str, str] | None = None) -> ImageSpecification:
    """Read a specification from its own file, or from the key ``image`` of a ``calibration.yml``.

    ``${NAME}`` in a text is replaced by the environment variable of that name. Paths are relative to
    the file.

    Raises:
        InputError: the file is missing, is not YAML, or has invalid keys; the message names file and key.
    """
    document = read_yaml(path, "an image specification")
    where = str(path)
    if isinstance(document, dict) and "image" in document:
        document, where = document["image"], f"{path}: image"
    elif isinstance(document, dict) and "systems" in document:
        raise InputError(f"{path}: found no key 'image', the specification of the image")
    return parse_image_specification(with_variables(document, where, environment), path.parent, where)


def parse_image_specification(entry: object, folder: Path, where: str) -> ImageSpecification:
    """Convert the mapping in a file to a specification.

    Args:
        entry: mapping with variables replaced.
        folder: folder to which paths are relative.
        where: file, and key in it, for messages.

    Raises:
        InputError: a key is invalid, or keys exclude each other; the message names the key.
    """
    if not isinstance(entry, dict) or "dockerfile" not in entry:
        _refuse_other_keys(entry, OwnDockerfile, f"{where}: {{}} needs dockerfile: it is for a Dockerfile of your own")
        specification: ImageSpecification = read(RecipeImage, entry, where, folder)
    else:
        _refuse_other_keys(entry, Recipe, f"{where}: {{}} excludes dockerfile: write it in your Dockerfile")
        specification = read(DockerfileImage, entry, where, folder)
    if specification.name == DEFAULT_NAME and (specification.push or specification.promote):
        raise InputError(f"{where}: name is not given: a registry's image needs one, such as ghcr.io/team/robot")
    if len(specification.platforms) > 1 and not specification.push:
        raise InputError(f"{where}: platforms: an engine holds one of several platforms: add push: true, or name one")
    if specification.attest and not specification.push:
        raise InputError(f"{where}: attest: what BuildKit says of an image is kept in its registry: add push: true")
    return specification


def _refuse_other_keys(entry: object, kind: type, message: str) -> None:
    """Refuse the keys of the other kind of image."""
    for key in flat_fields(kind):
        if isinstance(entry, dict) and key in entry:
            raise InputError(message.format(key))
