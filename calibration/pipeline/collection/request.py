"""Requests of a collection: a dataset, or many, by our own simulation or by the team's applications."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from calibration.base import records
from calibration.base.records import field, record
from calibration.ci.execution.backends import CONTAINER_BACKENDS, BackendName, ContainerBackend, ExecutionTarget
from calibration.engine.diagnosis.limits import Limit
from calibration.pipeline.containers import Applications, Text, checked_applications
from calibration.pipeline.system import Truth
from calibration.robot.simulation.motion import GENERATED_PREFIX

MAX_SCENARIOS = 100_000
KEYS_OF_APPLICATIONS = ("player", "ros", "record", "network", "timeout", "dataset", "image", "truth")
"""Keys that only collections by the team's applications have."""

Share = Annotated[float, records.between(0, 1)]


def _motion_in_folder(text: str, place: records.Place) -> str:
    return text if text.startswith(GENERATED_PREFIX) else str(place.folder / text)


@record(rules=(records.one_of("translation-mm", "rotation-deg", why="expected translation-mm or rotation-deg"),))
class CollectionLimits:
    """Limits of the errors of sensors and joints against the truth."""

    translation_mm: Limit | None = field(
        "Limit of the largest error of a sensor, and of a joint's length, in mm (5).", default=None
    )
    rotation_deg: Limit | None = field("Limit of the largest rotation error, in degrees (0.3).", default=None)


USUAL_LIMITS = CollectionLimits(translation_mm=5.0, rotation_deg=0.3)


@record
class CollectionChecks:
    """Limits for a collected dataset; None for no limit."""

    minimum_collections: Annotated[int, records.at_least(1)] = field(
        "Fewer make it fail.", default=3, option="Fewer collections that are kept make it fail (3)."
    )
    minimum_detection_rate: Share | None = field("Share of the poses that every sensor detects, 0 to 1.", default=None)
    minimum_coverage: Share | None = field("Share of every image that the corners cover, 0 to 1.", default=None)
    limits: CollectionLimits = field(
        "The largest errors of sensors and joints against the truth that pass (5 mm, 0.3 degrees).",
        default_factory=CollectionLimits,
        option=False,
    )

    def with_usual_limits(self) -> "CollectionChecks":
        """Return the checks with `USUAL_LIMITS` in place of limits that are not given."""
        translation, rotation = self.limits.translation_mm, self.limits.rotation_deg
        limits = CollectionLimits(
            USUAL_LIMITS.translation_mm if translation is None else translation,
            USUAL_LIMITS.rotation_deg if rotation is None else rotation,
        )
        return replace(self, limits=limits)


@record(
    rules=(
        records.one_of("system", "containers", why="expected a system, or containers that simulate and collect"),
        *(records.needs(key, "containers") for key in KEYS_OF_APPLICATIONS),
    )
)
class CollectionRequest:
    """Dataset to collect in simulation, and to calibrate."""

    system: Path | None = field(
        "The folder of a system (robot.urdf, config.yml, simulation.yml), relative to this file.",
        default=None,
        option=False,
    )
    """With applications optional: its sensors are expected in the dataset, and its robot is the truth."""
    applications: Applications = field(flat=True, default_factory=Applications)
    """Without containers it is a collection by our own simulation: in local processes, or, with an image that has this
    package, in a container for each scenario."""
    truth: Truth | None = field(
        "What the calibrated dataset is compared with: a file, 'dataset' for the transforms in it, 'none'; by default "
        "the system's.",
        default=None,
        option="Ground truth of the applications' dataset: a file, dataset or none (the system's).",
    )
    backend: BackendName | None = field(
        "embedded: our own simulation. docker, aws-batch: where the containers run; by default where the others do.",
        default=None,
        option=False,
    )
    robot: Path | None = field(
        "Another robot description (URDF or xacro).",
        default=None,
        option="URDF or xacro, in place of the system's robot.urdf.",
    )
    config: Path | None = field(
        "Another calibration configuration.",
        default=None,
        option="ATOM's calibration configuration, in place of the system's config.yml.",
    )
    motion: Annotated[str, records.Converted(Text, _motion_in_folder)] | None = field(
        "A motion sequence (JSON), or generate:N; by default the system's motion.json.",
        default=None,
        option="Motion sequence (JSON), or generate:N; by default the system's motion.json.",
    )
    seed: Annotated[int, records.at_least(0)] = field(
        "Seed of the noise and of a generated motion.",
        default=1,
        option="Seed of the noise, of a generated motion, of the scenarios (1).",
    )
    checks: CollectionChecks = field(flat=True, default_factory=CollectionChecks)
    name: str = ""
    """Name of the entry; by default the system's."""
    stillness: float | None = None
    """Limit of a pattern's motion while the sensors measure, m; None for the default."""
    scenario_set: Path | None = None
    """Scenarios that change the system of our own simulation; None for the system as described."""
    number: int = 0
    """Number of the collection among those of the seed, or of the scenario in the set."""
    target: ExecutionTarget | None = None
    """Execution target of the containers; None for this machine's engine."""

    def checked(self, backend: ContainerBackend, place: records.Place) -> "CollectionRequest":
        """Return the request as it runs; its containers use this backend unless it names its own.

        Raises:
            InputError: the containers are invalid, or there are none for the backend; names the key.
        """
        contained = bool(self.applications.containers)
        found: BackendName = self.backend or (backend if contained else "embedded")
        if (found in CONTAINER_BACKENDS) != contained:
            raise place.below("backend").fault(
                f"found {found}; containers run with {' or '.join(CONTAINER_BACKENDS)}, and these need containers"
            )
        applications = checked_applications(self.applications, place) if contained else self.applications
        return replace(self, applications=applications, backend=found)

    @property
    def effective_checks(self) -> CollectionChecks:
        """Checks of the dataset: with the usual limits, unless there is no truth."""
        return self.checks if self.truth == "none" else self.checks.with_usual_limits()

    @property
    def folder(self) -> Path:
        """Folder of the system, which our own simulation always has."""
        assert self.system is not None  # noqa: S101 (a rule of the record)
        return self.system


@dataclass(frozen=True)
class ScenarioRequest:
    """Request of many datasets."""

    collection: CollectionRequest
    """The system, the scenario set and the seed, and the requirements; a motion, if it is the same for all."""
    count: int
    minimum_success_rate: float = 1.0
    """Minimum share of scenarios that pass."""
    applications: tuple[str, ...] = ()
    """Options of the command that describe the team's applications."""
