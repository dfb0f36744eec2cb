"""Plan of a build: context, Dockerfile and content key, determined before the build."""

import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.base.errors import InputError
from calibration.base.files import read_bytes
from calibration.ci.image.bases import Base, Login, find_base
from calibration.ci.image.content_key import content_key
from calibration.ci.image.context import NO_SOURCES, Context, Ignored, read_ignore_file
from calibration.ci.image.dockerfile_reading import bases_of, needs_buildkit
from calibration.ci.image.recipe import layout
from calibration.ci.image.recipe.dockerfile import Rendered, render
from calibration.ci.image.recipe.repositories import Repository
from calibration.ci.image.specification import ImageSpecification, OwnDockerfile, Recipe

if TYPE_CHECKING:
    from docker import DockerClient

MANIFEST_NAMES = frozenset({"package.xml", "CATKIN_IGNORE", "COLCON_IGNORE", "AMENT_IGNORE"})
"""Files that describe the packages of a workspace; rosdep reads no others."""
MAX_DOCKERFILE = 1024 * 1024


@dataclass(frozen=True)
class Plan:
    """Input of a build."""

    context: Context
    dockerfile: str
    """Path of the Dockerfile in the context."""
    text: str
    """Content of the Dockerfile."""
    key: str
    bases: tuple[Base, ...]
    needs_buildkit: bool = False
    notes: tuple[str, ...] = ()
    """Inputs that the key does not cover: their changes cause no new build."""


def make_plan(
    client: "DockerClient",
    specification: ImageSpecification,
    login: Login,
    *,
    ask_registry: bool = False,
    leave_out: Iterable[Path] = (),
) -> Plan:
    """Determine the input of an image.

    Args:
        client: client of the engine.
        specification: specification of the image.
        login: returns the credentials for the registry of a base.
        ask_registry: resolve the bases in their registries, even if the engine has images of these names.
        leave_out: folders that are excluded from the context.

    Raises:
        InputError: a file, a folder or a base is missing, or the context is too large.
        InfrastructureError: a file cannot be read, or the registry of a base cannot be reached.
    """
    source = specification.source
    context = Context(leave_out)
    arguments, target = {}, None
    if isinstance(source, OwnDockerfile):
        name, text = _add_own_dockerfile(source, context)
        found = bases_of(text, source.build_arguments)
        bases = tuple(find_base(client, base, login, ask_registry=ask_registry) for base in found.images)
        notes = tuple(f"only the builder can resolve {base}" for base in found.unresolved)
        buildkit = needs_buildkit(text) or bool(specification.secrets) or specification.ssh
        arguments, target = dict(source.build_arguments), source.target
    else:
        base = find_base(client, source.base, login, ask_registry=ask_registry)
        rendered = add_recipe(specification, context, base.digest)
        name, text, buildkit = layout.DOCKERFILE_NAME, rendered.dockerfile, rendered.needs_buildkit
        bases, notes = (base,), tuple(_moving_parts(source))
    platforms = specification.platforms or (_own_platform(client),)
    identities = {base.name: base.identity for base in bases}
    key = content_key(context, name, identities, platforms, arguments, target, specification.labels)
    return Plan(context, name, text, key, bases, buildkit or len(platforms) > 1, notes)


def add_recipe(specification: ImageSpecification, context: Context, base_digest: str | None = None) -> Rendered:
    """Render a recipe, and add all files that its Dockerfile copies to the context.

    Raises:
        InputError: a file or folder is missing, or the context is too large.
    """
    recipe = specification.source
    if not isinstance(recipe, Recipe):
        raise AssertionError("only a recipe is rendered")
    for number, file in enumerate(recipe.requirements):
        context.add_file(layout.requirements(number), file, "pip")
    for number, copied in enumerate(recipe.files):
        if copied.source.is_dir():
            context.add_folder(layout.copied(number), copied.source, "files", _ignored_files(copied.source))
        else:
            context.add_file(layout.copied(number), copied.source, "files")
    for number, folder in enumerate(recipe.workspace.sources if recipe.workspace else ()):
        ignored = _ignored_files(folder)
        context.add_folder(layout.manifests(number), folder, "workspace.sources", ignored, only=MANIFEST_NAMES)
        context.add_folder(layout.source(number), folder, "workspace.sources", ignored)
    rendered = render(specification, base_digest)
    context.add_bytes(layout.DOCKERFILE_NAME, rendered.dockerfile.encode())
    if rendered.entrypoint is not None:
        context.add_bytes(layout.ENTRYPOINT_NAME, rendered.entrypoint.encode(), executable=True)
    return rendered


def _add_own_dockerfile(source: OwnDockerfile, context: Context) -> tuple[str, str]:
    """Add a user's Dockerfile and its context; return its path in the context, and its content."""
    data = read_bytes(source.file, MAX_DOCKERFILE, "a Dockerfile")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{source.file}: this is no Dockerfile: no text in UTF-8") from None
    special = source.file.with_name(f"{source.file.name}.dockerignore")
    rules = read_ignore_file(special if special.exists() else source.context / ".dockerignore")
    context.add_folder("", source.context, "context", Ignored(rules))
    file, folder = source.file.resolve(), source.context.resolve()
    name = file.relative_to(folder).as_posix() if file.is_relative_to(folder) else ".calibration.Dockerfile"
    context.add_bytes(name, data)
    return name, text


def _ignored_files(folder: Path) -> Ignored:
    return Ignored([*NO_SOURCES, *read_ignore_file(folder / ".dockerignore")])


def _moving_parts(recipe: Recipe) -> list[str]:
    repositories: Sequence[Repository] = recipe.workspace.repositories if recipe.workspace else ()
    return [
        f"{repository.url} is at {repository.version or 'its default branch'}, which may move: pin a commit"
        for repository in repositories
        if not repository.pinned
    ]


def _own_platform(client: "DockerClient") -> str:
    version = client.version()
    return f"{version.get('Os', 'linux')}/{version.get('Arch', platform.machine())}"
