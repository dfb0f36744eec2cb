"""One scenario: what makes a world differ from the description, the id that finds it again, and what came of it."""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration import __version__
from calibration.errors import InputError
from calibration.simulation.motion.sequence import Motion, motion_document
from calibration.simulation.random_streams import stream
from calibration.simulation.system import System

MAX_SEED = 2**53
"""A seed of an id is below it, as any number in JSON is."""
MAX_INDEX = 10**8
_ID = re.compile(r"s(0|[1-9][0-9]{0,15})-([0-9]{5,8})")
_HASH_DIGITS = 12


@dataclass(frozen=True)
class Scenario:
    """A world's parameters. Everything in it is drawn from its seed and index alone."""

    seed: int
    index: int
    """From 0."""
    values: Mapping[str, float]
    """By the parameter's name (`calibration.simulation.scenarios.parameters`)."""
    attempt: int = 0
    """How many draws before this one broke a constraint."""

    @property
    def id(self) -> str:
        """Such as "s1-00017": seed 1, index 17."""
        return scenario_id(self.seed, self.index)

    @property
    def collection_seed(self) -> int:
        """The seed of what its sensors see and of a motion that is generated for it."""
        return int(self.random("collection").integers(MAX_SEED))

    def random(self, *purpose: str | int) -> np.random.Generator:
        """Random numbers for one purpose in this world."""
        return stream(self.seed, "scenario", self.index, self.attempt, *purpose)


def scenario_id(seed: int, index: int) -> str:
    """The id of a scenario."""
    return f"s{seed}-{index:05d}"


def parse_id(text: str) -> tuple[int, int]:
    """The seed and the index in an id.

    Raises:
        InputError: it is none.
    """
    match = _ID.fullmatch(text)
    seed, index = (int(match[1]), int(match[2])) if match else (-1, -1)
    if not 0 <= seed < MAX_SEED or scenario_id(seed, index) != text:
        raise InputError(f"scenario: found '{text}', expected an id such as s1-00017 (seed 1, index 17)")
    return seed, index


def content_hash(system: System, scenario: Scenario, motion: Motion | None = None) -> str:
    """What tells two worlds apart: 12 hexadecimal digits of a SHA-256.

    Over the scenario's id and values, the system's files, the motion if one is given, and the version
    of this package. What a scenario set says beyond the values, such as how it is laid out, changes no world.
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


@dataclass(frozen=True)
class ScenarioResult:
    """What came of one world. Numbers are None where there are none."""

    id: str
    hash: str
    """Of its content (`content_hash`): equal worlds have equal hashes."""
    values: Mapping[str, float]
    """Its parameters."""
    poses: int = 0
    """Of its motion; 0 where none was found."""
    lost: Mapping[str, tuple[str, ...]] | None = None
    """The poses that gave no collection, by key, and why."""
    detection: Mapping[str, float] | None = None
    """The share of the poses at which each sensor detects a pattern."""
    corner_rms_px: float | None = None
    """Detected corners against the true ones."""
    converged: bool = False
    rms_px: float | None = None
    """Of the reprojected corners."""
    translation_mm: float | None = None
    """The worst error of a calibrated sensor against the truth."""
    rotation_deg: float | None = None
    joint_mm: float | None = None
    """The worst error of a calibrated joint against the truth, of those that are lengths, and of the angles."""
    joint_deg: float | None = None
    sigma_mm: float | None = None
    """The standard deviation that the calibration states, of the sensor of which it is least sure."""
    sigma_deg: float | None = None
    reasons: tuple[str, ...] = ()
    """Why there is no calibration; empty where there is one."""

    @property
    def kept(self) -> int:
        """How many poses gave a collection."""
        return self.poses - len(self.lost or {})
