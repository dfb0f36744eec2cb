"""Generation of a Dockerfile from a recipe; deterministic, byte for byte.

Layers are ordered by how often they change: packages first, sources last. Both builders can
build it; with secrets or SSH only BuildKit, which keeps them out of the layers. Paths in the build context do not
depend on the names of the user's files, which may need quoting.
"""

import re
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from calibration.ci.image.repositories import Repository, json_words, path_words, quoted
from calibration.ci.image.specification import CopiedFile, ImageSpecification, Recipe, Secret, Workspace

DOCKERFILE_NAME = "Dockerfile"
ENTRYPOINT_NAME = "entrypoint.sh"


def requirements_path(number: int) -> str:
    """Return the path of a requirements file for pip."""
    return f"requirements/{number}.txt"


def copied_path(number: int) -> str:
    """Return the path of a file or folder to copy."""
    return f"files/{number}"


def source_path(prefix: str, number: int) -> str:
    """Return the path of a folder of sources of the workspace with this prefix (`Recipe.workspaces`)."""
    return f"{prefix}sources/{number}"


def manifests_path(prefix: str, number: int) -> str:
    """Return the path of a copy of such a folder that contains only its package.xml files."""
    return f"{prefix}manifests/{number}"


def folder_name(path: Path) -> str:
    """Return the name of a source folder in the workspace, which is its own."""
    return path.resolve().name or "source"


def target_of(file: CopiedFile) -> str:
    """Return the path of a file or folder in the image."""
    if file.target.endswith("/") and not file.source.is_dir():
        return file.target + file.source.name
    return file.target


APT_INSTALL = "DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends -o Acquire::Retries=3"
APT_CLEAN = "rm -rf /var/lib/apt/lists/*"
# Debian 12 and Ubuntu 24 require a flag to let pip install into the system's Python (PEP 668); older pips ignore it.
PIP_VARIABLES = "PIP_BREAK_SYSTEM_PACKAGES=1 PIP_ROOT_USER_ACTION=ignore"
SHELL_WORDS = ("/bin/bash", "-eo", "pipefail", "-c")
ENTRYPOINT_PATH = "/usr/local/bin/calibration-entrypoint"
CLONES_NAME = "repositories"
_SETUP_OF_BUILDER = {"catkin_make": "devel/setup.bash", "colcon": "install/setup.bash"}

# Commands with a special meaning in RUN: by their start, by the end of a line, or by a here-document.
_NOT_PLAIN = re.compile(r"^[\s\[#-]|<<|[\n\r\t]|\\\s*$")


@dataclass(frozen=True)
class Rendered:
    """Output of the conversion of a recipe."""

    dockerfile: str
    entrypoint: str | None = None
    """Start script of containers; None to use that of the base."""
    needs_buildkit: bool = False


def render(specification: ImageSpecification, base_digest: str | None = None) -> Rendered:
    """Generate the Dockerfile of a specification with a recipe.

    Args:
        specification: specification with a :class:`Recipe`, not with the user's own Dockerfile.
        base_digest: digest to pin the base to (``sha256:...``), if it is known.
    """
    recipe = specification.source
    if not isinstance(recipe, Recipe):
        raise AssertionError("a Dockerfile of the user's own is not rendered")
    mounts = "".join(f"--mount=type=secret,id={secret.id} " for secret in specification.secrets)
    mounts += "--mount=type=ssh " if specification.ssh else ""
    base = recipe.base
    if base_digest and "@" not in base:
        base = f"{base}@{base_digest}"
    entrypoint = entrypoint_script(recipe)
    stages = [
        "# Made by `calibration build-image`: change the specification, not this file.",
        *_clone_stage(base, recipe, specification.secrets, mounts, specification.ssh),
        *_image_stage(base, recipe, mounts),
        *(f"LABEL {quoted(name)}={quoted(value)}" for name, value in sorted(specification.labels.items())),
        *_start_instructions(recipe, has_entrypoint=entrypoint is not None),
    ]
    return Rendered("\n".join(stages) + "\n", entrypoint, needs_buildkit=bool(mounts))


def _clone_stage(base: str, recipe: Recipe, secrets: Iterable[Secret], mounts: str, ssh: bool) -> Iterator[str]:
    """Generate a separate stage for the clones, so that only their files reach the image, not secrets in its layers."""
    if not recipe.repositories:
        return
    yield f"FROM {base} AS repositories"
    yield f"SHELL {json_words(*SHELL_WORDS)}"
    yield "USER root"
    yield _install_packages(["ca-certificates", "git", *(["openssh-client"] if ssh else [])])
    yield "ENV GIT_TERMINAL_PROMPT=0" + (' GIT_SSH_COMMAND="ssh -o StrictHostKeyChecking=accept-new"' if ssh else "")
    for secret in secrets:
        if secret.host is not None:
            helper = f'!f() {{ echo username={secret.username}; echo "password=$(cat /run/secrets/{secret.id})"; }}; f'
            key = f"credential.https://{secret.host}.helper"
            yield _run_step(f"git config --global {shlex.quote(key)} {shlex.quote(helper)}")
    for prefix, workspace in recipe.workspaces.items():
        for repository in workspace.repositories:
            yield _run_step(*_clone_repository(_clones_folder(prefix), repository), mounts=mounts)
    yield ""


def _clones_folder(prefix: str) -> str:
    return f"/{prefix}{CLONES_NAME}"


def _clone_repository(clones: str, repository: Repository) -> Iterator[str]:
    folder = shlex.quote(f"{clones}/{repository.path}")
    yield f"git clone -- {shlex.quote(repository.url)} {folder}"
    if repository.version is not None:
        yield f"git -C {folder} checkout --quiet {shlex.quote(repository.version)} --"
    yield f"git -C {folder} submodule update --init --recursive"
    yield f"find {folder} -name .git -prune -exec rm -rf {{}} +"


def _image_stage(base: str, recipe: Recipe, mounts: str) -> Iterator[str]:
    yield f"FROM {base}"
    yield f"SHELL {json_words(*SHELL_WORDS)}"
    yield "USER root"
    for name, value in sorted(recipe.environment.items()):
        yield f"ENV {name}={quoted(value)}"
    if recipe.apt:
        yield _install_packages(sorted(set(recipe.apt)))
    yield from _install_pip_packages(recipe, mounts)
    if recipe.user != "root":
        # Without a fixed uid, because some bases already have a user 1000.
        yield f"RUN id -u {recipe.user} >/dev/null 2>&1 || useradd --create-home --shell /bin/bash {recipe.user}"
    for prefix, workspace in recipe.workspaces.items():
        yield from _install_dependencies(recipe, prefix, workspace)
        if prefix:  # an underlay, which changes less often than the files below
            yield from _build_workspace(recipe, prefix, workspace)
            yield "USER root"
    for number, file in enumerate(recipe.files):
        owner = f"--chown={file.owner} " if file.owner else ""
        slash = "/" if file.source.is_dir() else ""
        target = target_of(file).rstrip("/") + slash
        yield f"COPY {owner}{path_words(copied_path(number) + slash, target or '/')}"
    for command in recipe.commands:
        yield _run_step(command.strip(), mounts=mounts)
    if recipe.workspace is not None:
        yield from _build_workspace(recipe, "", recipe.workspace)


def _install_packages(packages: Iterable[str]) -> str:
    return _run_step("apt-get update", " ".join([APT_INSTALL, *packages]), APT_CLEAN)


def _install_pip_packages(recipe: Recipe, mounts: str) -> Iterator[str]:
    if not (recipe.pip or recipe.requirements):
        return
    files = []
    for number in range(len(recipe.requirements)):
        files.append(f"/tmp/{requirements_path(number)}")  # noqa: S108 (in the image)
        yield f"COPY {path_words(requirements_path(number), files[-1])}"
    packages = [shlex.quote(package) for package in recipe.pip]
    options = [f"--requirement {file}" for file in files]
    yield _run_step(
        "{ python3 -m pip --version >/dev/null 2>&1 || "
        f"{{ apt-get update && {APT_INSTALL} python3-pip && {APT_CLEAN}; }}; }}",
        " ".join([PIP_VARIABLES, "python3 -m pip install --no-cache-dir", *options, *packages]),
        mounts=mounts,
    )


def _install_dependencies(recipe: Recipe, prefix: str, workspace: Workspace) -> Iterator[str]:
    """Install dependencies from the package.xml files only, so that this layer does not depend on the code."""
    path, user = workspace.path, recipe.user
    yield f"RUN install --directory --owner={user} {path} {path}/src"
    if workspace.repositories:
        yield f"COPY --from=repositories --chown={user} {path_words(_clones_folder(prefix) + '/', path + '/src/')}"
    for number, source in enumerate(workspace.sources):
        target = f"{path}/src/{folder_name(source)}/"
        yield f"COPY --chown={user} {path_words(manifests_path(prefix, number) + '/', target)}"
    steps = []
    if workspace.rosdep:
        distro = f" --rosdistro {recipe.ros}" if recipe.ros else ""
        skip = f" --skip-keys {shlex.quote(' '.join(workspace.rosdep_skip))}" if workspace.rosdep_skip else ""
        steps += [
            "apt-get update",
            f"{{ command -v rosdep >/dev/null || {APT_INSTALL} python3-rosdep; }}",
            "{ test -e /etc/ros/rosdep/sources.list.d/20-default.list || rosdep init; }",
            "export DEBIAN_FRONTEND=noninteractive",
            f"rosdep update --include-eol-distros{distro}",
            f"{PIP_VARIABLES} rosdep install --from-paths {path}/src --ignore-src -y{distro}{skip}",
            "rm -rf /root/.ros",
        ]
    if workspace.tool == "colcon":
        install = f"apt-get update && {APT_INSTALL} python3-colcon-common-extensions"
        steps.append(f"{{ command -v colcon >/dev/null || {{ {install}; }}; }}")
    if steps:
        yield _run_step(*steps, APT_CLEAN)


def _build_workspace(recipe: Recipe, prefix: str, workspace: Workspace) -> Iterator[str]:
    yield f"WORKDIR {workspace.path}"
    if recipe.user != "root":
        yield f"USER {recipe.user}"
    for number, source in enumerate(workspace.sources):
        target = f"{workspace.path}/src/{folder_name(source)}/"
        yield f"COPY --chown={recipe.user} {path_words(source_path(prefix, number) + '/', target)}"
    arguments = [shlex.quote(f"-D{name}={value}") for name, value in sorted(workspace.cmake_arguments.items())]
    only = "--packages-up-to" if workspace.tool == "colcon" else "--only-pkg-with-deps"
    command = ["colcon build"] if workspace.tool == "colcon" else ["catkin_make"]
    command += [only, *workspace.packages] if workspace.packages else []
    command += ["--cmake-args", *arguments] if arguments else []
    yield _run_step(*(f"source {file}" for file in setup_files(recipe, before=prefix)), " ".join(command))


def _start_instructions(recipe: Recipe, *, has_entrypoint: bool) -> Iterator[str]:
    if has_entrypoint:
        yield f"COPY {path_words(ENTRYPOINT_NAME, ENTRYPOINT_PATH)}"
        yield f"ENTRYPOINT {json_words(ENTRYPOINT_PATH)}"
    if recipe.user != "root" and recipe.workspace is None:  # which has set it
        yield f"USER {recipe.user}"
    if recipe.command:
        yield f"CMD {json_words(*recipe.command)}"
    elif has_entrypoint:
        yield 'CMD ["/bin/bash"]'


def _run_step(*commands: str, mounts: str = "") -> str:
    """Format a RUN step that chains commands with &&; in shell form if that is unambiguous, else in JSON form."""
    if any(_NOT_PLAIN.search(command) for command in commands):
        return f"RUN {mounts}{json_words(*SHELL_WORDS, ' && '.join(commands))}"
    return f"RUN {mounts}" + " \\\n && ".join(commands)


def entrypoint_script(recipe: Recipe) -> str | None:
    """Return the start script of containers, which sources ROS and the workspace and executes the command.

    It has no output of its own; None if there is nothing to do before the command.
    """
    lines = [*(f"source {file}" for file in setup_files(recipe)), *recipe.entrypoint]
    if not lines:
        return None
    return "\n".join(["#!/bin/bash", "set -e", *lines, 'exec "$@"']) + "\n"


def setup_files(recipe: Recipe, before: str | None = None) -> Iterator[str]:
    """Yield the setup files to source: of all workspaces, or of those before the one with this prefix."""
    if recipe.ros is not None:
        yield f"/opt/ros/{recipe.ros}/setup.bash"
    for prefix, workspace in recipe.workspaces.items():
        if prefix == before:
            return
        yield f"{workspace.path}/{_SETUP_OF_BUILDER[workspace.tool]}"
