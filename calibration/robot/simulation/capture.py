"""Capture of one pose of a motion: the sensors' data, the detected labels, and the checks for keeping it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.start.single_views import corner_term, fitted_poses
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import inverse, translation
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.simulation.kinematics import Play, stream
from calibration.robot.simulation.scene import Board
from calibration.robot.simulation.sensors.sensor import Data, Found
from calibration.robot.simulation.system import System

Key = tuple[str, str]
"""(pattern, sensor)."""


@dataclass(frozen=True, eq=False)
class Capture:
    """Data of every sensor at one pose, and the labels of every pattern in them."""

    number: int
    """Index of the pose, from 0."""
    boards: Mapping[str, Sequence[Board]]
    """Patterns as each sensor saw them, in the order of the configuration; a swaying one differs between them."""
    data: Mapping[str, Data]
    """Results of `SimulatedSensor.render` by sensor."""
    labels: Mapping[Key, Found]
    """Labels of every pattern and sensor."""
    estimates: Mapping[Key, Array]
    """``T_camera_pattern`` (4, 4) of the detected patterns, each from the labels of that one view."""

    def found_by(self, sensor: str) -> dict[str, Found]:
        """Return the labels of a sensor, by pattern."""
        return {pattern: found for (pattern, name), found in self.labels.items() if name == sensor}

    def corners(self, camera: str) -> dict[str, CornerLabels]:
        """Return the corners detected by a camera, by pattern."""
        return {pattern: found for pattern, found in self.found_by(camera).items() if isinstance(found, CornerLabels)}

    @property
    def movement(self) -> float:
        """Largest distance of a pattern between its poses for two sensors, m."""
        pairs = combinations(self.boards.values(), 2)
        places = (
            (a.T_world_pattern, b.T_world_pattern) for one, other in pairs for a, b in zip(one, other, strict=True)
        )
        return max((float(np.linalg.norm((a - b)[:3, 3])) for a, b in places), default=0.0)


def capture(play: Play, number: int) -> Capture:
    """Render and label the data of every sensor at one pose.

    The result depends only on the play's seed, the index of the pose and the names of the sensors, so
    any subset of a motion's poses gives a subset of the collections.
    """
    system = play.system
    boards = {name: _boards_for_sensor(play, number, name) for name in system.sensors}
    data = {
        name: sensor.render(
            play.true.sensors[name][number], system.scene, boards[name], stream(play.seed, number, name)
        )
        for name, sensor in system.sensors.items()
    }
    labels: dict[Key, Found] = {}
    estimates: dict[Key, Array] = {}

    def label(name: str, T_world_pattern: Mapping[str, Array]) -> None:
        T_sensor_world = inverse(play.nominal.sensors[name][number])
        for pattern, configuration in system.configuration.patterns.items():
            expected = T_sensor_world @ T_world_pattern[pattern]
            labels[pattern, name] = system.sensors[name].label(data[name], configuration, expected)

    for name, camera in system.cameras.items():
        label(name, {pattern: T[number] for pattern, T in play.nominal.patterns.items()})
        for pattern in system.patterns:
            found = labels[pattern, name]
            if isinstance(found, CornerLabels):
                estimates[pattern, name] = estimate_pose(camera.camera, system.patterns[pattern], found)
    guesses = {
        pattern: _estimated_pattern_pose(play, number, pattern, labels, estimates) for pattern in system.patterns
    }
    for name in system.sensors:
        if name not in system.cameras:
            label(name, guesses)
    return Capture(number, boards, data, labels, estimates)


def _boards_for_sensor(play: Play, number: int, sensor: str) -> list[Board]:
    """Return the patterns at their poses for one sensor: the moved one may sway."""
    system = play.system
    boards = system.boards({name: T[number] for name, T in play.true.patterns.items()})
    if system.sway and system.moved_pattern:
        offset = system.sway * stream(play.seed, number, sensor, "sway").standard_normal(3)
        moved = system.moved_pattern.name
        return [
            replace(board, T_world_pattern=translation(offset) @ board.T_world_pattern)
            if board.pattern.name == moved
            else board
            for board in boards
        ]
    return boards


def _estimated_pattern_pose(
    play: Play,
    number: int,
    pattern: str,
    labels: Mapping[Key, Found],
    estimates: Mapping[Key, Array],
) -> Array:
    """Estimate ``T_world_pattern`` from the camera that sees most of it; the commanded pose if none does.

    As a data collector knows it: by the nominal robot.
    """
    counts = {
        camera: len(found.ids)
        for (name, camera), found in labels.items()
        if name == pattern and isinstance(found, CornerLabels) and np.isfinite(estimates[name, camera]).all()
    }
    if not counts:
        return np.asarray(play.nominal.patterns[pattern][number])
    best = max(counts, key=lambda camera: counts[camera])
    T_world_camera: Array = play.nominal.sensors[best][number]
    return T_world_camera @ estimates[pattern, best]


def estimate_pose(camera: Camera, pattern: Pattern, labels: CornerLabels) -> Array:
    """Estimate ``T_camera_pattern`` (4, 4) from the labels of one view; NaN if they do not determine it."""
    T_camera_centre, _ = fitted_poses(corner_term(camera, pattern, [labels]))
    return np.asarray(T_camera_centre[0] @ inverse(translation(pattern.centre)))


@dataclass(frozen=True)
class Requirements:
    """Requirements of a collection."""

    stillness: float = 0.002
    """Limit of a pattern's motion while the sensors measure, m."""
    image_share: float = 0.005
    """Minimum share of an image that the detected corners span."""


def reasons_to_lose(system: System, capture: Capture, requirements: Requirements) -> tuple[str, ...]:
    """Return the reasons why a collection is not kept; empty if it is."""
    reasons = [reason for sensor in system.sensors if (reason := _reason_of_no_detection(capture, sensor))]
    if capture.movement > requirements.stillness:
        limit = 1000 * requirements.stillness
        reasons.append(f"moved {1000 * capture.movement:.1f} mm while the sensors looked, {limit:g} mm are allowed")
    for name, camera in system.cameras.items():
        spans = [image_share(camera.camera, found) for found in capture.corners(name).values()]
        if spans and max(spans) < requirements.image_share:
            least = 100 * requirements.image_share
            reasons.append(f"{name}: the corners span {100 * max(spans):.2g} % of the image, {least:g} % are needed")
    return tuple(reasons)


def _reason_of_no_detection(capture: Capture, sensor: str) -> str:
    """Return the reason why a sensor detects none of the patterns; empty if it detects one."""
    found = capture.found_by(sensor)
    if not all(isinstance(answer, NotDetected) for answer in found.values()):
        return ""
    several = len(found) > 1
    why = "; ".join(
        f"{pattern}: {answer.reason}" if several else answer.reason
        for pattern, answer in found.items()
        if isinstance(answer, NotDetected)
    )
    return f"{sensor}: {why}"


def image_share(camera: Camera, labels: CornerLabels) -> float:
    """Share of the image covered by the bounding box of the corners."""
    width, height = np.ptp(labels.pixels, axis=0)
    return float(width * height / (camera.width * camera.height))
