"""Containers as ``calibration.yml`` describes them; the JSON Schema is ``job.schema.json`` beside this module."""

import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from calibration.errors import InputError
from calibration.execution.job import Artifact, Container, Limits, Mount, Readiness, Relaxations
from calibration.execution.placeholders import split_command
from calibration.execution.sizes import parse_bytes, parse_seconds
from calibration.json_schema import bundled, check_document

SCHEMA = Path(__file__).with_name("job.schema.json")
_ADVICE = {"oneOf": "this has none of the forms that are known: see `calibration schema`"}


def container_from(
    name: str, entry: Mapping[str, Any], folder: Path, where: str, environment: Mapping[str, str] | None = None
) -> Container:
    """Read the description of a container.

    Args:
        name: of the container.
        entry: its keys, as in the schema's ``$defs/container``; without an image (or with an empty one) it gets none.
        folder: where relative paths of ``mounts`` begin.
        where: what messages begin with.
        environment: where ``secrets`` are taken from; this process's own unless given.

    Raises:
        InputError: a key is unknown, a value wrong, or a secret is not set.
    """
    check_document(entry, _closed_schema(), where, _ADVICE)
    variables = {key: _text(value) for key, value in entry.get("environment", {}).items()}
    secrets = _secrets(entry, os.environ if environment is None else environment, where)
    if both := sorted(variables.keys() & secrets.keys()):
        raise InputError(f"{where}: {both[0]} stands in environment and in secrets: its value belongs in neither file")
    success = entry.get("success", 0)
    return Container(
        name=name,
        image=entry.get("image", ""),
        command=split_command(entry["command"], f"{where}.command") if "command" in entry else (),
        entrypoint=_entrypoint(entry, where),
        environment={**variables, **secrets},
        secrets=frozenset(secrets),
        working_directory=entry.get("working-directory"),
        user=str(entry["user"]) if "user" in entry else None,
        mounts=tuple(_mount(mount, folder) for mount in entry.get("mounts", ())),
        limits=_limits(entry, where),
        readiness=_readiness(entry["ready"], f"{where}.ready") if "ready" in entry else None,
        after=tuple(entry.get("after", ())),
        essential=entry.get("essential", True),
        success=tuple(success) if isinstance(success, list) else (success,),
        artifacts=tuple(
            Artifact(item) if isinstance(item, str) else Artifact(**item) for item in entry.get("artifacts", ())
        ),
        relaxations=Relaxations(
            new_privileges=entry.get("new-privileges", False),
            capabilities=tuple(entry.get("capabilities", ())),
            devices=tuple(entry.get("devices", ())),
            gpus=entry.get("gpus", False),
            docker_socket=entry.get("docker-socket", False),
            privileged=entry.get("privileged", False),
        ),
    )


@cache
def _closed_schema() -> dict[str, Any]:
    """That of a container, with no other keys: where it is referred to, keys may be added."""
    return {"$ref": "#/$defs/container", "unevaluatedProperties": False, "$defs": bundled(SCHEMA)["$defs"]}


def _text(value: str | float) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _secrets(entry: Mapping[str, Any], environment: Mapping[str, str], where: str) -> dict[str, str]:
    for name in entry.get("secrets", ()):
        if not environment.get(name):
            raise InputError(f"{where}.secrets: the environment variable {name} is not set")
    return {name: environment[name] for name in entry.get("secrets", ())}


def _entrypoint(entry: Mapping[str, Any], where: str) -> tuple[str, ...] | None:
    given = entry.get("entrypoint")
    if given is None or given == []:
        return None if given is None else ()
    return split_command(given, f"{where}.entrypoint")


def _mount(entry: str | Mapping[str, Any], folder: Path) -> Mount:
    if isinstance(entry, str):
        source, target = entry.removesuffix(":ro").split(":")
        return Mount(folder / source, target)
    return Mount(folder / entry["source"], entry["target"], entry.get("writable", False))


def _limits(entry: Mapping[str, Any], where: str) -> Limits:
    return Limits(
        memory=parse_bytes(entry["memory"], f"{where}.memory") if "memory" in entry else None,
        cpus=entry.get("cpus"),
        processes=entry.get("processes", Limits.processes),
        seconds=parse_seconds(entry["timeout"], f"{where}.timeout") if "timeout" in entry else None,
    )


def _readiness(entry: Mapping[str, Any], where: str) -> Readiness:
    return Readiness(
        port=entry.get("port"),
        log=entry.get("log"),
        file=entry.get("file"),
        command=split_command(entry["command"], f"{where}.command") if "command" in entry else (),
        seconds=parse_seconds(entry["timeout"], f"{where}.timeout") if "timeout" in entry else Readiness.seconds,
    )
