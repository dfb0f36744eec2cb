"""Section ``image``, from the jobs that write a Dockerfile and build it."""

import re
from typing import Any

from calibration.addons.rigel.document import Rigelfile, RigelJob
from calibration.addons.rigel.fields import Fields, names_a_secret, plain, secret_names, shell, sole_variable, text_at

DOCKERFILE_PLUGIN, BUILD_PLUGIN = "DockerfilePlugin", "BuildXPlugin"
DOCKER_HUB = "docker.io"
DEFAULT_USER = "rigeluser"
"""Rigel's default user, whose home directory occurs in many commands."""
_PACKAGE_NAME = re.compile(r"[a-z0-9][a-z0-9+.-]*(:[a-z0-9]+)?(=[A-Za-z0-9.+~:-]+)?(/[a-z0-9-]+)?|\$\{\w+\}")


def image_section(rigelfile: Rigelfile) -> tuple[dict[str, Any], list[str]]:
    """Return the section ``image`` and the names of its source jobs; empty if no job builds an image.

    Raises:
        InputError: a field has the wrong type.
    """
    dockerfiles = [job for job in rigelfile.jobs if job.kind == DOCKERFILE_PLUGIN]
    builds = [job for job in rigelfile.jobs if job.kind == BUILD_PLUGIN]
    if not dockerfiles and not builds:
        return {}, []
    builds.sort(
        key=lambda job: job.fields.get("push") is not True
    )  # prefer the image that is pushed, which is the tested one
    for job in (*dockerfiles[1:], *builds[1:]):
        rigelfile.notes.lost(
            job.where, f"there is one image, that of {builds[0].name if builds else dockerfiles[0].name}"
        )
    section = _Section(rigelfile)
    if builds:
        section.build(builds[0])
    if dockerfiles:
        section.dockerfile(dockerfiles[0])
    else:
        section.own_dockerfile()
    section.providers()
    return section.written(), [job.name for job in (*dockerfiles[:1], *builds[:1])]


def split_name(image: str) -> tuple[str, str | None]:
    """Split an image into name and tag; a port is not a tag."""
    start, slash, last = image.rpartition("/")
    name, _, tag = last.partition(":")
    return f"{start}{slash}{name}", tag or None


def _registry_of(image: str) -> str:
    first, slash, _ = image.partition("/")
    return first if (slash and any(sign in first for sign in ".:$")) or first == "localhost" else DOCKER_HUB


class _Section:
    def __init__(self, rigelfile: Rigelfile) -> None:
        self._file, self._notes = rigelfile, rigelfile.notes
        self._entry: dict[str, Any] = {}
        self._secrets: dict[str, None] = {}

    def written(self) -> dict[str, Any]:
        if self._secrets:
            self._entry["secrets"] = [{"id": name, "variable": name} for name in self._secrets]
        return self._entry

    def build(self, job: RigelJob) -> None:
        """Convert a job of BuildXPlugin."""
        fields = Fields(job.fields, job.where, self._notes)
        name, tag = split_name(fields.plain("image"))
        tags = [*([tag] if tag else []), *fields.plains("tags", ["latest"])]
        if fields.truth("force_tag_latest", True):
            tags.append("latest")
        else:
            tags = [item for item in tags if item != "latest"]
        self._entry |= {"name": name, "tags": list(dict.fromkeys(tags))}
        if platforms := fields.plains("platforms"):
            self._entry["platforms"] = platforms
        fields.take("load")  # a built image is always loaded into the engine
        if fields.truth("push"):
            self._entry["push"] = True
        for argument in fields.mapping("buildargs"):
            if names_a_secret(argument):
                why = "a build argument can be read in the image: name it under image.secrets, and read /run/secrets"
            else:
                why = "a generated Dockerfile has no arguments: write its value where it is used"
            self._notes.lost(f"{fields.at('buildargs')}.{argument}", why)
        fields.rest()

    def own_dockerfile(self) -> None:
        """Use the Dockerfile in the folder, since no job writes one."""
        self._entry |= {"dockerfile": self._in_folder("Dockerfile"), "context": self._file.folder}
        self._notes.to_do("jobs", f"no job writes a Dockerfile: {self._entry['dockerfile']} has to be there")

    def dockerfile(self, job: RigelJob) -> None:
        """Convert a job of DockerfilePlugin."""
        fields, entry = Fields(job.fields, job.where, self._notes), self._entry
        if "ros_image" in fields:
            entry["base"] = fields.plain("ros_image")
        if self._file.distro is not None:
            entry["ros"] = plain(self._file.distro, self._notes, "application.distro")
        self._convert_packages(fields)
        self._convert_environment(fields)
        commands = []
        for number, item in enumerate(fields.items("docker_run")):
            place = f"{fields.at('docker_run')}.{number}"
            line = text_at(item.get("command") if isinstance(item, dict) else item, place)
            for key in set(item if isinstance(item, dict) else ()) - {"command"}:
                self._notes.lost(f"{place}.{key}", "there is no such setting of a command")
            commands.append(self._shell_text(line))
        self._entry.setdefault("commands", []).extend(commands)
        if not entry["commands"]:
            del entry["commands"]
        user = fields.plain("username", DEFAULT_USER)
        self._convert_workspace(fields, user)
        self._convert_entrypoint(fields)
        entry["user"] = user
        fields.rest()

    def _convert_packages(self, fields: Fields) -> None:
        names = [name.strip() for name in fields.plains("apt")]
        packages = [name for name in names if _PACKAGE_NAME.fullmatch(name)]
        patterns = [name.strip("'\"") for name in names if not _PACKAGE_NAME.fullmatch(name)]
        if packages:
            self._entry["apt"] = list(dict.fromkeys(packages))
        if patterns:
            quoted = " ".join("'" + name.replace("'", "'\\''") + "'" for name in patterns)
            install = f"apt-get update && apt-get install --yes --no-install-recommends {quoted}"
            self._entry["commands"] = [f"{install} && rm -rf /var/lib/apt/lists/*"]
            why = f"{', '.join(patterns)}: no names of packages: they are installed in commands; better name them"
            self._notes.changed(fields.at("apt"), why)
        if files := fields.texts("python_requirements_files"):
            self._entry["pip"] = [f"-r {self._in_folder(file)}" for file in files]

    def _convert_environment(self, fields: Fields) -> None:
        environment = {}
        for pair in fields.several("env"):
            place = pair.where
            name, value = (text_at(pair.take(key), pair.at(key)) for key in ("name", "value"))
            if secret_names(value) or names_a_secret(name):
                self._notes.lost(
                    place,
                    f"{name}: a secret in the image's environment can be read by everyone with access to the image",
                )
                continue
            if "$" in value:
                self._notes.changed(place, f"{name}: environment is taken literally here; use entrypoint for $")
            environment[name] = plain(value, self._notes, place)
        if environment:
            self._entry["environment"] = environment

    def _convert_workspace(self, fields: Fields, user: str) -> None:
        compiler = fields.fields("compiler")
        tool = compiler.plain("name", "catkin_make")
        workspace: dict[str, Any] = {"tool": tool, "sources": [self._file.folder]}
        if files := fields.texts("rosinstall"):
            workspace["repositories"] = [self._in_folder(file) for file in files]
        arguments = compiler.fields("cmake_args")
        if names := arguments.names():
            workspace["cmake-arguments"] = {name.removeprefix("-D"): arguments.plain(name) for name in names}
        workspace["path"] = f"/home/{user}/ros_workspace"
        self._entry["workspace"] = workspace
        compiler.rest()

    def _convert_entrypoint(self, fields: Fields) -> None:
        lines, where = fields.texts("entrypoint"), fields.at("entrypoint")
        if any(secret_names(line) for line in lines):
            self._notes.lost(where, "a secret would be in the image: name it under secrets of the container")
        kept = [self._shell_text(line) for line in lines if not secret_names(line)]
        if kept:
            self._entry["entrypoint"] = kept
        if any(re.search(r"\bsudo\b", line) for line in kept):
            why = "containers may gain no privileges: do what needs sudo in commands (by root), and leave sudo out"
            self._notes.changed(where, why)
        command = fields.take("command")
        if isinstance(command, list):
            self._entry["command"] = [self._shell_text(text_at(item, fields.at("command"))) for item in command]
        elif command:
            self._entry["command"] = self._shell_text(text_at(command, fields.at("command")))

    def providers(self) -> None:
        """Convert the providers, which contain the logins."""
        registry = _registry_of(self._entry.get("name", ""))
        for name, provider in self._file.providers.items():
            where = f"providers.{name}"
            if provider.kind == "ContainerRegistryProvider":
                self._convert_registry(provider, registry)
            elif provider.kind == "AWSProvider":
                self._convert_aws(provider)
            elif provider.kind == "SSHProvider":
                self._entry["ssh"] = True
                why = "keys are never given to a build: load the key into an SSH agent (ssh: true uses it)"
                self._notes.to_do(where, why)
            else:
                self._notes.lost(where, f"there is no provider like {provider.plugin}")

    def _convert_registry(self, provider: RigelJob, registry: str) -> None:
        fields, where = Fields(provider.fields, provider.where, self._notes), provider.where
        address = re.sub(r"^https?://", "", fields.plain("server")).partition("/")[0]
        server = address or DOCKER_HUB
        if "registry" in self._entry or (server != registry and "$" not in server + registry):
            self._notes.lost(where, f"one login, to where the image is pushed: {registry}, not {server}")
            return
        username, password = fields.plain("username"), fields.text("password")
        variable = sole_variable(password)
        if variable is None:
            variable = next(iter(secret_names(password)), "REGISTRY_PASSWORD")
            self._notes.to_do(f"{where}.password", f"put the password into the variable {variable}")
        self._entry["registry"] = {
            "username": username or "TODO",
            "password-variable": variable,
        }
        fields.rest()

    def _convert_aws(self, provider: RigelJob) -> None:
        fields = Fields(provider.fields, provider.where, self._notes)
        servers, services = fields.items("ecr_servers"), fields.items("services")
        registry = _registry_of(self._entry.get("name", ""))
        if ("ecr" in services or servers) and "name" in self._entry and registry != DOCKER_HUB:
            self._entry.setdefault("registry", {"kind": "ecr"})
        given = [key for key in ("aws_access_key_id", "aws_secret_access_key", "region_name") if key in fields]
        for key in given:
            fields.take(key)
        if given:
            why = "AWS finds who you are by itself: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, or a role"
            self._notes.to_do(provider.where, why)
        fields.rest()

    def _in_folder(self, file: str) -> str:
        return file if self._file.folder in (".", "./", "") else f"{self._file.folder.rstrip('/')}/{file}"

    def _shell_text(self, text: str) -> str:
        def secret(name: str) -> str:
            self._secrets[name] = None
            return f"$(cat /run/secrets/{name})"

        return shell(text, secret)
