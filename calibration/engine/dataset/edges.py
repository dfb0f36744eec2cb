"""Transforms of all collections and single poses, as documents and as matrices."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry import rotations, transforms

QUATERNION_TOLERANCE = 1e-3
"""Tolerance of a quaternion's norm, which should be 1; quaternions are normalised."""
MAX_FRAME_DISTANCE_M = 1e9
"""m: limit of the distance of a frame from its parent."""


def read_transforms(collections: Sequence[Node]) -> dict[Edge, Array]:
    """Parse the ``transforms`` of N collections: (N, 4, 4) for each edge; NaN where a collection lacks it.

    Raises:
        InputError: something in them is missing or wrong.
    """
    edges: dict[Edge, int] = {}
    places: list[tuple[int, int]] = []
    numbers: list[list[float]] = []
    for i, collection in enumerate(collections):
        transforms_node = collection["transforms"]
        for key in transforms_node.mapping():
            entry = transforms_node[key]
            parent, child = entry["parent"].text(), entry["child"].text()
            if key != f"{parent}-{child}":
                raise entry.fault(f"found parent '{parent}' and child '{child}', expected those of the key")
            places.append((edges.setdefault((parent, child), len(edges)), i))
            numbers.append(_read_numbers(entry))
    if len(edges) * len(collections) > 16 * len(places) + 1_000_000:
        raise collections[0].fault(
            f"the {len(collections)} collections have {len(edges)} different transforms but only {len(places)} in all; "
            "expected nearly the same ones in every collection"
        )
    T = np.full((len(edges), len(collections), 4, 4), np.nan)
    if places:
        rows = np.array(numbers)
        T[tuple(np.transpose(places))] = transforms.from_quaternion(rows[:, :3], rows[:, 3:])
    T.flags.writeable = False
    return dict(zip(edges, T, strict=True))


def read_transform(node: Node) -> tuple[Edge, Array]:
    """Parse a single transform (4, 4) and its edge.

    Raises:
        InputError: something in it is missing or wrong.
    """
    edge, numbers = (node["parent"].name(), node["child"].name()), _read_numbers(node)
    return edge, transforms.from_quaternion(numbers[:3], numbers[3:])


def _read_numbers(node: Node) -> list[float]:
    """Return the translation and the quaternion of a transform, 7 numbers."""
    translation, quaternion = node["trans"].numbers(3), node["quat"].numbers(4)
    _check_length(node["quat"], quaternion)
    if max(map(abs, translation)) > MAX_FRAME_DISTANCE_M:
        raise node["trans"].fault(f"found a frame that is more than {MAX_FRAME_DISTANCE_M:g} m away, expected m")
    return translation + quaternion


def read_pose(node: Node, far: float) -> Array:
    """Parse a pose (4, 4) in the form of ROS messages: ``position`` and ``orientation``.

    Raises:
        InputError: something in it is missing or wrong, or it is farther away than ``far``, m.
    """
    position, orientation = node["position"], node["orientation"]
    quaternion = [orientation[axis].number() for axis in "xyzw"]
    _check_length(orientation, quaternion)
    return transforms.from_quaternion([position[axis].within(-far, far) for axis in "xyz"], quaternion)


def pose_document(T: Array) -> dict[str, Any]:
    """Return a pose (4, 4) in the form that `read_pose` reads."""
    position, quaternion = T[:3, 3].tolist(), rotations.to_quaternion(T[:3, :3]).tolist()
    return {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", quaternion, strict=True)),
    }


def transform_documents(edge: Edge, T: Array) -> list[dict[str, Any]]:
    """Return the document entries of an edge's transforms (N, 4, 4)."""
    translations, quaternions = T[:, :3, 3].tolist(), rotations.to_quaternion(T[:, :3, :3]).tolist()
    return [
        {"parent": edge[0], "child": edge[1], "trans": trans, "quat": quat}
        for trans, quat in zip(translations, quaternions, strict=True)
    ]


def is_constant(T: Array) -> bool:
    """Whether a transform (N, 4, 4) is the same in all collections that have it."""
    present = T[~np.isnan(T[:, 0, 0])]
    return bool((abs(present - present[:1]) <= 1e-9).all())


def _check_length(node: Node, quaternion: Sequence[float]) -> None:
    length = math.hypot(*quaternion)
    if not abs(length - 1) <= QUATERNION_TOLERANCE:
        expected = f"[x, y, z, w] of length 1 (within {QUATERNION_TOLERANCE:g})"
        raise node.fault(f"found a quaternion of length {length:.6g}, expected {expected}")
