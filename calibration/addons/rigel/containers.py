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
    fields, notes, entry = Fields(component, where, around.notes), around.notes, dict[str, Any]()
    secrets: dict[str, None] = {}
    fields.take("name")
    _convert_image(fields.take("image", ""), entry, around, fields.at("image"))
    for key in ("command", "entrypoint"):
        if value := fields.take(key):
            entry[key] = _convert_command(value, secrets, around, fields.at(key))
    _convert_environment(fields.mapping("envs"), entry, secrets, around, fields.at("envs"))
    _convert_mounts(fields.items("volumes"), entry, around, fields.at("volumes"))
    for ours, theirs in (("working-directory", "workdir"), ("user", "user"), ("memory", "memory")):
        if (value := fields.take(theirs)) not in (None, ""):
            entry[ours] = _plain_text(value, around, fields.at(theirs))
    cpus = fields.take("cpus")
    if isinstance(cpus, int | float) and not isinstance(cpus, bool):
        entry["cpus"] = cpus
    elif cpus is not None:
        notes.lost(fields.at("cpus"), "a number was expected")
    if devices := [_plain_text(item, around, fields.at("devices")) for item in fields.items("devices")]:
        entry["devices"] = [device.partition(":")[0] for device in devices]
    if fields.take("gpus"):
        entry["gpus"] = True
    if fields.truth("privileged"):
        entry["privileged"] = True
        notes.changed(fields.at("privileged"), "it may do all that root of the machine may: leave it out if you can")
    if artifacts := [
        argument(around.replaced(text), around.placeholders, _shell_variable, notes, where)
        for text in fields.texts("artifacts")
    ]:
        entry["artifacts"] = artifacts
    fields.refuse({"introspection": "requirements on ROS messages are not checked here: check files with rules"})
    if secrets:
        entry["secrets"] = list(secrets)
    fields.rest("there is no such setting of a container here")
    return entry


def pair_environment(items: list[Any], where: str) -> dict[str, str]:
    """Convert a list of ``NAME=value`` to a mapping.

    Raises:
        InputError: an item is not text.
    """
    pairs = (text_at(item, where).partition("=") for item in items)
    return {name.strip(): value for name, _, value in pairs}


def _convert_image(value: object, entry: dict[str, Any], around: Surroundings, where: str) -> None:
    image = _plain_text(value, around, where)
    if not image:
        return
    if around.image is not None and split_name(image)[0] == split_name(around.image)[0]:
        return
    entry["image"] = image


def _convert_command(value: object, secrets: dict[str, None], around: Surroundings, where: str) -> list[str]:
    """Return the command's arguments; text is split as by a shell."""
    if isinstance(value, list):
        words = [around.replaced(text_at(item, where)) for item in value]
    else:
        text = around.replaced(text_at(value, where))
        try:
            words = shlex.split(text)
        except ValueError:
            words = ["bash", "-c", text]
            around.notes.changed(where, "its quotes do not match: it is given to bash as it is")
    found = {name for word in words for name in secret_names(word)}
    if found and not (words[0].rpartition("/")[2] in _SHELL_NAMES and "-c" in words):
        around.notes.to_do(where, f"no shell reads ${', $'.join(sorted(found))} here: run it by [bash, -c, ...]")
    secrets.update(dict.fromkeys(sorted(found)))
    return [argument(word, around.placeholders, _shell_variable, around.notes, where) for word in words]


def _convert_environment(
    variables: Mapping[str, Any],
    entry: dict[str, Any],
    secrets: dict[str, None],
    around: Surroundings,
    where: str,
) -> None:
    environment = {}
    for name, value in variables.items():
        place = f"{where}.{name}"
        text = around.replaced(text_at("" if value is None else value, place))
        alone = sole_variable(text)
        if alone is not None and (names_a_secret(name) or secret_names(text)):
            secrets[name if variable_name(name) == name else alone] = None
            if alone != name:
                around.notes.to_do(place, f"the variable {name} is passed on: put the secret there, not into {alone}")
        elif names_a_secret(name) and text:
            secrets[name] = None
            around.notes.to_do(place, f"a secret, which is not copied: put it into the variable {name}")
        elif secret_names(text):
            around.notes.lost(place, "a secret in a longer text: put the whole text into a variable, named in secrets")
        else:
            environment[name] = plain(text, around.notes, place)
    if environment:
        entry["environment"] = environment


def _convert_mounts(volumes: list[Any], entry: dict[str, Any], around: Surroundings, where: str) -> None:
    mounts: list[str | dict[str, Any]] = []
    for number, volume in enumerate(volumes):
        place = f"{where}.{number}"
        parts = volume if isinstance(volume, list) else text_at(volume, place).split(":")
        # the last element of a tuple may contain the mode: ("/a", "/b:rw")
        texts = ":".join(_plain_text(part, around, place) for part in parts).split(":")
        if len(texts) < 2 or not texts[0] or not texts[1].startswith("/"):
            around.notes.lost(place, f"{':'.join(texts)} is not HERE:THERE")
        elif texts[0].startswith(_X_SERVER):
            around.notes.lost(place, "a server of CI has no X server: xvfb-run in the command needs none")
        elif texts[0].endswith(_DOCKER_SOCKET):
            entry["docker-socket"] = True
            around.notes.changed(
                place, "access to the Docker socket equals root on the machine: leave it out if you can"
            )
        elif "ro" in texts[2:]:
            mounts.append(f"{texts[0]}:{texts[1]}")
        else:
            mounts.append({"source": texts[0], "target": texts[1], "writable": True})
            around.notes.changed(place, "it stays writable: leave `writable` out where nothing is written")
    if mounts:
        entry["mounts"] = mounts


def _plain_text(value: object, around: Surroundings, where: str) -> str:
    return plain(around.replaced(text_at(value, where)), around.notes, where)


def named(text: str) -> str:
    """Convert a text to a valid name of a container, a system or a simulation: ``Robot App`` gives ``robot-app``."""
    return re.sub(r"[^a-z0-9-]+", "-", text.lower()).strip("-")[:63] or "robot"


def _shell_variable(name: str) -> str:
    return f"${name}"
