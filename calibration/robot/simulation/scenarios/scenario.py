"""Scenario: a variation of a described system, its reproducible id, and its result."""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from calibration import __version__
from calibration.base import InputError, one_line, shorten
from calibration.base.records import Converted, Place, between, field, length, matching, record
from calibration.robot.simulation.motion.sequence import Motion, motion_document
from calibration.robot.simulation.random_streams import stream
from calibration.robot.simulation.system import System

MAX_SEED = 2**53
"""Limit of a seed, so that it is exact in JSON."""
_SCENARIO_ID = re.compile(r"s(0|[1-9][0-9]{0,15})-([0-9]{5,8})")
_HASH_DIGITS = 12
_LONGEST_LINE = 1000


@dataclass(frozen=True)
class Scenario:
    """Parameters of a scenario, drawn from its seed and index alone."""

    seed: int
    index: int
    """Index, from 0."""
    values: Mapping[str, float]
    """Values by the parameter's name (`calibration.robot.simulation.scenarios.scenario_set`)."""
    attempt: int = 0
    """Number of previous draws that broke a constraint."""

    @property
    def id(self) -> str:
        """Id, such as "s1-00017": seed 1, index 17."""
        return scenario_id(self.seed, self.index)

    @property
    def collection_seed(self) -> int:
        """Seed of its sensor data and of a motion that is generated for it."""
        return int(self.random("collection").integers(MAX_SEED))

    def random(self, *purpose: str | int) -> np.random.Generator:
        """Return random numbers for one purpose in this scenario."""
        return stream(self.seed, "scenario", self.index, self.attempt, *purpose)


def scenario_id(seed: int, index: int) -> str:
    """Format the id of a scenario."""
    return f"s{seed}-{index:05d}"


def parse_id(text: str) -> tuple[int, int]:
    """Parse an id to the seed and the index.

    Raises:
        InputError: it is not an id.
    """
    match = _SCENARIO_ID.fullmatch(text)
    seed, index = (int(match[1]), int(match[2])) if match else (-1, -1)
    if not 0 <= seed < MAX_SEED or scenario_id(seed, index) != text:
        raise InputError(f"scenario: found '{text}', expected an id such as s1-00017 (seed 1, index 17)")
    return seed, index


def content_hash(system: System, scenario: Scenario, motion: Motion | None = None) -> str:
    """Return a hash that identifies a scenario: 12 hexadecimal digits of a SHA-256.

    It covers the scenario's id and values, the system's files, the motion if one is given, and the version
    of this package. Other content of a scenario set, such as its formatting, has no effect.
    """
    content = {
        "version": __version__,
        "system": {name: hashlib.sha256(data).hexdigest() for name, data in system.sources.items()},
        "motion": None if motion is None else motion_document(motion),
        "scenario": scenario.id,
        "attempt": scenario.attempt,
        "values": dict(scenario.values),
    }
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH_DIGITS]


Amount = Annotated[float, between(0, 1e300)]


def _as_short_lines(lines: tuple[str, ...], _: Place) -> tuple[str, ...]:
    return tuple(shorten(one_line(line), _LONGEST_LINE) for line in lines)


Lines = Annotated[
    tuple[str, ...],
    Converted(Annotated[tuple[Annotated[str, length(most=10_000)], ...], length(most=1000)], _as_short_lines),
]
"""Texts from untrusted sources, made safe to print."""


def _as_lost_poses(lost: Mapping[str, tuple[str, ...]], _: Place) -> Mapping[str, tuple[str, ...]]:
    return {one_line(pose): reasons for pose, reasons in lost.items()}


@record(case="snake", nulls=True)
class ScenarioResult:
    """Result of one scenario. Numbers are None if not available."""

    id: Annotated[str, matching("s(0|[1-9][0-9]{0,15})-[0-9]{5,8}", "an id such as s1-00017")] = field(
        "Its seed and index: s1-00017."
    )
    hash: Annotated[str, matching("[0-9a-f]{12}", "12 hexadecimal digits")] = field(
        "Of its content: equal scenarios have equal hashes."
    )
    values: Mapping[str, float] = field("Its parameters.")
    poses: Annotated[int, between(0, 100_000)] = field("Of its motion; 0 where none was found.", default=0)
    lost: (
        Annotated[
            Mapping[str, tuple[str, ...]],
            Converted(
                Annotated[Mapping[Annotated[str, length(most=100)], Lines], length(most=100_000)], _as_lost_poses
            ),
        ]
        | None
    ) = field("The poses that gave no collection, by key, and why.", default=None)
    detection: (
        Annotated[
            Mapping[Annotated[str, length(most=200)], Annotated[float, between(0, 1)]],
            length(most=1000),
        ]
        | None
    ) = field("The share of the poses at which each sensor detects a pattern.", default=None)
    corner_rms_px: Amount | None = field("Detected corners against the true ones.", default=None, unit="px")
    converged: bool = field("Whether there is a calibration.", default=False)
    rms_px: Amount | None = field("RMS of the reprojection errors.", default=None, unit="px")
    translation_mm: Amount | None = field(
        "The worst error of a calibrated sensor against the truth.", default=None, unit="mm"
    )
    rotation_deg: Amount | None = field("Likewise.", default=None, unit="degrees")
    joint_mm: Amount | None = field(
        "The worst error of a calibrated joint against the truth, of those that are lengths.", default=None, unit="mm"
    )
    joint_deg: Amount | None = field(
        "Largest error of the joints' parameters that are angles.", default=None, unit="degrees"
    )
    sigma_mm: Amount | None = field(
        "The standard deviation that the calibration states, of the sensor of which it is least sure.",
        default=None,
        unit="mm",
    )
    sigma_deg: Amount | None = field("Likewise.", default=None, unit="degrees")
    error_sigmas: Amount | None = field(
        "The worst error of a calibrated sensor in its stated standard deviations: the root mean square over six "
        "directions, 1 on average.",
        default=None,
    )
    chance: Annotated[float, between(0, 1)] | None = field("Probability that chance makes it as large.", default=None)
    reasons: Lines = field("Reason why there is no calibration; empty if there is one.", default=())

    @property
    def kept(self) -> int:
        """Number of poses that gave a collection."""
        return self.poses - len(self.lost or {})
