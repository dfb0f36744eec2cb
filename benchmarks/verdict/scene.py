"""A scene: what the user has, and the world as it is, from which the labels follow."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.dataset.model import Collection, CornerLabels, Dataset, Edge, Labels, PointLabels
from calibration.dataset.pattern import Pattern
from calibration.dataset.truth import Truth
from calibration.geometry.joints import JOINT_PARAMETERS
from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array
from calibration.pipeline.system import System

LabelChange = Callable[[int, str, Labels], Labels | None]
"""From the collection's index, the sensor's name and its labels to other labels, or to none."""

BORDER_SHIFT = 0.0005
"""Where a point moves by more (m), other rays would be the last ones on the pattern: its border is not known."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What the user has, and the world as it is."""

    system: System
    """The entry of calibration.yml, with rules and limits."""
    told: Dataset
    """What the user has: labels, intrinsics, patterns, the robot's description and positions."""
    world: Dataset
    """The same collections with the true transforms, intrinsics and joints; its labels are not used."""
    shape: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How far the pattern's middle stands out along x and along y, and its corners by twist, m."""
    seen: Mapping[str, Array] = field(default_factory=dict)
    """``T_sensor_pattern`` (N, 4, 4) by sensor, where it is another than the transforms of `world` say."""

    @property
    def pattern(self) -> Pattern:
        """The only pattern, as the user has it."""
        return next(iter(self.told.patterns.values()))

    @property
    def cameras(self) -> list[str]:
        """The names of the sensors with intrinsics."""
        return [name for name, sensor in self.told.sensors.items() if sensor.camera]

    @property
    def lidars(self) -> list[str]:
        """The names of the others."""
        return [name for name, sensor in self.told.sensors.items() if not sensor.camera]

    def pose(self, sensor: str) -> Array:
        """``T_sensor_pattern`` (N, 4, 4), as it is."""
        if sensor in self.seen:
            return self.seen[sensor]
        return self.world.transform(self.world.sensors[sensor].frame, self.pattern.link)

    def surface(self, places: Array) -> Array:
        """Height (...) of the pattern, m, at places (..., 2) on it."""
        corners = next(iter(self.world.patterns.values())).corners
        low, high = corners[:, :2].min(0), corners[:, :2].max(0)
        u, v = np.moveaxis(2 * (places - low) / (high - low) - 1, -1, 0)
        along_x, along_y, twist = self.shape
        heights: Array = along_x * (1 - u**2) + along_y * (1 - v**2) + twist * u * v
        return heights

    def expected(self, i: int, sensor: str, labels: Labels, T_sensor_pattern: Array) -> Array:
        """What the labels of collection ``i`` would be without noise: pixels (K, 2), or points (K, 3)."""
        if isinstance(labels, CornerLabels):
            camera = self.world.sensors[sensor].camera
            assert camera
            corners = next(iter(self.world.patterns.values())).corners[labels.ids].copy()
            corners[:, 2] += self.surface(corners[:, :2])
            return camera.project(apply(T_sensor_pattern[i], corners))
        rays = labels.points / np.linalg.norm(labels.points, axis=-1, keepdims=True)
        normal, place = T_sensor_pattern[i, :3, 2], T_sensor_pattern[i, :3, 3]
        flat = rays * ((normal @ place) / (rays @ normal))[:, None]
        heights = self.surface(apply(inverse(T_sensor_pattern[i]), flat)[:, :2])
        points: Array = rays * ((normal @ place + heights) / (rays @ normal))[:, None]
        return points

    def labelled(self, change: LabelChange) -> "Scene":
        """The scene with other labels; collections keep their place."""

        def changed(i: int, collection: Collection) -> Collection:
            labels = {key: change(i, key[1], label) for key, label in collection.labels.items()}
            return replace(collection, labels={key: label for key, label in labels.items() if label is not None})

        collections = tuple(changed(i, c) for i, c in enumerate(self.told.collections))
        return replace(self, told=replace(self.told, collections=collections))

    def seen_as_in(self, world: "Scene") -> "Scene":
        """The scene in another world: each label moves as far as its expectation does, and keeps its noise.

        Corners that would lie behind a camera, and points whose ray misses the pattern's plane, are gone.
        """
        before = {name: self.pose(name) for name in self.told.sensors}
        after = {name: world.pose(name) for name in self.told.sensors}

        def moved(i: int, sensor: str, labels: Labels) -> Labels | None:
            with np.errstate(all="ignore"):
                change = world.expected(i, sensor, labels, after[sensor]) - self.expected(
                    i, sensor, labels, before[sensor]
                )
            return _moved(labels, change)

        return replace(world.labelled(moved), seen=world.seen)

    def truth(self) -> Truth:
        """What a calibration should find, as the world is in the last collection.

        A sensor's true transform is the one that puts its data frame where it is, with the description's transforms
        from the calibrated one to the data frame.
        """
        transforms: dict[Edge, Array] = {}
        for name, sensor in self.world.sensors.items():
            T_parent_frame = self.world.transform(sensor.calibration_parent, sensor.frame)[-1]
            told = self.told.sensors[name]
            T_child_frame = self.told.transform(told.calibration_child, told.frame)[-1]
            transforms[told.edge] = T_parent_frame @ inverse(T_child_frame)
        joints = {
            name: dict(zip(JOINT_PARAMETERS, joint.values.tolist(), strict=True))
            for name, joint in self.world.joints.items()
        }
        edges = {name: sensor.edge for name, sensor in self.told.sensors.items()}
        return Truth(self.told.path, edges, transforms, {}, joints=joints)


def _moved(labels: Labels, change: Array) -> Labels | None:
    here = np.asarray(np.isfinite(change).all(-1))
    if isinstance(labels, CornerLabels):
        if here.sum() < 4:
            return None
        return replace(labels, ids=labels.ids[here], pixels=(labels.pixels + change)[here])
    if not here.any():
        return None
    limits = labels.limits[:0] if np.abs(change[here]).max() > BORDER_SHIFT else labels.limits
    return PointLabels(labels.points + np.where(here[:, None], change, 0), limits)
