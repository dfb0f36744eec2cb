"""Hypotheses of conventions: what they need of a recording, and how badly it fits by each, found fast."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base import CalibrationError, rounded
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import CornerLabels, Dataset, Edge, PoseLabels
from calibration.engine.estimation.least_squares.minimisation import HUBER_THRESHOLD, Termination, minimise
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.fixing import RIGID_TOLERANCE
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.guesses import problem_and_start
from calibration.engine.estimation.start.single_views import corner_term
from calibration.engine.estimation.start.wrong_views import (
    MIN_NOTICEABLE_RESIDUAL,
    median_residuals,
    noise_in_own_fits,
)
from calibration.engine.geometry.transforms import inverse, translation


@dataclass(frozen=True, eq=False)
class SeenPoses:
    """A sensor's views of a pattern, each with its own pose."""

    sensor: str
    pattern: str
    collections: IntArray
    """(V,)."""
    seen: Array
    """``T_sensor_pattern`` (V, 4, 4), by each view alone, or as it was measured."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A dataset, with what its hypotheses have in common."""

    dataset: Dataset

    @cached_property
    def moving(self) -> tuple[Edge, ...]:
        """The known transforms that differ between collections: an arm's."""
        calibrated = {sensor.edge for sensor in self.dataset.sensors.values()}
        calibrated |= {(pattern.parent_link, pattern.link) for pattern in self.dataset.patterns.values()}
        calibrated |= {*self.dataset.additional_transforms}
        return tuple(
            edge
            for edge, T in self.dataset.transforms.items()
            if edge not in calibrated and np.isfinite(T).all() and np.abs(T - T[:1]).max() > RIGID_TOLERANCE
        )

    @property
    def arm(self) -> Edge | None:
        """The only transform of the arm, as hand-eye samples have it; None if it has several, or there is no arm."""
        return self.moving[0] if len(self.moving) == 1 and self.moving[0] not in self.joints else None

    @property
    def joints(self) -> set[Edge]:
        """The edges of joints with calibrated parameters."""
        return {joint.edge for joint in self.dataset.joints.values()}

    @property
    def in_hand(self) -> bool:
        """Whether the arm carries a sensor, not a pattern."""
        sensor, pattern = next(iter(self.dataset.sensors.values())), next(iter(self.dataset.patterns.values()))
        path = self.dataset.tree.path(sensor.frame, pattern.parent_link)
        return any((step.parent, step.child) == self.arm and step.inverted for step in path)

    @cached_property
    def view(self) -> SeenPoses | None:
        """The views of the camera or tracker with most of them; None without a fixed pattern."""
        fixed = [name for name, pattern in self.dataset.patterns.items() if pattern.fixed]
        found = [each for p in fixed for s in self.dataset.sensors if (each := self.seen_poses(s, p))]
        return max(found, key=lambda each: len(each.collections), default=None)

    def seen_poses(self, sensor: str, pattern: str) -> SeenPoses | None:
        """Return the views of a camera or tracker of a pattern; None without any."""
        board, camera = self.dataset.patterns[pattern], self.dataset.sensors[sensor].camera
        labels = self.dataset.detections(pattern, sensor)
        if not labels:
            return None
        at = np.array([i for i, _ in labels])
        poses = [label.T for _, label in labels if isinstance(label, PoseLabels)]
        if poses:
            return SeenPoses(sensor, pattern, at, np.stack(poses))
        corners = [label for _, label in labels if isinstance(label, CornerLabels)]
        if camera is None or len(corners) < len(labels):
            return None
        term: CornerTerm = corner_term(camera, board, corners)
        seen = term.linear_poses @ inverse(translation(board.centre))
        usable = np.isfinite(seen[:, 0, 0])
        return SeenPoses(sensor, pattern, at[usable], seen[usable])

    @property
    def cameras(self) -> list[str]:
        """Sensors with corner labels."""
        return [sensor.name for sensor in self.dataset.sensors.values() if sensor.modality.has_corners]

    @property
    def has_measured_poses(self) -> bool:
        """Whether the labels are poses of the pattern."""
        return any(sensor.modality.has_poses for sensor in self.dataset.sensors.values())


SHARE_OF_VIEWS = 0.8
"""Share of a sensor's views that a misfit is of: of the others each may be wrong."""
A_FEW_STEPS = Termination(decrease=0.1, iterations=15)


@dataclass(frozen=True, eq=False)
class Misfit:
    """Residuals that most views of the worst sensor do not exceed."""

    noticed: float
    """In multiples of what is noticeable (1 px, 1 cm); infinite if there is no start."""
    text: str
    """With its unit."""
    above_noise: float = np.inf
    """Largest one of a sensor, in multiples of the residuals from each view's own fit; infinite without such."""
    setup: Setup | None = None
    values: Values = ()

    @property
    def exists(self) -> bool:
        """Whether there is a start at all."""
        return bool(np.isfinite(self.noticed))


NO_RESULT = Misfit(np.inf, "no result")


def misfit(dataset: Dataset, options: Options, steps: bool = True) -> Misfit:
    """Return the misfit of a dataset, after a few steps or at the linear start."""
    with np.errstate(all="ignore"):
        try:
            setup, start = problem_and_start(dataset, options)
            values = start.values
            at_start = misfit_at(setup, values)
            return misfit_at(setup, _values_nearer_to_optimum(setup, values)) if steps else at_start
        except (CalibrationError, np.linalg.LinAlgError):
            return NO_RESULT


def improved(found: Misfit) -> Misfit:
    """Return the misfit after a few steps from that of a linear start."""
    if found.setup is None:
        return found
    with np.errstate(all="ignore"):
        try:
            return misfit_at(found.setup, _values_nearer_to_optimum(found.setup, found.values))
        except (CalibrationError, np.linalg.LinAlgError):
            return found


def _values_nearer_to_optimum(setup: Setup, values: Values) -> Values:
    """Return values nearer to the optimum, by the corners, the points on the plane, and where patterns are."""
    groups = tuple(replace(group, terms=group.terms[:1]) for group in setup.problem.groups)
    nearby = replace(setup.problem, groups=groups)
    scales = {group.terms[0].kind: MIN_NOTICEABLE_RESIDUAL[group.terms[0].kind] / 2 for group in groups}
    return minimise(nearby, values, Weighting(scales, HUBER_THRESHOLD), A_FEW_STEPS).values


def misfit_at(setup: Setup, values: Values) -> Misfit:
    """Return the misfit at some values of a problem's blocks."""
    noticed, above_noise, text = 0.0, 0.0, "0 px"
    for group in setup.problem.groups:
        kind = group.terms[0].kind
        miss = np.sort(median_residuals(setup.problem, group, values))
        size = float(miss[int(np.ceil(SHARE_OF_VIEWS * len(miss))) - 1])
        noise = noise_in_own_fits(group)
        above_noise = max(above_noise, size / noise if noise > 0 else np.inf)
        if not size / MIN_NOTICEABLE_RESIDUAL[kind] <= noticed:
            noticed = size / MIN_NOTICEABLE_RESIDUAL[kind]
            text = f"{rounded(size, 2)} px" if kind == "pixel" else f"{rounded(1e3 * size, 2)} mm"
    return Misfit(noticed, text if np.isfinite(noticed) else "no result", above_noise, setup, values)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Other convention, with the dataset as it would be, and what to change in the recording."""

    name: str
    """After "with": "the robot's poses inverted"."""
    remedy: str
    """What to change, in the user's files."""
    dataset: Callable[[], Dataset]
    sensors: tuple[str, ...] = ()
    """Those concerned."""
    told_apart: Callable[[Misfit], tuple[str, str]] | None = None
    """Name and remedy by the result, where conventions have the same equations and only its size tells them apart."""
