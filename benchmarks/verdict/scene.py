"""A scene: what the user has, and the world as it is, from which the labels follow."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset, Edge, Labels
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.evaluation.truth import Truth
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import apply, inverse
from calibration.pipeline.system import System

LabelChange = Callable[[int, str, Labels], Labels | None]
"""From the collection's index, the sensor's name and its labels to other labels, or to none."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Data of a user, and the true world."""

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
        return self._poses[sensor]

    @cached_property
    def _poses(self) -> dict[str, Array]:
        frames = {name: sensor.frame for name, sensor in self.world.sensors.items() if name not in self.seen}
        return {**self.seen, **{n: self.world.transform(frame, self.pattern.link) for n, frame in frames.items()}}

    def surface(self, places: Array) -> Array:
        """Height (...) of the pattern, m, at places (..., 2) on it."""
        corners = next(iter(self.world.patterns.values())).corners
        low, high = corners[:, :2].min(0), corners[:, :2].max(0)
        u, v = np.moveaxis(2 * (places - low) / (high - low) - 1, -1, 0)
        along_x, along_y, twist = self.shape
        heights: Array = along_x * (1 - u**2) + along_y * (1 - v**2) + twist * u * v
        return heights

    def expected(self, i: int, sensor: str, ids: IntArray) -> Array:
        """Pixels (K, 2) at which corners (K,) would be seen in collection ``i`` without noise."""
        camera = self.world.sensors[sensor].camera
        assert camera
        corners = next(iter(self.world.patterns.values())).corners[ids].copy()
        corners[:, 2] += self.surface(corners[:, :2])
        return camera.project(apply(self.pose(sensor)[i], corners))

    def labelled(self, change: LabelChange) -> "Scene":
        """The scene with other labels; collections keep their place."""

        def changed(i: int, collection: Collection) -> Collection:
            labels = {key: change(i, key[1], label) for key, label in collection.labels.items()}
            return replace(collection, labels={key: label for key, label in labels.items() if label is not None})

        collections = tuple(changed(i, c) for i, c in enumerate(self.told.collections))
        return replace(self, told=replace(self.told, collections=collections))

    def seen_as_in(self, world: "Scene") -> "Scene":
        """The scene in another world: each label moves as far as what is expected there, and keeps its noise.

        The points of a LiDAR move with the pattern and its surface, as if its rays had. Corners that would lie behind
        a camera are gone.
        """
        poses = {name: (self.pose(name), world.pose(name)) for name in self.told.sensors}

        def moved(i: int, sensor: str, labels: Labels) -> Labels | None:
            if isinstance(labels, CornerLabels):
                with np.errstate(all="ignore"):
                    change = world.expected(i, sensor, labels.ids) - self.expected(i, sensor, labels.ids)
                here = np.asarray(np.isfinite(change).all(-1))
                return CornerLabels(labels.ids[here], (labels.pixels + change)[here]) if here.sum() >= 4 else None
            T_sensor_pattern, T_now = (T[i] for T in poses[sensor])
            places = apply(inverse(T_sensor_pattern), labels.points)
            places[:, 2] += world.surface(places[:, :2]) - self.surface(places[:, :2])
            return replace(labels, points=apply(T_now, places))

        return replace(world.labelled(moved), seen=world.seen)

    def truth(self) -> Truth:
        """Correct result of a calibration, by the world in the last collection.

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
