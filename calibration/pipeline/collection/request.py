"""Requests of a collection: a dataset, or many, by our own simulation or by the team's applications."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from calibration.base.records import at_least, between, field, record
from calibration.pipeline.collection.applications import SECONDS, Applications

MAX_SCENARIOS = 100_000


Share = Annotated[float, between(0, 1)]


@record
class CollectionChecks:
    """Limits for a collected dataset; None for no limit."""

    minimum_collections: Annotated[int, at_least(1)] = field(
        "Fewer make it fail.", default=3, option="Fewer collections that are kept make it fail (3)."
    )
    minimum_detection_rate: Share | None = field("Share of the poses that every sensor detects, 0 to 1.", default=None)
    minimum_coverage: Share | None = field("Share of every image that the corners cover, 0 to 1.", default=None)
    max_translation_mm: float | None = 5.0
    """Largest error of a sensor against the truth, and of a joint's length."""
    max_rotation_deg: float | None = 0.3
    """Likewise for rotations and angles."""


@dataclass(frozen=True)
class ScenarioOfSet:
    """Scenario of a scenario set."""

    scenario_set: Path
    id: str


@dataclass(frozen=True)
class CollectionRequest:
    """Request of a collection by our own simulation."""

    system: Path
    """Folder of a system."""
    robot: Path | None = None
    """Robot description that replaces the system's."""
    configuration: Path | None = None
    """Calibration configuration that replaces the system's."""
    motion: str | None = None
    """A file, or ``generate:N``; None for the system's own motion."""
    seed: int = 1
    """Seed of the noise and of a generated motion, or of the scenarios."""
    stillness: float | None = None
    """Limit of a pattern's motion while the sensors measure, m; None for the default."""
    checks: CollectionChecks = dataclasses.field(default_factory=CollectionChecks)
    scenario: ScenarioOfSet | None = None
    """Scenario that changes the system; None for the system as described."""


@dataclass(frozen=True)
class ContainerRequest:
    """Request of a collection by the team's applications."""

    name: str
    applications: Applications
    system: Path | None = None
    """Folder of a system: its sensors are expected in the dataset, and its robot is the truth."""
    robot: Path | None = None
    configuration: Path | None = None
    motion: str | None = None
    """A file, or ``generate:N``; None for the system's own motion."""
    seed: int = 1
    checks: CollectionChecks = dataclasses.field(default_factory=CollectionChecks)
    truth: str | None = None
    """Choice of the truth, see `truth.choose_truth`; None for the system's, if there is one."""
    scenario: int = 0
    """Number of the collection among those of the seed."""


@dataclass(frozen=True)
class ScenarioImage:
    """Image with this package, for scenarios of our own simulation."""

    image: str
    seconds: float = SECONDS
    """Time limit of a scenario."""


@dataclass(frozen=True)
class ScenarioRequest:
    """Request of many datasets."""

    collection: CollectionRequest | ContainerRequest
    """The system, the seed of the scenarios, and their requirements; a motion, if it is the same for all."""
    scenario_set: Path | None
    """Scenario set of our own simulation; None for the team's applications, which define their own variations."""
    count: int
    minimum_success_rate: float = 1.0
    """Minimum share of scenarios that pass."""
    applications: tuple[str, ...] = ()
    """Options of the command that describe the team's applications."""
    image: ScenarioImage | None = None
    """Image that runs the scenarios in containers; None to run them with our own simulation in local processes."""
