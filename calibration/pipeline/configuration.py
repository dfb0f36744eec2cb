"""What ``calibration.yml`` says; its JSON Schema is ``calibration.schema.json`` beside this module."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calibration.errors import InputError
from calibration.execution.backends import AWS_BATCH, CONTAINERS, DOCKER, EMBEDDED, Place
from calibration.execution.batch.settings import SECTION, BatchSettings, settings_from
from calibration.image.specification import ImageSpecification, parse_image_specification
from calibration.introspection.rule_set import parse_rules
from calibration.json_schema import bundled, check_document
from calibration.pipeline.collection.applications import Applications, applications_from
from calibration.pipeline.collection.request import GENERATE, CollectionRequest, ContainerRequest
from calibration.pipeline.collection.results import CollectionChecks
from calibration.pipeline.matrix.software import software_from
from calibration.pipeline.system import Limits, Loss, NoiseGrid, Start, System, seed_range
from calibration.variables import with_variables
from calibration.workflow.text import did_you_mean
from calibration.yaml_file import read_yaml

SCHEMA = Path(__file__).with_name("calibration.schema.json")
ADVICE = {
    "not": "seeds and seed-list exclude each other",
    "anyOf": "expected systems to calibrate, or a simulation to collect data from",
    "simulation anyOf": "expected a system, or containers that simulate and collect",
    "oneOf": "this has none of the forms that are known: see `calibration schema`",
}
DEFAULT_FILE = Path("calibration.yml")
COLLECTED = "simulation:"
"""Begins a system's dataset that an entry of ``simulation`` collects."""


@dataclass(frozen=True)
class Simulation:
    """A dataset to collect in simulation, and to calibrate."""

    name: str
    request: CollectionRequest | ContainerRequest
    """For our own simulation, or for the team's applications."""
    backend: str = EMBEDDED
    """Where it runs."""


@dataclass(frozen=True)
class Configuration:
    """A whole pipeline."""

    systems: tuple[System, ...]
    noise: NoiseGrid = field(default_factory=NoiseGrid)
    start: Start = "linear"
    loss: Loss = "huber"
    simulations: tuple[Simulation, ...] = ()
    image: ImageSpecification | None = None
    backend: str = DOCKER
    """Where the team's software runs, and applications that say nothing else."""
    batch: BatchSettings | None = None
    """What AWS Batch has to know."""

    @property
    def place(self) -> Place:
        """Where the team's software runs."""
        return Place(self.backend, self.batch)

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
    batch, image = None, None
    if isinstance(document, dict) and "image" in document:  # first, since it says more of what is wrong
        document["image"] = with_variables(document["image"], f"{path}: image", environment)
        image = parse_image_specification(document["image"], path.parent, f"{path}: image")
    if isinstance(document, dict) and SECTION in document:
        document[SECTION] = with_variables(document[SECTION], f"{path}: {SECTION}", environment)
        batch = settings_from(document[SECTION], f"{path}: {SECTION}")
    check_document(document, bundled(SCHEMA), str(path), ADVICE)
    assert isinstance(document, dict)  # noqa: S101 (the schema says so)
    document = {key: with_variables(value, f"{path}: {key}", environment) for key, value in document.items()}
    common = document.get("limits")
    backend = document.get("backend", DOCKER)
    entries = document.get("simulation", {})
    simulations = tuple(_simulation(name, entry, path, backend) for name, entry in entries.items())
    configuration = Configuration(
        systems=tuple(_system(name, entry, common, path) for name, entry in document.get("systems", {}).items()),
        noise=_noise(document.get("noise", {})),
        start=document.get("start", "linear"),
        loss=document.get("loss", "huber"),
        simulations=simulations,
        image=image,
        backend=backend,
        batch=batch,
    )
    _check_references(configuration, path)
    return configuration


def _check_references(configuration: Configuration, path: Path) -> None:
    """Refuse a system whose dataset nothing collects, a container without an image, and a cloud without a place in it.

    Raises:
        InputError: naming it.
    """
    if configuration.batch is None:
        wanting = [f"simulation.{each.name}.backend" for each in configuration.simulations if each.backend == AWS_BATCH]
        for key in ["backend"] if configuration.backend == AWS_BATCH else wanting:
            raise InputError(f"{path}: {key}: found {AWS_BATCH}, but there is no section {SECTION}")
    collected = {simulation.name for simulation in configuration.simulations}
    for system in configuration.systems:
        where = f"{path}: systems.{system.name}"
        if system.collected is not None and system.collected not in collected:
            raise InputError(
                f"{where}.dataset: simulation has no entry '{system.collected}'"
                f"{did_you_mean(system.collected, collected)}"
            )
        if configuration.image is None and system.software is not None and not system.software.container.image:
            raise InputError(f"{where}.software: missing image, as there is no section image that builds one")
    for simulation in configuration.simulations:
        request = simulation.request
        for container in request.applications.containers if isinstance(request, ContainerRequest) else ():
            if configuration.image is None and not container.image:
                where = f"{path}: simulation.{simulation.name}.containers.{container.name}"
                raise InputError(f"{where}: missing image, as there is no section image that builds one")


def parse_applications(entry: Mapping[str, Any], folder: Path, where: str) -> Applications:
    """Read a description of applications from outside a configuration: an entry of ``simulation`` in it.

    Raises:
        InputError: it does not follow the schema; names the key.
    """
    schema = bundled(SCHEMA)
    check_document(entry, {**schema["$defs"]["simulation"], "$defs": schema["$defs"]}, where, ADVICE)
    return applications_from(with_variables(entry, where), folder, where)


def _system(name: str, entry: Mapping[str, Any], common_limits: Mapping[str, float] | None, path: Path) -> System:
    place = entry["dataset"]
    return System(
        name=name,
        dataset=path.parent / place,
        evaluate=entry.get("evaluate"),
        truth=_truth(entry, path),
        compare=tuple(entry.get("compare", ())),
        rules=parse_rules(entry["rules"], f"{path}: systems.{name}.rules") if "rules" in entry else None,
        limits=Limits(**{key.replace("-", "_"): v for key, v in (entry.get("limits") or common_limits or {}).items()}),
        software=software_from(entry["software"], path.parent, f"{path}: systems.{name}.software")
        if "software" in entry
        else None,
        intrinsics=tuple(entry.get("intrinsics", ())),
        intrinsics_covariance=path.parent / entry["intrinsics-covariance"]
        if "intrinsics-covariance" in entry
        else None,
        hold=tuple(entry.get("hold", ())),
        collected=place.removeprefix(COLLECTED) if place.startswith(COLLECTED) else None,
    )


def _simulation(name: str, entry: Mapping[str, Any], path: Path, containers: str) -> Simulation:
    where = f"{path}: simulation.{name}"
    motion = entry.get("motion")
    if motion is not None and not motion.startswith(GENERATE):
        motion = str(path.parent / motion)
    backend = entry.get("backend", containers if "containers" in entry else EMBEDDED)
    if (backend in CONTAINERS) != ("containers" in entry):
        raise InputError(
            f"{where}.backend: found {backend}; "
            f"containers run with {' or '.join(CONTAINERS)}, and these need containers"
        )
    robot = path.parent / entry["robot"] if "robot" in entry else None
    configuration = path.parent / entry["config"] if "config" in entry else None
    system = path.parent / entry["system"] if "system" in entry else None
    seed, checks = entry.get("seed", 1), _checks(entry)
    if "containers" not in entry:
        if system is None:
            raise AssertionError("the schema asks for a system")
        return Simulation(name, CollectionRequest(system, robot, configuration, motion, seed, None, checks))
    applications = applications_from(entry, path.parent, where)
    truth = _truth(entry, path)
    request = ContainerRequest(name, applications, system, robot, configuration, motion, seed, checks, truth)
    return Simulation(name, request, backend)


def _checks(entry: Mapping[str, Any]) -> CollectionChecks:
    limits = {f"max_{key.replace('-', '_')}": value for key, value in entry.get("limits", {}).items()}
    if entry.get("truth") == "none":
        limits = {"max_translation_mm": None, "max_rotation_deg": None, **limits}
    least = {key.replace("-", "_"): value for key, value in entry.items() if key.startswith("minimum-")}
    return CollectionChecks(**limits, **least)


def _truth(entry: Mapping[str, Any], path: Path) -> str | None:
    truth: str | None = entry.get("truth")
    return truth if truth in (None, "dataset", "none") else str(path.parent / str(truth))


def _noise(entry: Mapping[str, Any]) -> NoiseGrid:
    return NoiseGrid(
        translations=tuple(float(t) for t in entry.get("translation", (0.0,))),
        rotations=tuple(float(r) for r in entry.get("rotation", (0.0,))),
        seeds=tuple(entry["seed-list"]) if "seed-list" in entry else seed_range(entry.get("seeds", 1)),
    )
