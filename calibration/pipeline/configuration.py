"""Configuration of the pipeline, ``calibration.yml``."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from calibration.base import InputError, did_you_mean, read_yaml, with_variables
from calibration.base.records import ByName, Converted, Place, field, flat_fields, matching, one_of, read, record
from calibration.ci.execution.backends import SECTIONS, ContainerBackend, ExecutionTarget, Sections
from calibration.ci.image.specification import ImageDocument, ImageSpecification, parse_image_specification
from calibration.engine.baseline.quality import BASELINE_FILE, BaselineSettings
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.options import Options
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.repetition.repetition import Repetitions
from calibration.pipeline.system import Exports, Noise, NoiseGrid, System, Undecided, chosen_systems

DEFAULT_FILE = Path("calibration.yml")
_NAME_PATTERN = matching("[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", "letters, digits and _ . -, at most 64 of them")


def _image_from(document: object, place: Place) -> ImageSpecification:
    return parse_image_specification(document, place.folder, str(place))


def _baseline_from(found: Literal["required"] | BaselineSettings, place: Place) -> BaselineSettings:
    if isinstance(found, BaselineSettings):
        return found
    return BaselineSettings(file=place.folder / BASELINE_FILE, required=True)


@record(
    rules=(one_of("systems", "simulation", why="expected systems to calibrate, or a simulation to collect data from"),)
)
class PipelineConfiguration:
    """Configuration of Calibration CI for this repository."""

    image: Annotated[ImageSpecification, Converted(dict, _image_from, described_as=ImageDocument)] | None = field(
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
    baseline: Annotated[BaselineSettings, Converted(Literal["required"] | BaselineSettings, _baseline_from)] = field(
        "The accepted calibration that every cell is compared with; required: a system that has none fails.",
        default_factory=BaselineSettings,
    )
    repetitions: Repetitions = field(flat=True, default_factory=Repetitions)
    sections: Sections = field(flat=True, default_factory=Sections)
    systems: Annotated[tuple[System, ...], ByName(_NAME_PATTERN)] = field(
        "The robots to calibrate, by name.", default=()
    )
    simulations: Annotated[tuple[CollectionRequest, ...], ByName(_NAME_PATTERN)] = field(
        "Datasets to collect in simulation and to calibrate, by name.", default=(), key="simulation"
    )

    @property
    def target(self) -> ExecutionTarget:
        """Execution target of the team's software."""
        return ExecutionTarget(self.backend, self.sections)

    def only(self, names: tuple[str, ...]) -> tuple[System, ...]:
        """Return the systems of these names, or all; see `chosen_systems`."""
        return chosen_systems(self.systems, names)


def read_configuration(path: Path, environment: Mapping[str, str] | None = None) -> PipelineConfiguration:
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
    found = read(PipelineConfiguration, document, str(path), path.parent)
    place = Place(str(path), ("simulation",), path.parent)
    simulations = (each.checked(found.backend, place.below(each.name)) for each in found.simulations)
    baseline = found.baseline
    if baseline.file == Path(BASELINE_FILE):  # by default beside the configuration
        baseline = replace(baseline, file=path.parent / BASELINE_FILE)
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


def _check_references(configuration: PipelineConfiguration, path: Path) -> None:
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
