"""Systems to calibrate, and the starts to calibrate them from: what the stages share with the configuration."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from calibration.introspection.rule_set import RuleSet
from calibration.pipeline.matrix.software import Software

Start = Literal["linear", "given"]
"""The engine's own linear start, or the noisy guess."""
Loss = Literal["huber", "linear"]


@dataclass(frozen=True)
class Limits:
    """The largest values that pass; None where there is no limit."""

    rms_px: float | None = None
    translation_mm: float | None = None
    rotation_deg: float | None = None
    joint_mm: float | None = None
    joint_deg: float | None = None


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
    software: Software | None = None
    """The team's own calibration, in the place of our engine, which then only compares."""
    intrinsics: tuple[str, ...] = ()
    """Cameras whose intrinsics are calibrated too, or "all"."""
    intrinsics_covariance: Path | None = None
    """A file that says how well intrinsics are known, such as an earlier run's ``intrinsics.json``."""
    hold: tuple[str, ...] = ()
    """What stays as the dataset has it."""
    collected: str | None = None
    """The entry of `simulation` that makes its dataset, whose place only a run knows."""


@dataclass(frozen=True)
class NoiseGrid:
    """How far the starting guesses are off."""

    translations: tuple[float, ...] = (0.0,)
    """m."""
    rotations: tuple[float, ...] = (0.0,)
    """rad."""
    seeds: tuple[int, ...] = (1,)


def seed_range(count: int) -> tuple[int, ...]:
    """The seeds 1 to count."""
    return tuple(range(1, count + 1))
