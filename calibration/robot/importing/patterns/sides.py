"""Tags on the sides of a body: each side is a flat pattern whose pose on the body is known.

So all that is true of flat patterns stays true; the pose of the body is one more transform that is calibrated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry.transforms import inverse
from calibration.robot.importing.description import BodyDescription, ImportDescription, PatternDescription, TagOnBody
from calibration.robot.simulation.description import Pose

FLAT_M, FLAT_RAD = 1e-6, 1e-6
"""Limits of what two tags of one side are apart from one plane."""


def with_sides(described: ImportDescription) -> ImportDescription:
    """Return a description in which patterns with tags on several sides are bodies with a flat pattern a side."""
    solid = [pattern for pattern in described.patterns if not pattern.is_flat]
    bodies = [BodyDescription(each.name, each.parent, described.is_fixed(each)) for each in solid]
    patterns = [
        side for each in described.patterns for side in (_sides_of_pattern(each) if not each.is_flat else [each])
    ]
    return replace(described, patterns=tuple(patterns), bodies=(*described.bodies, *bodies))


def _sides_of_pattern(pattern: PatternDescription) -> list[PatternDescription]:
    """Return the sides of a pattern; the frame of each is that of its first tag."""
    sides: list[tuple[TagOnBody, list[TagOnBody]]] = []
    for tag in pattern.tags or ():
        for first, tags in sides:
            T = inverse(first.T_body_tag) @ tag.T_body_tag
            if abs(T[2, 3]) < FLAT_M and np.linalg.norm(T[:2, 2]) < FLAT_RAD and T[2, 2] > 0:
                tags.append(_in_plane(tag, T))
                break
        else:
            sides.append((tag, [_in_plane(tag, np.eye(4))]))
    return [
        replace(
            pattern,
            name=f"{pattern.name}_{number}",
            tags=tuple(tags),
            parent=pattern.name,
            fixed=True,
            frame=None,
            pose=Pose((first.x, first.y, first.z), (first.roll, first.pitch, first.yaw)),
        )
        for number, (first, tags) in enumerate(sides)
    ]


def _in_plane(tag: TagOnBody, T: Array) -> TagOnBody:
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))
    return TagOnBody(id=tag.id, size=tag.size, x=float(T[0, 3]), y=float(T[1, 3]), yaw=yaw)


def body_edges(described: ImportDescription) -> dict[str, Edge]:
    """Return the transform of each body to its parent."""
    return {each.name: (each.parent or described.root, each.name) for each in described.bodies}


def moving_bodies(described: ImportDescription) -> tuple[str, ...]:
    """Return the bodies that have a pose in each collection."""
    return tuple(each.name for each in described.bodies if not described.is_fixed(each))


def carriers(described: ImportDescription, parents: Sequence[str]) -> set[str]:
    """Return the frames that carry fixed patterns, by their parents: of a body, the frame that it is fixed on."""
    bodies = {each.name: each for each in described.bodies}
    on_frames = {parent for parent in parents if parent not in bodies}
    return on_frames | {each.parent or described.root for each in bodies.values() if described.is_fixed(each)}
