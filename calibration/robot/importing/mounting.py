"""Frames of a recording: where its sensors and patterns are mounted, and their transforms at its moments."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import Configuration, PatternConfiguration, SensorConfiguration
from calibration.engine.dataset.modalities import LIDAR3D, RGB, Modality
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry.frames import FrameTree
from calibration.robot.importing.bags.motion import MotionLog
from calibration.robot.importing.bags.stillness import BagMoment
from calibration.robot.importing.bags.survey import SensorTopic, Survey
from calibration.robot.importing.description import ImportDescription, body_edges, carriers, moving_bodies
from calibration.robot.importing.files.camera_files import KnownLens, with_baselines
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.image_views import LabelledMoment
from calibration.robot.importing.near_miss import check_told_apart
from calibration.robot.importing.recorded import Recorded
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import CornerDetector


@dataclass(frozen=True, eq=False)
class Mounting:
    """Sensors and patterns of an import in its tree of frames."""

    described: ImportDescription
    """With the root of the frames."""
    configuration: Configuration
    lenses: Mapping[str, KnownLens]
    """Known intrinsics, by sensor."""
    edges: tuple[Edge, ...] = ()
    """Recorded edges from the world to the sensors and to the patterns' parents."""

    @property
    def detectors(self) -> dict[str, CornerDetector]:
        """Detectors of the patterns."""
        return {name: corner_detector(pattern) for name, pattern in self.configuration.patterns.items()}

    def placed(self, recorded: Mapping[Edge, Array], count: int) -> dict[Edge, Array]:
        """Return the transforms (N, 4, 4) of all frames at N moments.

        Those that were recorded or are described; of cameras of a camchain relative to the first; else the identity.
        """
        known = {**recorded, **{edge: T for edge, T in self._given_poses(count).items() if edge not in recorded}}
        stated = {each.name: each.pose.transform for each in self.described.patterns if each.pose is not None}
        patterns = {
            (pattern.parent_link, pattern.link): np.broadcast_to(stated[name], (count, 4, 4))
            for name, pattern in self.configuration.patterns.items()
            if name in stated
        }
        transforms = {**self._with_unknown_frames(known, count), **patterns}
        return with_baselines(transforms, self.configuration, self.lenses, tuple(known))

    def _given_poses(self, count: int) -> dict[Edge, Array]:
        """Return ``T_parent_sensor`` (N, 4, 4) of the sensors that have one in the description."""
        return {
            (sensor.parent_link, sensor.child_link): np.broadcast_to(each.pose.transform, (count, 4, 4))
            for each in self.described.sensors
            if each.pose is not None and (sensor := self.configuration.sensors[each.name])
        }

    def _with_unknown_frames(self, known: Mapping[Edge, Array], count: int) -> dict[Edge, Array]:
        """Return the tree of frames: known transforms, and the identity for calibrated and auxiliary ones."""
        configuration, unknown = self.configuration, np.broadcast_to(np.eye(4), (count, 4, 4))
        transforms = dict(known)
        sensors = [(sensor.parent_link, sensor.child_link) for sensor in configuration.sensors.values()]
        for edge in (*sensors, *configuration.additional_tfs.values()):
            transforms.setdefault(edge, unknown)
        children = {child for _, child in transforms}
        parents = [
            *(parent for parent, _ in transforms),
            *(each.parent_link for each in configuration.patterns.values()),
        ]
        for frame in dict.fromkeys(parents):
            if frame != configuration.world_link and frame not in children:
                transforms[configuration.world_link, frame] = unknown
        FrameTree(transforms)
        return transforms

    def recorded(self, moments: Sequence[BagMoment], log: MotionLog) -> Recorded:
        """Return the cameras' data of some moments, without image files.

        Raises:
            InputError: there is no record of a frame near a moment.
        """
        times = [moment.time for moment in moments]
        found = {edge: np.stack([log.transform(edge, time) for time in times]) for edge in self.edges}
        views = [LabelledMoment({name: image.view for name, image in each.images.items()}) for each in moments]
        return Recorded(
            self.configuration,
            self.lenses,
            views,
            self.placed(found, len(moments)),
            rough=not self.edges,
            lag=max(moment.lag for moment in moments),
        )

    def motions(self, log: MotionLog, times: Sequence[float]) -> dict[Edge, Array]:
        """Return velocity, acceleration and jerk (N, 3, 6) of the edges that move at any of the times, ns."""
        found = {edge: np.stack([log.motion(edge, time) for time in times]) for edge in self.edges if log.moves(edge)}
        return {edge: motion for edge, motion in found.items() if motion.any()}


def described_mounting(
    described: ImportDescription, lenses: Mapping[str, KnownLens], modality: Modality = RGB
) -> Mounting:
    """Return the mounting by import.yml alone: the pose of each sensor on its parent is calibrated.

    Raises:
        InputError: a description is wrong, two patterns cannot be told apart, or nothing is mounted on the arm.
    """
    sensors = {
        each.name: SensorConfiguration(
            each.name,
            LIDAR3D.name if each.clouds else modality.name,
            each.link,
            each.parent or described.root,
            each.link,
        )
        for each in described.sensors
    }
    return Mounting(described, _configuration_of(described, sensors, pattern_configurations(described)), lenses)


def _configuration_of(
    described: ImportDescription,
    sensors: Mapping[str, SensorConfiguration],
    patterns: Mapping[str, PatternConfiguration],
) -> Configuration:
    """Return the calibration configuration; of patterns alone that move, the first sensor is anchored."""
    mounted = carriers(described, [pattern.parent_link for pattern in patterns.values() if pattern.fixed])
    if described.samples is not None:
        tool = described.samples.tool
        if tool not in mounted and all(sensor.parent_link != tool for sensor in sensors.values()):
            raise InputError(
                f"samples: neither a sensor nor a pattern is mounted on the tool, '{tool}': give one of them "
                f"'parent: {tool}'"
            )
    moves = described.samples is None and not mounted
    return Configuration(
        world_link=described.root,
        sensors=sensors,
        patterns=patterns,
        anchored_sensor=described.anchored or (next(iter(sensors)) if moves else None),
        additional_tfs=body_edges(described),
        moving_tfs=moving_bodies(described),
    )


def pattern_configurations(described: ImportDescription, root: str | None = None) -> dict[str, PatternConfiguration]:
    """Return the patterns by name.

    Raises:
        InputError: a description is wrong, or two cannot be told apart.
    """
    bodies = [each.name for each in described.bodies]
    patterns = {
        each.name: replace(
            pattern_configuration(each, described.root, root),
            known_pose=each.pose is not None and each.parent in bodies,
        )
        for each in described.patterns
    }
    check_told_apart(patterns)
    return patterns


def recorded_mounting(described: ImportDescription, lenses: Mapping[str, KnownLens], found: Survey) -> Mounting:
    """Return the mounting in the recorded frames of a bag: of each sensor the transform below its parent is calibrated.

    Raises:
        InputError: a named frame is not in the recording, or is not above the sensor's.
    """
    file = described.bags.files[0] if described.bags else Path()
    root, where = _root_of(described, found), str(file)
    patterns, described = pattern_configurations(described, root), replace(described, world=root)
    of_bag = {name: KnownLens(file, each.camera, True) for name, each in found.sensors.items() if each.camera}
    chosen, several = found.log.tree_edges(described.parents)
    edges = [edge for edge in chosen if edge[1] not in {pattern.link for pattern in patterns.values()}]
    tree, parent_of = FrameTree(edges), {child: parent for parent, child in edges}
    known, world = set(tree.frames), described.root
    sensors = {name: _recorded_sensor(each, world, parent_of, found.log, where) for name, each in found.sensors.items()}
    bodies = body_edges(described)
    carrying = [bodies[parent][0] if (parent := each.parent_link) in bodies else parent for each in patterns.values()]
    ends = [*(sensor.parent_link for sensor in sensors.values()), *carrying]
    if stray := [frame for frame in ends if frame != world and frame not in known]:
        fault = f"; the robot description cannot be read: {found.log.robot_fault}" if found.log.robot_fault else ""
        raise InputError(
            f"{where}: found no frame '{stray[0]}', expected one of those that were recorded: "
            f"{', '.join(sorted(known)) or 'none'}{fault}"
        )
    ends += [sensor.link for sensor in sensors.values() if sensor.link in known]
    used = dict.fromkeys((step.parent, step.child) for end in ends if end != world for step in tree.path(world, end))
    for _, child in used:
        if child in several:
            parents = " and ".join(f"'{parent}'" for parent in several[child])
            raise InputError(
                f"{where}: found '{child}' below {parents}, expected one parent on the way to a sensor or a pattern: "
                f"choose it, parents: {{{child}: {several[child][0]}}}"
            )
    for child in several:
        found.log.left_out.add("a second parent", child)
    configuration = _configuration_of(described, sensors, patterns)
    return Mounting(described, configuration, {**of_bag, **lenses}, tuple(used))


def _root_of(described: ImportDescription, found: Survey) -> str:
    """Return the root frame: the named one, if it was recorded; else the root above the first sensor.

    Raises:
        InputError: a chosen parent was not recorded, or the frames form a loop.
    """
    parent_of = {child: parent for parent, child in found.log.tree_edges(described.parents)[0]}
    frames = {*parent_of, *parent_of.values()}
    if described.root in frames or not frames:
        return described.root
    frame = next((each.frame for each in found.sensors.values() if each.frame in frames), next(iter(frames)))
    while frame in parent_of:
        frame = parent_of[frame]
    return frame


def _recorded_sensor(
    camera: SensorTopic, world: str, parent_of: Mapping[str, str], log: MotionLog, where: str
) -> SensorConfiguration:
    described, frame = camera.described, camera.frame
    name = described.name
    if frame not in parent_of:
        parent, child = described.parent or world, frame
    elif described.parent is None:
        parent, child = _above_optical(frame, parent_of, log)
    else:
        child = frame
        while parent_of.get(child) not in (described.parent, None):
            child = parent_of[child]
        if child not in parent_of:
            raise InputError(f"{where}: '{described.parent}' is not above '{frame}', the frame of '{name}'")
        parent = described.parent
    return SensorConfiguration(name, camera.modality.name, frame, parent, child, camera.topic)


def _above_optical(frame: str, parent_of: Mapping[str, str], log: MotionLog) -> Edge:
    """Return the transform that mounts a camera: not the one that only rotates its axes to those of an image."""
    edge = (parent_of[frame], frame)
    if edge[0] in parent_of and not log.moves(edge) and not log.transform(edge, 0.0)[:3, 3].any():
        return (parent_of[edge[0]], edge[0])
    return edge
