"""Options of a calibration, declared once: for commands, calibration.yml and the engine."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Literal

from calibration.base.records import UNIQUE, Converted, Misfit, Place, above, at_least, field, length, record
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.estimation.problem.blocks import ALL_CAMERAS, CalibratedIntrinsics
from calibration.engine.estimation.problem.intrinsics import read_intrinsics

Known = Annotated[float, at_least(0)]


@record
class Assumptions:
    """Standard deviations of fixed parameters; 0 for exactly known ones, as in a simulation."""

    focal_length: Known | None = field("Of a camera, relative; else as a nominal calibration's.", default=None)
    aspect: Known | None = field("Of a camera: fx over fy, relative; likewise.", default=None)
    principal_point: Known | None = field("Of a camera, each axis; likewise.", default=None, unit="px")
    distortion: Known | None = field("Of a camera: the first coefficient of its lens, k1; likewise.", default=None)
    pattern_size: Known = field("Of the printed squares, relative.", default=0.0005)
    pattern_stretch: Known = field("Of the squares' length over their height, relative.", default=0.0002)
    flatness: Known = field("Of the board: its middle against its ends.", default=0.0002, unit="m")
    border: Known = field("Of the board's border about its squares.", default=0.0005, unit="m")
    range_bias: Known = field("Of a LiDAR or a depth camera.", default=0.001, unit="m")
    range_scale: Known = field("Of a LiDAR or a depth camera, relative.", default=0.0002)
    beam_elevation: Known = field("Of a LiDAR.", default=0.0002, unit="rad")
    arm_translation: Known = field("Of each moving link of an arm, each axis.", default=0.00005, unit="m")
    arm_rotation: Known = field("Of each moving link of an arm, each axis.", default=0.0001, unit="rad")


OF_INTRINSICS = ("focal_length", "aspect", "principal_point", "distortion")
"""Assumptions on fixed intrinsics; None for those of `calibration.engine.estimation.covariance.lens_errors`."""
ALL_EXACT = Assumptions(**dict.fromkeys((each.name for each in fields(Assumptions)), 0.0))
"""All fixed parameters are exactly known."""


def _as_assumptions(found: Literal["exact"] | Assumptions, _: Place) -> Assumptions:
    return ALL_EXACT if found == "exact" else found


def _as_tuple(found: tuple[str, ...] | str, _: Place) -> tuple[str, ...]:
    return (found,) if isinstance(found, str) else found


FREE_LAGS = "free"
"""Instead of the names of sensors: the lags of all that can be told."""
Start = Literal["linear", "given"]
"""Linear initial guess of the engine, or the noisy given one."""
Loss = Literal["huber", "linear"]
Scale = Literal["known", "free"]
"""Whether the translations of measured poses are metric, or calibrated by a common factor."""
Description = Literal["trusted", "rough"]
"""Reliability of the dataset's own transforms."""
Names = Annotated[tuple[Annotated[str, length(1, 400)], ...], length(most=1000), UNIQUE]
LensModel = Literal["plumb_bob", "equidistant", "eucm", "double_sphere", "rational_polynomial", "omni"]
"""The names in `calibration.engine.geometry.lenses.MODELS`."""
KnownIntrinsics = Path | Mapping[str, CalibratedIntrinsics]
"""A file, or its content, by camera."""


@record
class PoseNoise:
    """Standard deviations of measured poses of patterns."""

    mm: Annotated[float, above(0)] = field("Of each coordinate.", unit="mm")
    deg: Annotated[float, above(0)] = field("About each axis.", unit="deg")


@record
class Options:
    """Options of a calibration."""

    start: Start = field(
        "linear: our own solution, which needs no guess. given: the noisy guess, as software under test must.",
        default="linear",
        option="Own linear start, or the noisy guess (linear).",
    )
    loss: Loss = field(
        "huber: robust. linear: plain least squares.",
        default="huber",
        option="Robust, or plain least squares (huber).",
    )
    noise_levels: NoiseLevels = dataclasses.field(default_factory=NoiseLevels)
    """Standard deviations of the labels; others are estimated."""
    pose_noise: PoseNoise | None = field(
        "How exactly poses of patterns were measured, where it is known; else the residuals tell.",
        default=None,
        option=False,
    )
    scale: Scale = field(
        "Of measured poses of patterns: known, or free where a camera alone gives them, as from structure from motion.",
        default="known",
        option=False,
    )
    lag: Annotated[Names, Converted(Names | Literal["free"], _as_tuple)] = field(
        "Sensors whose time offset to the transforms of their collections is calibrated too, with its error bar; free "
        "for all. Needs a dataset with velocities, as imports of bags in motion write them.",
        default=(),
        option=False,
    )
    hold: Names = field(
        "What stays as the dataset has it: sensors, transforms (parent-child), patterns, joints (joint-elbow, "
        "joint-elbow-origin_yaw), intrinsics (intrinsics-left, intrinsics-left-k3).",
        default=(),
        option="What stays as it is: sensors, transforms, patterns, intrinsics-left-k3 ...",
    )
    intrinsics: Annotated[Names, Converted(Names | Literal["all"], _as_tuple)] = field(
        "Cameras whose intrinsics are calibrated too, with their error bars; all for every one.",
        default=(),
        option="Cameras whose intrinsics are calibrated too, or all.",
    )
    lens: Mapping[str, LensModel] = field(
        "Lens models of cameras whose intrinsics are calibrated, by camera: plumb_bob or rational_polynomial; of wide "
        "lenses equidistant, eucm, double_sphere or omni. By default that of the dataset; of a camera without given "
        "intrinsics the simplest that fits its corners.",
        default_factory=dict,
        option=False,
    )
    intrinsics_covariance: Annotated[KnownIntrinsics, Converted(Path, lambda path, _: path)] | None = field(
        "A JSON file that says how well intrinsics are known, such as the intrinsics.json of an earlier run: a prior "
        "of those that are calibrated; the others stay, and the result's error bars are the wider.",
        default=None,
        option="JSON file of how well intrinsics are known: an earlier intrinsics.json.",
    )

    description: Description = field(
        "trusted: a sensor that comes out far (0.25 m, 0.25 rad) from where the dataset's own transforms put it fails. "
        "rough: they are only a guess. A transform that is the identity says nothing either way.",
        default="trusted",
        option="Whether sensors far from where the dataset puts them fail, or it is rough (trusted).",
    )
    assume: Annotated[Assumptions, Converted(Literal["exact"] | Assumptions, _as_assumptions)] = field(
        "How well what is held is known, as standard deviations; exact where all of it is, as in a simulation. The "
        "result's error bars contain it, and only what is off by more is suspicious.",
        default_factory=Assumptions,
        option=False,
    )

    def __post_init__(self) -> None:
        """Refuse assumptions on calibrated or known parameters.

        Raises:
            Misfit: all intrinsics are calibrated, but ``assume`` has their standard deviations; a lens model is chosen
                for a camera whose intrinsics are not calibrated.
        """
        for name in self.lens:
            if not self.frees_intrinsics_of(name):
                raise Misfit(f"found '{name}', whose intrinsics are not calibrated: add it to 'intrinsics'", "lens")
        free = set(self.intrinsics) == {ALL_CAMERAS} and not any(name.startswith("intrinsics-") for name in self.hold)
        given = [name for name in OF_INTRINSICS if getattr(self.assume, name) != getattr(Assumptions(), name)]
        if free and given and self.assume != ALL_EXACT:
            raise Misfit(
                f"assume: found '{given[0].replace('_', '-')}' beside 'intrinsics: all'; what is calibrated is not "
                f"assumed: leave one of them out (a file of 'intrinsics-covariance' says what is known beforehand)"
            )

    def frees_intrinsics_of(self, camera: str) -> bool:
        """Whether the intrinsics of a camera are calibrated."""
        return camera in self.intrinsics or ALL_CAMERAS in self.intrinsics

    def free_lags_of(self, dataset: Dataset) -> tuple[str, ...]:
        """Return the sensors whose lag is calibrated.

        Where nothing but patterns moves, one sensor must give the time: of all, the anchored or the first one.
        """
        if self.lag != (FREE_LAGS,):
            return self.lag
        of_patterns = {pattern.edge for pattern in dataset.patterns.values()}
        clock = None if dataset.velocities.keys() - of_patterns else dataset.anchored or next(iter(dataset.sensors))
        return tuple(name for name in dataset.sensors if name != clock)

    def known_noise(self) -> NoiseLevels:
        """Standard deviations of the labels that are not estimated."""
        if self.pose_noise is None:
            return self.noise_levels
        mm, deg = self.pose_noise.mm, self.pose_noise.deg
        return dataclasses.replace(self.noise_levels, pose_translation=1e-3 * mm, pose_rotation=math.radians(deg))

    def known_intrinsics(self) -> Mapping[str, CalibratedIntrinsics]:
        """Prior intrinsics with covariance, by camera.

        Raises:
            InputError: the file cannot be read, or is invalid.
        """
        known = self.intrinsics_covariance
        return read_intrinsics(known) if isinstance(known, Path) else known or {}
