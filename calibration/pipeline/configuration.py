"""Configuration of the pipeline, ``calibration.yml``."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from calibration.base.errors import InputError
from calibration.base.records import (
    ByName,
    Converted,
    Place,
    at_least,
    field,
    flat_fields,
    matching,
    needs,
    one_of,
    read,
    record,
)
from calibration.base.text import did_you_mean
from calibration.base.variables import with_variables
from calibration.base.yaml_file import read_yaml
from calibration.ci.execution.backends import (
    CONTAINERS,
    SECTIONS,
    BackendName,
    ContainerBackend,
    ExecutionTarget,
    Sections,
)
from calibration.ci.image.specification import ImageDocument, ImageSpecification, parse_image_specification
from calibration.engine.baseline.settings import FILE, BaselineSettings
from calibration.engine.diagnosis.limits import Limit, Limits
from calibration.engine.estimation.solve.options import Options
from calibration.pipeline.collection.applications import Applications, checked_applications
from calibration.pipeline.collection.request import CollectionChecks, CollectionRequest, ContainerRequest
from calibration.pipeline.system import (
    Exports,
    Noise,
    NoiseGrid,
    System,
    Text,
    Truth,
    Undecided,
    chosen_systems,
)
from calibration.robot.simulation.motion.sequence import GENERATED_PREFIX

DEFAULT_FILE = Path("calibration.yml")
_NAME = matching("[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", "letters, digits and _ . -, at most 64 of them")
_OF_CONTAINERS = ("player", "ros", "network", "timeout", "dataset", "image", "truth")


def _motion(text: str, place: Place) -> str:
    return text if text.startswith(GENERATED_PREFIX) else str(place.folder / text)


def _image(document: object, place: Place) -> ImageSpecification:
    return parse_image_specification(document, place.folder, str(place))


def _baseline(found: Literal["required"] | BaselineSettings, place: Place) -> BaselineSettings:
    if isinstance(found, BaselineSettings):
        return found
    return BaselineSettings(file=place.folder / FILE, required=True)


@record(rules=(one_of("translation-mm", "rotation-deg", why="expected translation-mm or rotation-deg"),))
class CollectionLimits:
    """Limits of the errors of sensors and joints against the truth."""

    translation_mm: Limit | None = field(
        "Limit of the largest error of a sensor, and of a joint's length, in mm (5).", default=None
    )
    rotation_deg: Limit | None = field("Limit of the largest rotation error, in degrees (0.3).", default=None)


@record(
    rules=(
        one_of("system", "containers", why="expected a system, or containers that simulate and collect"),
        *(needs(key, "containers") for key in _OF_CONTAINERS),
    )
)
class Simulation:
    """Dataset to collect in simulation, and to calibrate."""

    name: str
    system: Path | None = field(
        "The folder of a system (robot.urdf, config.yml, simulation.yml), relative to this file.", default=None
    )
    applications: Applications = field(flat=True, default_factory=Applications)
    truth: Truth | None = field(
        "What the calibrated dataset is compared with: a file, 'dataset' for the transforms in it, 'none'; by default "
        "the system's.",
        default=None,
    )
    backend: BackendName | None = field(
        "embedded: our own simulation. docker, aws-batch: where the containers run; by default where the others do.",
        default=None,
    )
    robot: Path | None = field("Another robot description (URDF or xacro).", default=None)
    config: Path | None = field("Another calibration configuration.", default=None)
    motion: Annotated[str, Converted(Text, _motion)] | None = field(
        "A motion sequence (JSON), or generate:N; by default the system's motion.json.", default=None
    )
    seed: Annotated[int, at_least(0)] = field("Seed of the noise and of a generated motion.", default=1)
    checks: CollectionChecks = field(flat=True, default_factory=CollectionChecks)
    limits: CollectionLimits = field(
        "The largest errors of sensors and joints against the truth that pass (5 mm, 0.3 degrees).",
        default_factory=CollectionLimits,
    )

    def checked(self, backend: ContainerBackend, place: Place) -> "Simulation":
        """Return the simulation as it runs; its containers use this backend unless it names its own.

        Raises:
            InputError: the containers are invalid, or there are none for the backend; names the key.
        """
        contained = bool(self.applications.containers)
        found: BackendName = self.backend or (backend if contained else "embedded")
        if (found in CONTAINERS) != contained:
            raise place.below("backend").fault(
                f"found {found}; containers run with {' or '.join(CONTAINERS)}, and these need containers"
            )
        applications = checked_applications(self.applications, place) if contained else self.applications
        return replace(self, applications=applications, backend=found)

    @property
    def request(self) -> CollectionRequest | ContainerRequest:
        """Return the request for our own simulation, or for the team's applications."""
        usual = (None, None) if self.truth == "none" else (self.checks.max_translation_mm, self.checks.max_rotation_deg)
        given = (self.limits.translation_mm, self.limits.rotation_deg)
        mm, deg = (limit if limit is not None else other for limit, other in zip(given, usual, strict=True))
        checks = replace(self.checks, max_translation_mm=mm, max_rotation_deg=deg)
        files = (self.robot, self.config, self.motion, self.seed)
        if self.applications.containers:
            return ContainerRequest(self.name, self.applications, self.system, *files, checks, self.truth)
        assert self.system is not None  # noqa: S101 (a rule of the record)
        return CollectionRequest(self.system, *files, checks=checks)


@record(
    rules=(one_of("systems", "simulation", why="expected systems to calibrate, or a simulation to collect data from"),)
)
class Configuration:
    """Configuration of Calibration CI for this repository."""

    image: Annotated[ImageSpecification, Converted(dict, _image, described_as=ImageDocument)] | None = field(
        "The image with the team's software: built when something changed, pushed, and given its release tags when "
        "the verdict is pass.",
        default=None,
    )
    noise: Annotated[NoiseGrid, Converted(Noise, lambda noise, _: noise.grid())] = field(
        "Noise of the initial guesses: every combination is one cell of the matrix.", default=NoiseGrid()
    )
    options: Options = field(flat=True, default_factory=Options)
    """Default options of all systems; the systems have their own fields too."""
    limits: Limits | None = field("For every system that has none of its own.", default=None)
    undecided: Undecided = field(
        "What an undecided verdict counts as, for every system that has no rule of its own: fail or pass.",
        default="fail",
    )
    backend: ContainerBackend = field(
        "Where containers run: docker, this machine's engine; or aws-batch, the queue that the section of this name "
        "describes.",
        default="docker",
    )
    exports: Exports | None = field("For every system that has none of its own.", default=None)
    baseline: Annotated[BaselineSettings, Converted(Literal["required"] | BaselineSettings, _baseline)] = field(
        "The accepted calibration that every cell is compared with; required: a system that has none fails.",
        default_factory=BaselineSettings,
    )
    sections: Sections = field(flat=True, default_factory=Sections)
    systems: Annotated[tuple[System, ...], ByName(_NAME)] = field("The robots to calibrate, by name.", default=())
    simulations: Annotated[tuple[Simulation, ...], ByName(_NAME)] = field(
        "Datasets to collect in simulation and to calibrate, by name.", default=(), key="simulation"
    )

    @property
    def target(self) -> ExecutionTarget:
        """Execution target of the team's software."""
        return ExecutionTarget(self.backend, self.sections)

    def only(self, names: tuple[str, ...]) -> tuple[System, ...]:
        """Return the systems of these names, or all; see `chosen_systems`."""
        return chosen_systems(self.systems, names)


def read_configuration(path: Path, environment: Mapping[str, str] | None = None) -> Configuration:
    """Read a pipeline's configuration.

    ``${NAME}`` in a text is replaced by the environment variable of that name. Paths are relative to
    the file.

    Raises:
        InputError: the file is missing, is not YAML, or a key or a value is wrong; names file and key.
    """
    document = read_yaml(path, "a pipeline configuration (calibration init writes one)")
    if isinstance(document, dict):
        document = {key: with_variables(value, f"{path}: {key}", environment) for key, value in document.items()}
        document = _with_common(document)
    found = read(Configuration, document, str(path), path.parent)
    place = Place(str(path), ("simulation",), path.parent)
    simulations = (each.checked(found.backend, place.below(each.name)) for each in found.simulations)
    baseline = found.baseline
    if baseline.file == Path(FILE):  # by default beside the configuration
        baseline = replace(baseline, file=path.parent / FILE)
    configuration = replace(found, simulations=tuple(simulations), baseline=baseline)
    _check_references(configuration, path)
    return configuration


def _with_common(document: dict[Any, Any]) -> dict[Any, Any]:
    """Return the document with the top-level defaults copied to the systems that do not override them."""
    systems = document.get("systems")
    if not isinstance(systems, dict):
        return document
    common = {
        key: document[key] for key in (*flat_fields(Options), "limits", "undecided", "exports") if key in document
    }
    merged = {name: {**common, **entry} if isinstance(entry, dict) else entry for name, entry in systems.items()}
    return {**document, "systems": merged}


def _check_references(configuration: Configuration, path: Path) -> None:
    """Refuse a system whose dataset is not collected, a container without an image, and a cloud without its settings.

    Raises:
        InputError: names it.
    """
    wanted: dict[str, str] = {"backend": configuration.backend}
    wanted |= {f"simulation.{each.name}.backend": each.backend or "" for each in configuration.simulations}
    for key, backend in wanted.items():
        if backend in SECTIONS and configuration.sections.of(backend) is None:
            raise InputError(f"{path}: {key}: found {backend}, but there is no section {backend}")
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
        for container in simulation.applications.containers:
            if configuration.image is None and not container.image:
                where = f"{path}: simulation.{simulation.name}.containers.{container.name}"
                raise InputError(f"{where}: missing image, as there is no section image that builds one")


def parse_applications(entry: Mapping[str, Any], folder: Path, where: str) -> Applications:
    """Parse applications from outside a configuration, in the form of an entry of ``simulation``.

    Raises:
        InputError: a key or a value is wrong; names the key.
    """
    found = read(Simulation, with_variables(entry, where), where, folder, name="applications")
    return checked_applications(found.applications, Place(where))
