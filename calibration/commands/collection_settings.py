"""What ``collect-data-sim`` is asked."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.commands.system_folder import system_folder
from calibration.pipeline.collection.collecting import CollectionRequest
from calibration.pipeline.collection.results import CollectionChecks
from calibration.simulation.collection.checks import Requirements


@dataclass(frozen=True)
class Settings:
    """What ``collect-data-sim`` is asked; what is None is as `CollectionChecks` and `Requirements` say."""

    system: str
    """The name of a system in `SYSTEMS`, or a folder."""
    output: Path
    robot: Path | None = None
    config: Path | None = None
    motion: str | None = None
    """A file, or ``generate:N``; the system's own motion where None."""
    scenarios: int | None = None
    """How many worlds of the scenario set; None for the one that the system's files describe."""
    scenario_set: Path | None = None
    scenario: str | None = None
    """The id of one world of the scenario set, to collect it alone."""
    minimum_success_rate: float = 1.0
    seed: int = 1
    minimum_collections: int | None = None
    minimum_detection_rate: float | None = None
    minimum_coverage: float | None = None
    max_translation_mm: float | None = None
    max_rotation_deg: float | None = None
    stillness_mm: float | None = None
    backend: str | None = None
    """None for docker where there are applications, else embedded."""
    aws_batch: Path | None = None
    """The file with the section aws-batch; calibration.yml where None."""
    run: str | None = None
    """The name of the run, for those who look for what it left."""
    resume: bool = False
    """Whether only what is missing of an earlier run is run."""
    applications: Path | None = None
    """What an entry ``simulation`` of calibration.yml says of containers, in a file of its own."""
    image: str | None = None
    """Of applications that name none; or, with a scenario set, of the worlds: it has calibration-ci."""
    simulation_command: str | None = None
    robot_command: str | None = None
    player: str | None = None
    ros: str | None = None
    truth: str | None = None
    timeout: str | None = None
    jobs: int | None = None
    overwrite: bool = False


def collection_request(settings: Settings) -> CollectionRequest:
    """The collection by our own simulation.

    Raises:
        InputError: there is no such system.
    """
    stillness = None if settings.stillness_mm is None else settings.stillness_mm / 1000
    return CollectionRequest(
        system=system_folder(settings.system),
        robot=settings.robot,
        configuration=settings.config,
        motion=settings.motion,
        seed=settings.seed,
        requirements=Requirements(**_given(stillness=stillness)),
        checks=collection_checks(settings),
    )


def collection_checks(settings: Settings) -> CollectionChecks:
    """What a dataset has to keep to."""
    names = (
        *("minimum_collections", "minimum_detection_rate", "minimum_coverage"),
        *("max_translation_mm", "max_rotation_deg"),
    )
    return CollectionChecks(**_given(**{name: getattr(settings, name) for name in names}))


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}
