"""What an image is made of.

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

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Literal, cast

from calibration.errors import InputError
from calibration.image.recipe.repositories import Repository, read_repositories
from calibration.image.recipe.user_text import check_line, check_text, package_name
from calibration.records import (
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
from calibration.registries.credentials import RegistrySettings, VariableName
from calibration.registries.reference import Reference, parse_reference
from calibration.variables import with_variables
from calibration.yaml_file import read_yaml

DEFAULT_NAME = "calibration-image"
"""Of an image that is not for a registry."""
LABELS = "ci.calibration."
"""Our own labels begin so."""


def _text(check: Callable[[str, str], str], least: int = 0) -> Converted:
    """Text that one of the checks of `user_text` lets pass."""
    return Converted(Annotated[str, length(least)] if least else str, lambda text, place: check(text, str(place)))


def _pip_item(text: str, place: Place) -> str | Path:
    item = check_line(text, str(place)).strip()
    if item.startswith("-r"):
        return place.folder / item[2:].strip()
    if item.startswith("-"):
        raise place.fault(f"found the option {item!r}, expected a package or '-r FILE'")
    return item


def _shell(text: str, place: Place) -> str:
    if not text.strip():
        raise place.fault("found a blank, a command was expected")
    return check_text(text, str(place))


def _words(entry: str | tuple[str, ...], place: Place) -> tuple[str, ...]:
    words = ("/bin/bash", "-c", entry) if isinstance(entry, str) else entry
    return tuple(check_text(word, str(place)) for word in words)


def _reference(text: str, place: Place) -> Reference:
    try:
        return parse_reference(text)
    except InputError as error:
        raise place.fault(str(error)) from None


def _name(text: str, place: Place) -> str:
    reference = _reference(text, place)
    if reference.tag or reference.digest:
        raise place.fault(f"found {text!r}, a name without a tag was expected: write it under tags")
    return reference.name


def _base(text: str, place: Place) -> str:
    if (base := str(_reference(text, place))) == "scratch":
        raise place.fault("scratch has no programs to install with: name an image of Debian or Ubuntu")
    return base


def _value(value: object, place: Place) -> str:
    """A value as text: a number as it is written, a truth value as ``true`` or ``false``."""
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else str(value)
    return check_line(text, str(place))


Line = Annotated[str, _text(check_line)]
File = Annotated[Path, Converted(Annotated[Line, length(1)], lambda text, place: place.folder / text)]
"""A path, relative to the file that names it."""
Value = Annotated[str, Converted(str | bool | int | float, _value)]
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
        rf"(?!{re.escape(LABELS)})[A-Za-z0-9]([A-Za-z0-9._/-]*[A-Za-z0-9])?",
        f"letters, digits and . _ / -, not {LABELS} at its start: these are set by build-image",
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

    tool: Literal["catkin_make", "colcon"] = field("What builds it.")
    sources: Annotated[tuple[File, ...], length(1), UNIQUE] = field(
        "Folders with packages, each copied to src/<its name>; .dockerignore in them counts, .git is left out (the "
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
        ".repos or .rosinstall files of git repositories to clone into src. Pin commits: a branch that moves makes no "
        "new image.",
        default=(),
    )
    rosdep: bool = field("Whether rosdep installs what the package.xml files name.", default=True)
    rosdep_skip: tuple[RosdepKey, ...] = field("Keys that rosdep leaves alone.", default=())
    cmake_arguments: Mapping[VariableName, Value] = field(
        "-D of CMake: {CMAKE_BUILD_TYPE: Release}.", default_factory=dict
    )
    packages: Annotated[tuple[RosPackage, ...], length(1)] = field(
        "Build only these packages and what they need.", default=()
    )
    path: PathInImage = field("Where it is in the image.", default="/workspace")

    def __post_init__(self) -> None:
        """Refuse two folders of one name."""
        names = [source.resolve().name for source in self.sources]
        if twice := [name for name in names if names.count(name) > 1]:
            raise Misfit(f"two folders are called {twice[0]!r}, and would be one in the workspace", "sources")


@record
class Recipe:
    """What comes on top of a base; a Dockerfile is generated from it."""

    base: Annotated[str, Converted(Annotated[str, length(1)], _base)] = field(
        "The image to start from, of Debian or Ubuntu; ros alone means ros:<distro>.", default=""
    )
    ros: Distro | None = field("A ROS distribution in /opt/ros that is sourced: noetic, humble, ...", default=None)
    apt: tuple[Annotated[str, _text(package_name, 1)], ...] = field(
        "Debian packages, with =version where it matters.", default=()
    )
    pip_items: tuple[Annotated[str | Path, Converted(Annotated[str, length(1)], _pip_item)], ...] = field(
        "Python packages as pip takes them; '-r FILE' for a file of requirements.", key="pip", default=()
    )
    environment: Mapping[VariableName, Value] = field(
        "Variables of the image, taken literally ($ too). They can be read in the image: never a secret.",
        default_factory=dict,
    )
    files: tuple[CopiedFile, ...] = field("Files and folders to copy, before the commands.", default=())
    commands: tuple[Annotated[str, Converted(str, _shell)], ...] = field(
        "Shell (bash) commands, a step each, run by root before the workspace is built.", default=()
    )
    workspace: Workspace | None = field("A ROS workspace that is built into the image.", default=None)
    entrypoint: tuple[Annotated[str, _text(check_text)], ...] = field(
        "Lines of shell for the start of a container, after ROS and the workspace are sourced.", default=()
    )
    command: Annotated[
        tuple[str, ...],
        Converted(Annotated[str, length(1)] | Annotated[tuple[str, ...], length(1)], _words),
    ] = field("What a container runs unless told: arguments, or a line for the shell.", default=())
    user: User = field("Who runs containers; made where the base has no such user.", default="robot")

    def __post_init__(self) -> None:
        """Start from the image of the ROS distribution where no base is named."""
        if not self.base:
            if self.ros is None:
                raise Misfit("found none of base, ros and dockerfile: name the image to start from, in base")
            object.__setattr__(self, "base", str(parse_reference(f"ros:{self.ros}")))

    @property
    def pip(self) -> tuple[str, ...]:
        """The packages that pip installs by name."""
        return tuple(item for item in self.pip_items if isinstance(item, str))

    @property
    def requirements(self) -> tuple[Path, ...]:
        """The files of requirements for pip."""
        return tuple(item for item in self.pip_items if isinstance(item, Path))


@record
class OwnDockerfile:
    """A Dockerfile that the user wrote, as it is."""

    file: File = field(
        "A Dockerfile of your own, relative to this file, in the place of base and all that goes on top of it.",
        key="dockerfile",
    )
    context: File = field(
        "The folder that your Dockerfile copies from; its .dockerignore counts (this file's folder).", implied="."
    )
    build_arguments: Mapping[VariableName, Value] = field(
        "Values for ARG in your Dockerfile. They can be read in the image: never a secret.", default_factory=dict
    )
    target: Stage | None = field("The stage of your Dockerfile to build (the last).", default=None)


@record
class Secret:
    """What the build may read and the image must not hold; here only where it is."""

    id: Stage = field("Its name: the build finds it in /run/secrets/<id>.")
    variable: VariableName | None = field("The environment variable that holds it.", default=None)
    file: File | None = field("The file that holds it.", default=None)
    host: Host | None = field("The host whose git repositories it is the password of: github.com.", default=None)
    username: Annotated[str, matching("[A-Za-z0-9_.@+-]+", "the name of a user")] = field(
        "The user that goes with it there.", default="x-access-token"
    )

    def __post_init__(self) -> None:
        """Refuse a secret that is nowhere, or in two places."""
        if (self.variable is None) == (self.file is None):
            raise Misfit(f"{self.id}: expected either variable or file, which say where it is")


@record
class ImageSpecification:
    """An image, where it belongs and how it gets there."""

    source: Recipe | OwnDockerfile
    name: Annotated[str, Converted(Annotated[str, length(1)], _name)] = field(
        "Where the image belongs, without a tag: ghcr.io/team/robot. Needed to push.", default=DEFAULT_NAME
    )
    tags: Annotated[tuple[Tag, ...], UNIQUE] = field(
        "Tags beside the one made of the content (latest; none where promote says what a green verdict brings).",
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
    registry: RegistrySettings | None = field(
        "How to log in; where there is none, what `docker login` left.", default=None
    )
    push: bool = field("Whether the image goes to its registry.", default=False)
    promote: Annotated[tuple[Tag, ...], UNIQUE] = field(
        "Tags that the same image gets after a green verdict.", default=()
    )

    def __post_init__(self) -> None:
        """Name the image latest where nothing else is said; refuse values that are right alone and wrong together."""
        if cast("object", self.tags) is None:
            object.__setattr__(self, "tags", () if self.promote else ("latest",))
        ids = [secret.id for secret in self.secrets]
        if twice := [each for each in ids if ids.count(each) > 1]:
            raise Misfit(f"the id {twice[0]!r} occurs twice", "secrets")
        if isinstance(self.source, Recipe) and self.source.workspace and not self.ssh:
            for repository in self.source.workspace.repositories:
                if repository.by_ssh:
                    raise Misfit(f"the repository {repository.url} is cloned by SSH: add ssh: true")


@record
class RecipeImage(ImageSpecification):
    """An image of a base and what comes on top of it."""

    source: Recipe = field(flat=True)


@record
class DockerfileImage(ImageSpecification):
    """An image of a Dockerfile of your own."""

    source: OwnDockerfile = field(flat=True)


ImageDocument = RecipeImage | DockerfileImage
"""What a specification says."""


def read_image_specification(path: Path, environment: Mapping[str, str] | None = None) -> ImageSpecification:
    """Read a specification from a file of its own, or from the key ``image`` of a ``calibration.yml``.

    ``${NAME}`` in a text is replaced by the environment variable of that name. Paths are relative to
    the file.

    Raises:
        InputError: the file is missing, is no YAML, or is no specification; names file and key.
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
        InputError: it is no specification, or keys exclude each other; names the key.
    """
    if not isinstance(entry, dict) or "dockerfile" not in entry:
        _refuse(entry, OwnDockerfile, f"{where}: {{}} needs dockerfile: it is for a Dockerfile of your own")
        specification: ImageSpecification = read(RecipeImage, entry, where, folder)
    else:
        _refuse(entry, Recipe, f"{where}: {{}} excludes dockerfile: a Dockerfile of your own says it itself")
        specification = read(DockerfileImage, entry, where, folder)
    if specification.name == DEFAULT_NAME and (specification.push or specification.promote):
        raise InputError(f"{where}: name is not given: a registry's image needs one, such as ghcr.io/team/robot")
    if len(specification.platforms) > 1 and not specification.push:
        raise InputError(f"{where}: platforms: an engine holds one of several platforms: add push: true, or name one")
    return specification


def _refuse(entry: object, kind: type, message: str) -> None:
    """Refuse the keys of the other kind of image."""
    for key in flat_fields(kind):
        if isinstance(entry, dict) and key in entry:
            raise InputError(message.format(key))
