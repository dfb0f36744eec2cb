"""Containers of ``calibration.yml``, from components of ComposePlugin or applications of RoboMakerPlugin."""

import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from calibration.addons.rigel.fields import (
    Fields,
    Notes,
    argument,
    names_a_secret,
    plain,
    secret_names,
    sole_variable,
    text_at,
    variable_name,
)
from calibration.addons.rigel.image import split_name

_DOCKER_SOCKET = "docker.sock"
_X_SERVER = "/tmp/.X11-unix"  # noqa: S108 (where it is)
_SHELL_NAMES = ("sh", "bash", "dash")


@dataclass(frozen=True)
class Surroundings:
    """Context of the conversion of a container."""

    notes: Notes
    image: str | None
    """Image built by the section ``image``; a container that runs it need not name it."""
    placeholders: Mapping[str, str]
    """Our placeholders, by the names of the matrix in Rigel."""
    replaced: Callable[[str], str] = str
    """Applied to every text first."""


def component_entry(component: dict[str, Any], around: Surroundings, where: str) -> dict[str, Any]:
    """Return the entry of a component, without its name.

    Raises:
        InputError: a field has the wrong type.
    """
    return _Component(component, around, where).entry()


def without_empty(entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry without the keys that say nothing: None, false, and empty texts, lists and mappings."""
    return {key: value for key, value in entry.items() if value not in (None, "", [], {}) and value is not False}


class _Component:
    """A component while it is converted."""

    def __init__(self, component: dict[str, Any], around: Surroundings, where: str) -> None:
        self._fields = Fields(component, where, around.notes)
        self._around, self._notes = around, around.notes
        self._secrets: dict[str, None] = {}
        self._has_docker_socket = False

    def entry(self) -> dict[str, Any]:
        fields = self._fields
        fields.take("name")
        image, commands = self._image(), {key: self._command(key) for key in ("command", "entrypoint")}
        environment, mounts = self._environment(), self._mounts()
        entry = {
            "image": image,
            **commands,
            "environment": environment,
            "docker-socket": self._has_docker_socket,
            "mounts": mounts,
            "working-directory": self._plain("workdir"),
            "user": self._plain("user"),
            "memory": self._plain("memory"),
            "cpus": self._cpus(),
            "devices": [
                self._plain_text(item, fields.at("devices")).partition(":")[0] for item in fields.items("devices")
            ],
            "gpus": bool(fields.take("gpus")),
            "privileged": self._privileged(),
            "artifacts": [self._argument(text, fields.where) for text in fields.texts("artifacts")],
            "secrets": list(self._secrets),
        }
        fields.take("introspection")  # of messages: converted with those of all jobs
        fields.rest("there is no such setting of a container here")
        return without_empty(entry)

    def _image(self) -> str:
        """Return the image; empty if it is the one that is built."""
        image = self._plain_text(self._fields.take("image", ""), self._fields.at("image"))
        built = self._around.image
        return "" if image and built is not None and split_name(image)[0] == split_name(built)[0] else image

    def _command(self, key: str) -> list[str]:
        """Return the command's arguments; text is split as by a shell."""
        value, where = self._fields.take(key), self._fields.at(key)
        if not value:
            return []
        if isinstance(value, list):
            words = [self._around.replaced(text_at(item, where)) for item in value]
        else:
            text = self._around.replaced(text_at(value, where))
            try:
                words = shlex.split(text)
            except ValueError:
                words = ["bash", "-c", text]
                self._notes.changed(where, "its quotes do not match: it is given to bash as it is")
        found = {name for word in words for name in secret_names(word)}
        if found and not (words[0].rpartition("/")[2] in _SHELL_NAMES and "-c" in words):
            self._notes.to_do(where, f"no shell reads ${', $'.join(sorted(found))} here: run it by [bash, -c, ...]")
        self._secrets |= dict.fromkeys(sorted(found))
        return [self._argument(word, where) for word in words]

    def _environment(self) -> dict[str, str]:
        environment = {}
        for name, value in self._fields.mapping("envs").items():
            place = f"{self._fields.at('envs')}.{name}"
            text = self._around.replaced(text_at("" if value is None else value, place))
            alone = sole_variable(text)
            if alone is not None and (names_a_secret(name) or secret_names(text)):
                self._secrets[name if variable_name(name) == name else alone] = None
                if alone != name:
                    self._notes.to_do(
                        place, f"the variable {name} is passed on: put the secret there, not into {alone}"
                    )
            elif names_a_secret(name) and text:
                self._secrets[name] = None
                self._notes.to_do(place, f"a secret, which is not copied: put it into the variable {name}")
            elif secret_names(text):
                why = "a secret in a longer text: put the whole text into a variable, named in secrets"
                self._notes.lost(place, why)
            else:
                environment[name] = plain(text, self._notes, place)
        return environment

    def _mounts(self) -> list[str | dict[str, Any]]:
        mounts: list[str | dict[str, Any]] = []
        for number, volume in enumerate(self._fields.items("volumes")):
            place = f"{self._fields.at('volumes')}.{number}"
            parts = volume if isinstance(volume, list) else text_at(volume, place).split(":")
            # the last element of a tuple may contain the mode: ("/a", "/b:rw")
            texts = ":".join(self._plain_text(part, place) for part in parts).split(":")
            if len(texts) < 2 or not texts[0] or not texts[1].startswith("/"):
                self._notes.lost(place, f"{':'.join(texts)} is not HERE:THERE")
            elif texts[0].startswith(_X_SERVER):
                self._notes.lost(place, "a server of CI has no X server: xvfb-run in the command needs none")
            elif texts[0].endswith(_DOCKER_SOCKET):
                self._has_docker_socket = True
                why = "access to the Docker socket equals root on the machine: leave it out if you can"
                self._notes.changed(place, why)
            elif "ro" in texts[2:]:
                mounts.append(f"{texts[0]}:{texts[1]}")
            else:
                mounts.append({"source": texts[0], "target": texts[1], "writable": True})
                self._notes.changed(place, "it stays writable: leave `writable` out where nothing is written")
        return mounts

    def _cpus(self) -> float | None:
        cpus = self._fields.take("cpus")
        if cpus is None or (isinstance(cpus, int | float) and not isinstance(cpus, bool)):
            return cpus
        self._notes.lost(self._fields.at("cpus"), "a number was expected")
        return None

    def _privileged(self) -> bool:
        is_privileged = bool(self._fields.truth("privileged"))
        if is_privileged:
            why = "it may do all that root of the machine may: leave it out if you can"
            self._notes.changed(self._fields.at("privileged"), why)
        return is_privileged

    def _plain(self, key: str) -> str:
        value = self._fields.take(key)
        return "" if value in (None, "") else self._plain_text(value, self._fields.at(key))

    def _plain_text(self, value: object, where: str) -> str:
        return plain(self._around.replaced(text_at(value, where)), self._notes, where)

    def _argument(self, text: str, where: str) -> str:
        return argument(self._around.replaced(text), self._around.placeholders, self._notes, where)


def pair_environment(items: list[Any], where: str) -> dict[str, str]:
    """Convert a list of ``NAME=value`` to a mapping.

    Raises:
        InputError: an item is not text.
    """
    pairs = (text_at(item, where).partition("=") for item in items)
    return {name.strip(): value for name, _, value in pairs}


def named(text: str) -> str:
    """Convert a text to a valid name of a container, a system or a simulation: ``Robot App`` gives ``robot-app``."""
    return re.sub(r"[^a-z0-9-]+", "-", text.lower()).strip("-")[:63] or "robot"
