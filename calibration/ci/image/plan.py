"""Plan of a build: context, base images, Dockerfile and content key, determined before the build.

A user's Dockerfile is analysed for its base images, and whether it needs BuildKit.
"""

import platform
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import docker.errors

from calibration.base import InputError, one_line, read_bytes
from calibration.ci.docker_engine import connect, engine_errors, pull
from calibration.ci.image.build_request import BuildLog
from calibration.ci.image.context import NO_SOURCES, Context, Ignored, content_key, read_ignore_file
from calibration.ci.image.dockerfile import (
    DOCKERFILE_NAME,
    ENTRYPOINT_NAME,
    Rendered,
    copied_path,
    manifests_path,
    render,
    requirements_path,
    source_path,
)
from calibration.ci.image.specification import ImageSpecification, OwnDockerfile, Recipe
from calibration.ci.registries.reference import Credentials, Reference, RegistrySettings, parse_reference
from calibration.ci.registries.registry import RegistryClient, registry_login
from calibration.ci.workflow import Runner, group, stop_commands
from calibration.ci.workflow.streams import progress

if TYPE_CHECKING:
    from docker import DockerClient
    from docker.models.images import Image

Login = Callable[[str], Credentials]
"""Returns the credentials for the registry of an image."""


@dataclass(frozen=True)
class Base:
    """A base image and its current digest."""

    name: str
    identity: str
    """Identifier of the content: the digest; the engine's image id if it is in no registry."""
    digest: str | None = None


def find_base(client: "DockerClient", name: str, login: Login, *, ask_registry: bool = False) -> Base:
    """Resolve the name of a base: to the engine's image if it has one, else in its registry.

    Args:
        client: client of the engine.
        name: name of the image.
        login: returns the credentials for a registry.
        ask_registry: resolve the name in the registry, even if the engine has an image.

    Raises:
        InputError: neither has the image.
        InfrastructureError: the registry cannot be reached.
    """
    reference = parse_reference(name)
    if reference.digest:
        return Base(name, reference.digest, reference.digest)
    local = None if ask_registry else local_image(client, str(reference))
    if local is not None:
        digest = _digest_in_registry(local, reference)
        return Base(name, digest or str(local.id), digest)
    with RegistryClient(login(name)) as registry:
        found = registry.find_manifest(reference)
    if found is None:
        raise InputError(
            f"base image {name}: found neither on this machine nor in {reference.registry}, or access is denied: "
            "check the name, or log in"
        )
    return Base(name, found, found)


def local_image(client: "DockerClient", name: str) -> "Image | None":
    """Return the engine's image with a name, or None."""
    try:
        return client.images.get(name)
    except docker.errors.ImageNotFound:
        return None


def fetch(client: "DockerClient", name: str, login: Login, platform: str | None, log: BuildLog) -> None:
    """Pull an image unless the engine has it.

    Raises:
        InputError: the image does not exist, or access is denied.
        InfrastructureError: the pull fails.
    """
    if local_image(client, name) is not None:
        return
    reference = parse_reference(name)
    log.output(f"pulling {name}\n")
    login_options = {"auth_config": login(name).auth_config(), "platform": platform}
    pull(client.api, name, reference.name, reference.digest or reference.tag, log.clean, log.output, **login_options)


def _digest_in_registry(image: "Image", reference: Reference) -> str | None:
    """Return the digest of an image in its registry, if the engine has recorded it for this name."""
    for text in image.attrs.get("RepoDigests") or ():
        known = parse_reference(one_line(text))
        if known.name == reference.name:
            return known.digest
    return None


def pull_image(name: str, settings: RegistrySettings, runner: Runner, title: str) -> None:
    """Pull an image with the login in the settings, unless the engine has it.

    Args:
        name: name of the image; the login is used only for its registry.
        settings: login to the registry.
        runner: runner whose log shows the pull.
        title: title of the progress.

    Raises:
        InputError: the image does not exist, or access is denied.
        InfrastructureError: the engine or the registry cannot be reached.
    """
    credentials = registry_login(settings, name, runner)
    with (
        closing(connect()) as client,
        engine_errors(f"image '{name}'"),
        group(runner, f"{title}: {name}"),
        stop_commands(runner),
        progress(runner, title) as advance,
    ):
        log = BuildLog(runner, advance, credentials.secrets)
        fetch(client, name, lambda _: credentials, None, log)


_ESCAPE_DIRECTIVE = re.compile(r"#\s*escape\s*=\s*(\S)\s*$", re.IGNORECASE)
_HERE_DOCUMENT = re.compile(r"""<<-?(["']?)([A-Za-z_][A-Za-z0-9_]*)\1""")
_VARIABLE_USE = re.compile(r"\$(?:(\w+)|\{(\w+)(?::?-([^}]*))?\})")
_NEEDS_BUILDKIT = re.compile(
    r"^\s*#\s*syntax\s*=|^\s*RUN\s+--(mount|network|security)=|^\s*(COPY|ADD)\s.*--(link|chmod|checksum|exclude|parents)\b"
    r"|^\s*(RUN|COPY|ADD)\s.*<<-?[\"']?[A-Za-z_]",
    re.IGNORECASE | re.MULTILINE,
)


@dataclass(frozen=True)
class Bases:
    """Images of a Dockerfile's FROM and COPY --from."""

    images: tuple[str, ...]
    unresolved: tuple[str, ...] = ()
    """Names with variables that only the builder knows."""


def needs_buildkit(dockerfile: str) -> bool:
    """Return whether a Dockerfile needs BuildKit, as opposed to the classic builder."""
    return _NEEDS_BUILDKIT.search(dockerfile) is not None


def bases_of(dockerfile: str, arguments: Mapping[str, str]) -> Bases:
    """Return the images of ``FROM`` and ``COPY --from``, with values of ``ARG`` substituted."""
    values: dict[str, str] = {}
    stages: list[str] = []
    images: list[str] = []
    for word, rest in _read_instructions(dockerfile):
        if word == "ARG" and not stages:
            for item in rest.split():
                name, _, default = item.partition("=")
                values[name] = arguments.get(name, _fill_variables(default.strip("\"'"), values))
        elif word == "FROM":
            words = [item for item in rest.split() if not item.startswith("--")]
            image = _fill_variables(words[0], values) if words else ""
            if image.lower() not in (*stages, "scratch", ""):
                images.append(image)
            stages.append(words[2].lower() if len(words) == 3 and words[1].lower() == "as" else "")
        elif found := re.search(r"(?:--from=|--mount=\S*\bfrom=)([^\s,]+)", rest):
            image = _fill_variables(found[1], values)
            if not image.isdecimal() and image.lower() not in stages:
                images.append(image)
    known = dict.fromkeys(images)
    return Bases(tuple(i for i in known if "$" not in i), tuple(i for i in known if "$" in i))


def _read_instructions(dockerfile: str) -> Iterator[tuple[str, str]]:
    """Yield instructions and their arguments on one line, without comments and here-documents."""
    lines = iter(dockerfile.lstrip("\ufeff").split("\n"))
    escape = "\\"
    part = ""
    for number, line in enumerate(lines):
        if number < 2 and (found := _ESCAPE_DIRECTIVE.match(line)):
            escape = found[1]
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        part += line.strip()
        if part.endswith(escape):
            part = part[:-1] + " "
            continue
        word, _, rest = part.partition(" ")
        yield word.upper(), rest.strip()
        if word.upper() in ("RUN", "COPY", "ADD"):
            for _, end in _HERE_DOCUMENT.findall(part):
                for inside in lines:
                    if inside.strip() == end:
                        break
        part = ""


def _fill_variables(text: str, values: Mapping[str, str]) -> str:
    def value(match: re.Match[str]) -> str:
        name, default = match[1] or match[2], match[3]
        return values.get(name) or (match[0] if default is None else default)

    return _VARIABLE_USE.sub(value, text)


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
        name, text, buildkit = DOCKERFILE_NAME, rendered.dockerfile, rendered.needs_buildkit
        bases, notes = (base,), tuple(_moving_parts(source))
    platforms = specification.platforms or (_own_platform(client),)
    identities = {base.name: base.identity for base in bases}
    key = content_key(
        context, name, identities, platforms, arguments, target, specification.labels, attested=specification.attest
    )
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
        context.add_file(requirements_path(number), file, "pip")
    for number, copied in enumerate(recipe.files):
        if copied.source.is_dir():
            context.add_folder(copied_path(number), copied.source, "files", _ignored_files(copied.source))
        else:
            context.add_file(copied_path(number), copied.source, "files")
    for prefix, workspace in recipe.workspaces.items():
        for number, folder in enumerate(workspace.sources):
            ignored, where = _ignored_files(folder), "underlays.sources" if prefix else "workspace.sources"
            context.add_folder(manifests_path(prefix, number), folder, where, ignored, only=MANIFEST_NAMES)
            context.add_folder(source_path(prefix, number), folder, where, ignored)
    rendered = render(specification, base_digest)
    context.add_bytes(DOCKERFILE_NAME, rendered.dockerfile.encode())
    if rendered.entrypoint is not None:
        context.add_bytes(ENTRYPOINT_NAME, rendered.entrypoint.encode(), executable=True)
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
    return [
        f"{repository.url} is at {repository.version or 'its default branch'}, which may move: pin a commit"
        for repository in recipe.repositories
        if not repository.pinned
    ]


def _own_platform(client: "DockerClient") -> str:
    version = client.version()
    return f"{version.get('Os', 'linux')}/{version.get('Arch', platform.machine())}"
