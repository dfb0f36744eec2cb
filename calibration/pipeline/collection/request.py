"""What is to be collected: a dataset, or many, by our own simulation or by the team's applications."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from calibration.pipeline.collection.applications import SECONDS, Applications
from calibration.records import at_least, between, field, record

MAX_SCENARIOS = 100_000


Share = Annotated[float, between(0, 1)]


@record
class CollectionChecks:
    """What a collected dataset has to keep to; None where there is no limit."""

    minimum_collections: Annotated[int, at_least(1)] = field(
        "Fewer make it fail.", default=3, option="Fewer collections that are kept make it fail (3)."
    )
    minimum_detection_rate: Share | None = field("Share of the poses that every sensor detects, 0 to 1.", default=None)
    minimum_coverage: Share | None = field("Share of every image that the corners cover, 0 to 1.", default=None)
    max_translation_mm: float | None = 5.0
    """Of the worst sensor against the truth, and of the worst length of a joint."""
    max_rotation_deg: float | None = 0.3
    """Likewise, of the worst angle."""


@dataclass(frozen=True)
class ScenarioOfSet:
    """One scenario of a scenario set."""

    scenario_set: Path
    id: str


@dataclass(frozen=True)
class CollectionRequest:
    """What our own simulation is to collect."""

    system: Path
    """The folder of a system."""
    robot: Path | None = None
    """Another robot description than the system's."""
    configuration: Path | None = None
    """Another calibration configuration than the system's."""
    motion: str | None = None
    """A file, or ``generate:N``; the system's own motion where None."""
    seed: int = 1
    """Of the noise and of a generated motion, or of the scenarios."""
    stillness: float | None = None
    """How far a pattern may move while the sensors look, m; None for the usual."""
    checks: CollectionChecks = dataclasses.field(default_factory=CollectionChecks)
    scenario: ScenarioOfSet | None = None
    """None for the scenario that the system's files describe."""


@dataclass(frozen=True)
class ContainerRequest:
    """What the team's applications are to collect."""

    name: str
    applications: Applications
    system: Path | None = None
    """The folder of a system: its sensors are expected in the dataset, and its robot is the truth."""
    robot: Path | None = None
    configuration: Path | None = None
    motion: str | None = None
    """A file, or ``generate:N``; the system's own motion where None."""
    seed: int = 1
    checks: CollectionChecks = dataclasses.field(default_factory=CollectionChecks)
    truth: str | None = None
    """As `calibration.dataset.truth.choose_truth`; None for the system's, where there is one."""
    scenario: int = 0
    """The number of the collection among those of the seed."""


@dataclass(frozen=True)
class ScenarioImage:
    """An image with this package, in which scenarios of our own simulation run."""

    image: str
    seconds: float = SECONDS
    """A scenario that takes longer is stopped."""


@dataclass(frozen=True)
class ScenarioRequest:
    """Many datasets."""

    collection: CollectionRequest | ContainerRequest
    """The system, the seed of the scenarios, and what each of them has to keep to; a motion, if all have the same."""
    scenario_set: Path | None
    """Of our own simulation's scenarios; None for the team's applications, which know themselves what varies."""
    count: int
    minimum_success_rate: float = 1.0
    """The share of the scenarios that has to pass."""
    applications: tuple[str, ...] = ()
    """The options of the command that say what the team's applications are."""
    image: ScenarioImage | None = None
    """None to run our own simulation's scenarios in processes here."""
