"""Task of a robot, as calibration.yml has it: points, who sees them, where the error counts, and the poses at work."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from calibration.base.arrays import Array
from calibration.base.records import (
    UNIQUE,
    Converted,
    Misfit,
    Place,
    above,
    between,
    exactly_one,
    excludes,
    field,
    length,
    record,
)
from calibration.engine.dataset.model import Dataset, Edge


@dataclass(frozen=True, eq=False)
class WorkPoses:
    """V poses of a robot, as its description tells them."""

    count: int
    """V."""
    transforms: Mapping[Edge, Array]
    """(V, 4, 4): by the transforms of the dataset that the given joints move."""
    positions: Mapping[Edge, Array]
    """(V,): of those that are a single joint, rad or m."""
    others: Mapping[Edge, tuple[str, ...]]
    """By transforms that joints move whose position is not given, their names."""

    def taken_by(self, dataset: Dataset) -> Dataset:
        """Return a dataset of V collections with these poses; calibrated joints keep the parameters that it has."""
        joints = {
            name: replace(joint, positions=self.positions[joint.edge])
            for name, joint in dataset.joints.items()
            if joint.edge in self.positions
        }
        calibrated = {joint.edge: np.asarray(joint.transform) for joint in joints.values()}
        return replace(dataset, joints={**dataset.joints, **joints}).with_transforms({**self.transforms, **calibrated})


Name = Annotated[str, length(1, 400)]
MAX_COORDINATE = 1e4
"""m: limit of a task's coordinates."""
Coordinate = Annotated[float, between(-MAX_COORDINATE, MAX_COORDINATE)]
Point = Annotated[tuple[Coordinate, ...], length(3, 3)]
MAX_WORK_POSES = 100
"""Limit of the poses that joint positions of one's own make."""
Position = Annotated[float, between(-MAX_COORDINATE, MAX_COORDINATE)]
TaskUnit = Literal["mm", "px", "deg"]


def _as_names(found: tuple[str, ...] | str, _: Place) -> tuple[str, ...]:
    return (found,) if isinstance(found, str) else found


@record
class Box:
    """Box of points, by two opposite corners."""

    low: Point = field("One corner, m.", key="from")
    high: Point = field("The opposite one, m.", key="to")


@record(
    rules=(
        exactly_one("seen-by", "of"),
        exactly_one("points", "box", "distance"),
        excludes("in", "in-image-of"),
        excludes("in", "on-plane"),
        excludes("in-image-of", "on-plane"),
        excludes("joints", "collections"),
        excludes("limit-mm", "limit-px"),
        excludes("limit-mm", "limit-deg"),
        excludes("limit-px", "limit-deg"),
    )
)
class RobotTask:
    """What the robot does with its calibration, and how far off it may be there."""

    name: str
    seen_by: Annotated[tuple[Name, ...], UNIQUE, Converted(tuple[Name, ...] | Name, _as_names)] = field(
        "The sensor that sees the points, or the cameras that triangulate them. What a single camera sees is at a "
        "known distance.",
        default=(),
    )
    of: Name | None = field("Instead: the frame that carries the points, such as the tool's.", default=None)
    frame: Name | None = field(
        "The frame in which the error counts, such as the gripper's. By default that of the first sensor.",
        key="in",
        default=None,
    )
    image: Name | None = field("Instead: the camera in whose image it counts.", key="in-image-of", default=None)
    plane: Name | None = field(
        "Instead: the frame on whose plane z = 0 it counts, as the ground. A camera sees the points; their distance "
        "follows.",
        key="on-plane",
        default=None,
    )
    points: Annotated[tuple[Point, ...], length(1, 1000)] | None = field("The points, m.", default=None)
    box: Box | None = field("Instead: a box of points.", default=None)
    distance: Annotated[float, above(0), between(0, MAX_COORDINATE)] | None = field(
        "Instead: points all over the image of the camera, so far away from it.", default=None, unit="m"
    )
    points_in: Name | None = field(
        "The frame of the points or the box. By default that which carries them, else that in which the error counts.",
        default=None,
    )
    collections: Annotated[tuple[Name, ...], UNIQUE, length(1, 1000)] | None = field(
        "The collections in whose poses the robot works, by their keys. By default poses from all of them.",
        default=None,
    )
    joints: Mapping[Name, Annotated[tuple[Position, ...], length(1, MAX_WORK_POSES)]] | None = field(
        "Instead: positions of joints at which the robot works, by name, rad or m: the first of each make the first "
        "pose. They need its description.",
        default=None,
    )
    limit_mm: Annotated[float, above(0)] | None = field(
        "The largest error that passes: 95 % at the worst point stay below it.", default=None, unit="mm"
    )
    limit_px: Annotated[float, above(0)] | None = field("The same in an image.", default=None, unit="px")
    limit_deg: Annotated[float, above(0)] | None = field(
        "The same of the direction to the points, from the origin of the frame in which it counts.",
        default=None,
        unit="degrees",
    )
    work_poses: WorkPoses | None = None
    """Those of its joints, set once the robot's description is read."""

    def __post_init__(self) -> None:
        """Refuse keys that do not go together.

        Raises:
            Misfit: one of them.
        """
        if self.limit is not None and (self.image is None) != (self.limit_px is None):
            unit, key = ("px", "limit-px") if self.image else ("mm", "limit-mm")
            raise Misfit(f"found a limit in another unit, expected {key}: its error is in {unit}", "limit-px")
        if self.of is not None and self.frame is None and self.image is None:
            raise Misfit("found 'of' alone, expected the frame in which the error counts ('in') or 'in-image-of'", "of")
        if self.plane is not None and (len(self.seen_by) != 1 or self.limit_deg is not None):
            raise Misfit("expected one camera ('seen-by') and a limit in mm", "on-plane")
        if self.joints is not None and len(set(map(len, self.joints.values()))) != 1:
            raise Misfit("expected one joint or more, and as many positions of each", "joints")

    @property
    def unit(self) -> TaskUnit:
        """Unit of its error."""
        if self.image is not None:
            return "px"
        return "mm" if self.limit_deg is None else "deg"

    @property
    def limit(self) -> float | None:
        """Its limit, in its unit."""
        return next((each for each in (self.limit_mm, self.limit_px, self.limit_deg) if each is not None), None)
