"""Detection of patterns in range data, where a camera sees them at the same moment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import Configuration
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import FrameTree
from calibration.engine.geometry.transforms import inverse
from calibration.robot.importing.bags.range_views import RANGE_MODALITIES, RangeView
from calibration.robot.importing.patterns.image_views import LabelledMoment
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.simulation.collection.capture import estimate_pose
from calibration.robot.urdf import compose


@dataclass(frozen=True, eq=False)
class LabelledRange:
    """Data of a LiDAR or a depth camera at one moment, and the patterns in them."""

    view: RangeView
    found: Mapping[str, PatternPoints | NotDetected]
    """Detected points of each pattern, or the reason why it is not detected."""


def labelled_ranges(
    views: Sequence[Mapping[str, RangeView]],
    moments: Sequence[LabelledMoment],
    configuration: Configuration,
    cameras: Mapping[str, Camera],
    transforms: Mapping[Edge, Array],
) -> list[dict[str, LabelledRange]]:
    """Detect the patterns in the data of every LiDAR and depth camera at N moments.

    Args:
        views: their data, by name.
        moments: the cameras' detections.
        configuration: the sensors and the patterns.
        cameras: the intrinsics, of depth cameras too.
        transforms: (N, 4, 4) of each edge, for the expected pose of a pattern that a camera detects.
    """
    tree = FrameTree(transforms)
    place = {
        name: compose(tree, transforms, configuration.world_link, sensor.link)
        for name, sensor in configuration.sensors.items()
    }
    labelled = []
    for i, (ranges, moment) in enumerate(zip(views, moments, strict=True)):
        guesses = {
            pattern: _seen_by_cameras(moment, pattern, configuration, cameras, {n: T[i] for n, T in place.items()})
            for pattern in configuration.patterns
        }
        labelled.append(
            {
                name: _label_range(name, view, guesses, configuration, place[name][i], cameras.get(name))
                for name, view in ranges.items()
            }
        )
    return labelled


def _seen_by_cameras(
    moment: LabelledMoment,
    pattern: str,
    configuration: Configuration,
    cameras: Mapping[str, Camera],
    place: Mapping[str, Array],
) -> Array | None:
    """Return ``T_world_pattern`` (4, 4) by the camera that sees most of it; None if none does."""
    views = {name: labels for name, view in moment.views.items() if (labels := view.found[pattern].labels) is not None}
    if not views:
        return None
    best = max(views, key=lambda name: len(views[name].ids))
    T = estimate_pose(cameras[best], configuration.patterns[pattern].pattern(), views[best])
    return place[best] @ T if np.isfinite(T).all() else None


def _label_range(
    name: str,
    view: RangeView,
    guesses: Mapping[str, Array | None],
    configuration: Configuration,
    T_world_sensor: Array,
    camera: Camera | None,
) -> LabelledRange:
    found: dict[str, PatternPoints | NotDetected] = {}
    detect = RANGE_MODALITIES[configuration.sensors[name].modality].detector(view, camera)
    for pattern, T_world_pattern in guesses.items():
        if T_world_pattern is None:
            found[pattern] = NotDetected("no camera sees it at that moment")
        else:
            own = configuration.patterns[pattern].pattern()
            found[pattern] = detect(own, inverse(T_world_sensor) @ T_world_pattern)
    return LabelledRange(view, found)
