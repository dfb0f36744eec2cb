"""What ``calibration.yml`` says; its JSON Schema is ``calibration.schema.json`` beside this module."""

import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from calibration.errors import InputError
from calibration.introspection.parsing import parse_rules
from calibration.introspection.rules import RuleSet
from calibration.pipeline.collection.collecting import GENERATE, CollectionRequest
from calibration.pipeline.collection.results import CollectionChecks
from calibration.workflow.text import did_you_mean, shorten
from calibration.yaml_file import read_yaml

SCHEMA = Path(__file__).with_name("calibration.schema.json")
DEFAULT_FILE = Path("calibration.yml")
Start = Literal["linear", "given"]
Loss = Literal["huber", "linear"]


@dataclass(frozen=True)
class Limits:
    """The largest values that pass; None where there is no limit."""

    rms_px: float | None = None
    translation_mm: float | None = None
    rotation_deg: float | None = None


@dataclass(frozen=True)
class System:
    """A robot to calibrate."""

    name: str
    dataset: Path
    evaluate: str | None = None
    """The table to make, such as ``rgb-to-rgb:right_camera:left_camera``; None for reprojection errors."""
    truth: str | None = None
    """A file, "dataset" or "none"; None for ground_truth.json beside the dataset, where there is one."""
    compare: tuple[str, ...] = ()
    rules: RuleSet | None = None
    limits: Limits = field(default_factory=Limits)


@dataclass(frozen=True)
class Simulation:
    """A dataset to collect in simulation, and to calibrate."""

    name: str
    request: CollectionRequest


@dataclass(frozen=True)
class NoiseGrid:
    """How far the starting guesses are off."""

    translations: tuple[float, ...] = (0.0,)
    """m."""
    rotations: tuple[float, ...] = (0.0,)
    """rad."""
    seeds: tuple[int, ...] = (1,)


@dataclass(frozen=True)
class Configuration:
    """A whole pipeline."""

    systems: tuple[System, ...]
    noise: NoiseGrid = field(default_factory=NoiseGrid)
    start: Start = "linear"
    loss: Loss = "huber"
    simulations: tuple[Simulation, ...] = ()

    def only(self, names: tuple[str, ...]) -> tuple[System, ...]:
        """The systems of these names, or all where there are none.

        Raises:
            InputError: there is no such system.
        """
        known = {system.name: system for system in self.systems}
        for name in names:
            if name not in known:
                raise InputError(
                    f"systems: there is no '{name}'{did_you_mean(name, known)} (known: {', '.join(known)})"
                )
        return tuple(known[name] for name in names) if names else self.systems


def read_configuration(path: Path, environment: Mapping[str, str] | None = None) -> Configuration:
    """Read a pipeline's configuration.

    ``${NAME}`` in a text is replaced by the environment variable of that name. Paths are relative to
    the file.

    Raises:
        InputError: the file is missing, is no YAML, or does not follow its schema; names file and key.
    """
    document = read_yaml(path, "a pipeline configuration")
    _validate(document, path)
    assert isinstance(document, dict)  # noqa: S101 (the schema says so)
    variables = os.environ if environment is None else environment
    document = {key: _prepared(value, variables, f"{path}: {key}") for key, value in document.items()}
    common = document.get("limits")
    return Configuration(
        systems=tuple(_system(name, entry, common, path) for name, entry in document["systems"].items()),
        noise=_noise(document.get("noise", {})),
        start=document.get("start", "linear"),
        loss=document.get("loss", "huber"),
        simulations=tuple(_simulation(name, entry, path) for name, entry in document.get("simulation", {}).items()),
    )


def seed_range(count: int) -> tuple[int, ...]:
    """The seeds 1 to count."""
    return tuple(range(1, count + 1))


def _system(name: str, entry: Mapping[str, Any], common_limits: Mapping[str, float] | None, path: Path) -> System:
    truth = entry.get("truth")
    return System(
        name=name,
        dataset=path.parent / entry["dataset"],
        evaluate=entry.get("evaluate"),
        truth=truth if truth in (None, "dataset", "none") else str(path.parent / truth),
        compare=tuple(entry.get("compare", ())),
        rules=parse_rules(entry["rules"], f"{path}: systems.{name}.rules") if "rules" in entry else None,
        limits=Limits(**{key.replace("-", "_"): v for key, v in (entry.get("limits") or common_limits or {}).items()}),
    )


def _simulation(name: str, entry: Mapping[str, Any], path: Path) -> Simulation:
    motion = entry.get("motion")
    if motion is not None and not motion.startswith(GENERATE):
        motion = str(path.parent / motion)
    limits = {f"max_{key.replace('-', '_')}": value for key, value in entry.get("limits", {}).items()}
    least = {key.replace("-", "_"): value for key, value in entry.items() if key.startswith("minimum-")}
    request = CollectionRequest(
        system=path.parent / entry["system"],
        robot=path.parent / entry["robot"] if "robot" in entry else None,
        configuration=path.parent / entry["config"] if "config" in entry else None,
        motion=motion,
        seed=entry.get("seed", 1),
        checks=CollectionChecks(**limits, **least),
    )
    return Simulation(name, request)


def _noise(entry: Mapping[str, Any]) -> NoiseGrid:
    return NoiseGrid(
        translations=tuple(float(t) for t in entry.get("translation", (0.0,))),
        rotations=tuple(float(r) for r in entry.get("rotation", (0.0,))),
        seeds=tuple(entry["seed-list"]) if "seed-list" in entry else seed_range(entry.get("seeds", 1)),
    )


def _validate(document: object, path: Path) -> None:
    """Hold a document to the schema.

    Raises:
        InputError: one line that names the key, what was found and what is expected.
    """
    import jsonschema  # slow to import, and not needed by the other commands

    schema = json.loads(SCHEMA.read_text())
    errors = sorted(jsonschema.Draft202012Validator(schema).iter_errors(document), key=lambda e: list(map(str, e.path)))
    if not errors:
        return
    error = jsonschema.exceptions.best_match(errors)
    where = ".".join(str(part) for part in error.absolute_path)
    if error.validator == "additionalProperties":
        known = error.schema.get("properties", {})
        unknown = next(key for key in error.instance if key not in known)
        message = f"unknown key '{unknown}'{did_you_mean(str(unknown), known)} (known: {', '.join(known)})"
    elif error.validator == "not":
        message = "seeds and seed-list exclude each other"
    else:
        message = shorten(error.message, 200)
    raise InputError(f"{path}: {where + ': ' if where else ''}{message}")


def _prepared(value: object, environment: Mapping[str, str], where: str) -> Any:
    """The document with ``${NAME}`` replaced in every text; a number that is not finite is refused."""

    def variable(match: re.Match[str]) -> str:
        name = match[1]
        if name not in environment:
            raise InputError(f"{where}: the environment variable {name} is not set")
        return environment[name]

    if isinstance(value, str):
        return re.sub(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}", variable, value)
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where}: found {value}, a finite number was expected")
    if isinstance(value, list):
        return [_prepared(item, environment, f"{where}.{i}") for i, item in enumerate(value)]
    if isinstance(value, dict):
        return {key: _prepared(item, environment, f"{where}.{key}") for key, item in value.items()}
    return value
